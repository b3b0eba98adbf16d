"""The page on configuration: its example loads, and it names every key and every limit."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from attrs import astuple
from tests.sweeps import for_all

from uoarm._support.yaml import ReadBudget
from uoarm.config import loads, published_schema

DOCS = Path(__file__).parents[2] / "docs"
# The page on configuration comes first, and has the example; those below have keys of their own.
PAGES = ("configuration", "configuration-rules", "adapters", "discovery", "offering")
PAGE = "".join((DOCS / f"{name}.md").read_text(encoding="utf-8") for name in PAGES)
EXAMPLE, *_ = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


def test_the_example_loads_without_a_warning() -> None:
    robot = loads(EXAMPLE)
    assert list(robot.functions) == ["camera", "faceDetection"]
    assert robot.warnings == ()


def keys() -> set[str]:
    schema = published_schema()
    parts = [schema, *schema["$defs"].values(), *schema["$defs"]["rule"]["anyOf"]]
    return {key for part in parts for key in part.get("properties", {})}


@for_all("key", sorted(keys()))
def test_every_key_is_on_the_page(key: str) -> None:
    assert re.search(rf"`{key}`|[{{ ]{key}:", PAGE)


@pytest.mark.parametrize("limit", astuple(ReadBudget()))
def test_every_limit_is_on_the_page(limit: int) -> None:
    assert f"{limit:,}" in PAGE
