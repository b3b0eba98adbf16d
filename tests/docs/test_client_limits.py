"""The page of what a client may use has every bound of the server, as it is."""

from __future__ import annotations

import re
from pathlib import Path

from attrs import fields
from tests.sweeps import for_all

from uoarm.server import Limits

PAGE = Path(__file__).parents[2] / "docs" / "client-limits.md"
# What bounds the operator, and a part of another row: "one without a sign of life" is their sum.
NOT_SHOWN = {"stop_seconds", "ping_seconds", "connections_per_address"}
# Bounds of the table that are no part of `Limits`: pings a second, the head of a handshake,
# subscriptions of rosbridge, a component's queue.
OTHERS = {"200", "64 KiB", "65,536", "64 MiB"}
# Of the class, since tests have the patience of a slow machine in the place of some.
DEFAULTS: dict[str, float] = {field.name: field.default or 0.0 for field in fields(Limits)}
NAMES = sorted(set(DEFAULTS) - NOT_SHOWN)


def shown(name: str, value: float) -> str:
    if name.removesuffix("_per_second").endswith(("bytes", "octets")):
        gigabytes, rest = divmod(int(value), 2**30)
        return f"{int(value) >> 20} MiB" if rest else f"{gigabytes} GiB"
    return f"{value:,g} s" if name.endswith("_seconds") else f"{int(value):,}"


def on_the_page() -> set[str]:
    rows = re.findall(r"^\|.*\| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return {bound.strip() for row in rows[1:] for bound in re.split(r"; | and ", row)}


@for_all("name", NAMES)
def test_a_bound_is_on_the_page(name: str) -> None:
    assert shown(name, DEFAULTS[name]) in on_the_page()


def test_the_page_has_no_other_bound() -> None:
    bounds = {shown(name, DEFAULTS[name]) for name in NAMES}
    alive = shown("stall_seconds", DEFAULTS["stall_seconds"] + DEFAULTS["ping_seconds"])
    assert on_the_page() - {"---"} <= bounds | OTHERS | {alive}
