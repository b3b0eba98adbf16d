"""The plots on the pages are of the figures beside them."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any

import pytest

FIGURES = Path(__file__).parents[2] / "docs" / "figures"
PAGE = FIGURES.parents[1] / "examples" / "healthbot" / "RESULTS.md"


def recorded(name: str) -> Any:
    return json.loads((FIGURES / f"{name}.json").read_text(encoding="utf-8"))


def drawn(name: str) -> str:
    return html.unescape((FIGURES / f"{name}.svg").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("plot", "kinds"), [("steps", {"step"}), ("messages", {"floor", "alone", "pair"})]
)
def test_every_latency_is_drawn_and_dated(plot: str, kinds: set[str]) -> None:
    latency, picture = recorded("latency"), drawn(plot)
    assert latency["measured"] in picture
    titles = {figure["title"] for figure in latency["figures"] if figure["kind"] in kinds}
    assert titles
    assert not [title for title in titles if f">{title}<" not in picture]


def test_every_death_is_drawn_and_dated() -> None:
    deaths, picture = recorded("monitoring"), drawn("faults")
    assert deaths["measured"] in picture
    assert not [figure for figure in deaths["figures"] if f">{figure['killed']}<" not in picture]


def test_the_page_shows_the_same_run() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for name in ("latency", "monitoring"):
        assert recorded(name)["measured"] in page
    for figure in recorded("latency")["figures"]:
        assert f"{figure['p50'] * 1e6:,.1f}" in page, figure
    for figure in recorded("monitoring")["figures"]:
        assert figure["killed"] in page
