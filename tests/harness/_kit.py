"""Of the conformance kit nothing is skipped on our own bridges but what a table gives a reason for.

The table is on the page that compares the bridges. Each test of a suite is held against it as it
ends: a skip that is not there fails, and so does a row whose test is not skipped any more.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from attrs import frozen

_PAGE = Path(__file__).parents[1] / "testing" / "skips.md"
_KIT = "/testing/conformance/"
# Suites of bridges that are no plugin's, by the folder or module of their tests.
_BRIDGES = {
    "tests/local/": "python",
    "tests/host/": "python",
    "tests/testing/test_memory_conformance.py": "memory",
}
_PLUGIN = re.compile(r"plugins/uoarm-([a-z0-9]+)/")


@frozen
class KitSkip:
    """A test of the kit that is skipped for a bridge.

    Attributes:
        bridge: its plugin.
        rule: of the test, or the section that it belongs to.
        kinds: of pairs for which it is; none: for all.
        reason: why that cannot be otherwise.
    """

    bridge: str
    rule: str
    kinds: frozenset[str]
    reason: str


@cache
def kit_skips() -> tuple[KitSkip, ...]:
    """Return the rows of the page."""
    return tuple(_rows(_PAGE.read_text(encoding="utf-8")))


def _rows(page: str) -> Iterator[KitSkip]:
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) != 3 or not cells[0].startswith("`"):
            continue
        for rule in cells[1].split(";"):
            name, _, kinds = rule.strip().partition(" (")
            among = frozenset(kinds.rstrip(")").split(", ")) if kinds else frozenset()
            yield KitSkip(cells[0].strip("`"), name.strip("`"), among, cells[2])


def mistake_of(item: pytest.Item, report: pytest.TestReport) -> str:
    """Return what is wrong with a test of the kit that ended as it did, or nothing."""
    bridge = _bridge_of(item.nodeid)
    if not bridge or not isinstance(item, pytest.Function) or not _is_of_kit(item):
        return ""
    row = _row(bridge, item)
    where = "tests/testing/skips.md"
    if isinstance(report.longrepr, tuple) and _KIT in str(report.longrepr[0]):
        why = report.longrepr[2].removeprefix("Skipped: ")
        text = f"skipped, as {why}: have the world give it, or add a row to {where} with the reason"
        return "" if row else text
    if row and report.when == "call" and report.passed:
        return f"no longer skipped: take it out of the row of {row.bridge!r} in {where}"
    return ""


def _bridge_of(node: str) -> str:
    plugin = _PLUGIN.match(node)
    if plugin is not None:
        return plugin[1]
    return next((name for place, name in _BRIDGES.items() if node.startswith(place)), "")


def _is_of_kit(item: pytest.Function) -> bool:
    from uoarm.testing.conformance import BridgeConformance

    return item.cls is not None and issubclass(item.cls, BridgeConformance)


def _row(bridge: str, item: pytest.Function) -> KitSkip | None:
    rule = item.originalname.removeprefix("test_").replace("_", " ")
    section = item.function.__qualname__.partition(".")[0]
    call = getattr(item, "callspec", None)
    kind = "" if call is None else str(call.params.get("kind", ""))
    for skip in kit_skips():
        if (
            skip.bridge == bridge
            and skip.rule in {rule, section}
            and (not skip.kinds or kind in skip.kinds)
        ):
            return skip
    return None
