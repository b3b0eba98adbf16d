"""The plugin that the page on writing bridges shows passes the conformance kit as printed."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import pytest

from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Endpoint, Role
from uoarm.testing.conformance import BridgeConformance, Pair, World

pytest.importorskip("can")

PAGE = Path(__file__).parents[2] / "docs" / "writing-a-bridge.md"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
CODE = BLOCK.findall(PAGE.read_text(encoding="utf-8"))[0]
CHANNELS = itertools.count()


def plugin() -> dict[str, Any]:
    module: dict[str, Any] = {}
    exec(compile(CODE, str(PAGE), "exec"), module)
    return module


class CanWorld(World):
    """One frame on a virtual bus of this test's own."""

    def __init__(self) -> None:
        self._options = {"channel": f"test {next(CHANNELS)}", "frames": {"wheel": 0x120}}

    def spec(self) -> BridgeSpec:
        return BridgeSpec("can", "can", self._options)

    def registry(self) -> Registry:
        made = Registry([])
        made.add(plugin()["uoarm_bridge_types"]()[0])
        return made

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("nowhere", Role.OUTPUT)


def at(name: str, role: Role) -> Endpoint:
    return Endpoint("can", name, role, (name,))


class TestCanBridge(BridgeConformance):
    """The whole suite."""

    kinds = ("wheel",)

    @pytest.fixture
    def world(self) -> World:
        return CanWorld()


def test_the_plugin_is_as_short_as_the_page_says() -> None:
    lines = [line for line in CODE.splitlines() if line.strip()]
    assert len(lines) < 60
