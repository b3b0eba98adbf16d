"""Values in the texts of errors."""

from __future__ import annotations

import pytest

from uoarm.model import Reason, Rejection, format_rejections, show_value


class Unwritten(list[int]):
    """A list that must not be written out."""

    def __repr__(self) -> str:
        raise AssertionError("all of it was written out")


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("x" * 1_000_000, repr("x" * 60) + "..."),
        (b"x" * 1_000_000, repr(b"x" * 60) + "..."),
        ("'\n", repr("'\n")),
        ([1, 2], "[1, 2]"),
        ({"a": None}, "{'a': None}"),
        (list(range(50)), f"{str(list(range(50)))[:60]}..."),
        (Unwritten(range(1000)), "a list of 1,000 values"),
        ([Unwritten(range(1000))], "a list of 1 values"),
        (dict.fromkeys(range(1000)), "an object with 1,000 members"),
        (1 << 100_000, "a large int"),
    ],
    ids=lambda item: str(type(item)),
)
def test_a_value_is_shown_in_short(value: object, shown: str) -> None:
    assert show_value(value) == shown


def test_a_reason_of_several_lines_stands_below_its_candidate() -> None:
    """As that of another manager, which names candidates of its own."""
    there = Rejection("drive", "far", 0, (Reason("it is gone"),))
    reason = Reason(f"there no component can provide 'drive':\n{format_rejections((there,))}")
    assert format_rejections((Rejection("drive", "near", 1, (reason,)),)).splitlines() == [
        "  drive: near (priority 1)",
        "    - there no component can provide 'drive':",
        "        drive: far (priority 0)",
        "          - it is gone",
    ]
