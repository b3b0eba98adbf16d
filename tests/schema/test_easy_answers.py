"""What a person sees at a glance is answered, within few steps."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.schema._judge import answer, verify_counterexample

from uoarm.schema import CheckBudget, check
from uoarm.schema._errors import Meter
from uoarm.schema.regex import found_in, shortest_word

FLOAT32 = {"type": "number", "minimum": -3.4028234663852886e38, "maximum": 3.4028234663852886e38}
SWITCH = {"type": "string", "pattern": "^(on|off)$"}
NAMES = {"type": "string", "pattern": r"^[\p{L}\p{M}'-]{1,50}$"}
FEW = CheckBudget(steps=500_000, seconds=1_000)
WHOLE = {"type": "integer"}

PAIRS: dict[str, tuple[Any, Any, str]] = {
    "float32 into integer": (FLOAT32, WHOLE, "no"),
    "float32 into whole halves": (FLOAT32, {"multipleOf": 0.5}, "no"),
    "huge reals into integer": ({**FLOAT32, "minimum": 0.5, "maximum": 1e300}, WHOLE, "no"),
    "huge negative reals": ({**FLOAT32, "minimum": -1e300, "maximum": -2.5}, WHOLE, "no"),
    "reals beside a huge bound": ({"type": "number", "minimum": -1e18}, WHOLE, "no"),
    "huge integers into even": (
        {**WHOLE, "minimum": -(10**300), "maximum": 10**300},
        {"multipleOf": 2},
        "no",
    ),
    "a switch into a long text": (SWITCH, {"maxLength": 65_535}, "yes"),
    "a switch into a huge text": (SWITCH, {"maxLength": 2**40}, "yes"),
    "letters into a long text": (
        {"type": "string", "pattern": "^[a-z]+$"},
        {"maxLength": 65_535},
        "no",
    ),
    "pairs of letters into a long text": (
        {"type": "string", "pattern": "^(ab)+$"},
        {"maxLength": 65_535},
        "no",
    ),
    "pairs of letters of an odd length": (
        {"type": "string", "pattern": "^(ab)+$", "minLength": 65_535},
        {"minLength": 65_536},
        "yes",
    ),
    "names of letters into fifty": (NAMES, {"maxLength": 50}, "yes"),
    "names of letters into forty-nine": (NAMES, {"maxLength": 49}, "no"),
    "a range into its numbers": (
        {**WHOLE, "minimum": 0, "maximum": 99_999},
        {"enum": list(range(100_000))},
        "yes",
    ),
    "a range into all its numbers but one": (
        {**WHOLE, "minimum": 0, "maximum": 99_999},
        {"enum": [n for n in range(100_000) if n != 77_777]},
        "no",
    ),
    "numbers into their range": (
        {"enum": list(range(100_000))},
        {**WHOLE, "minimum": 0, "maximum": 99_999},
        "yes",
    ),
    "ranges into enumerations": (
        {**WHOLE, "anyOf": [{"minimum": 90 * n, "maximum": 90 * n + 60} for n in range(50)]},
        {"anyOf": [{"enum": list(range(90 * n, 90 * n + 61))} for n in range(50)]},
        "yes",
    ),
    "an older spelling of 2020-12": (
        {"$schema": "http://json-schema.org/draft/2020-12/schema", "type": "integer"},
        {"$schema": "https://json-schema.org/draft/2020-12/schema#", "type": "number"},
        "yes",
    ),
    "another spelling of draft 07": (
        {"$schema": "https://json-schema.org/draft-07/schema#", "type": "integer"},
        {"type": "number"},
        "yes",
    ),
}


@pytest.mark.parametrize(("producer", "consumer", "truth"), PAIRS.values(), ids=PAIRS.keys())
def test_the_easy_is_decided(producer: Any, consumer: Any, truth: str) -> None:
    verdict = check(producer, consumer, budget=FEW)
    assert answer(verdict) == truth, verdict
    if truth == "no" and producer is not NAMES:  # of which the reference knows no patterns
        verify_counterexample(verdict, producer, consumer)


PATTERNS = (
    "^(ab)+$",
    "^(aaa)*b?$",
    "^a{2,5}$",
    "b$",
    "^(a|bb)*$",
    "^(aa|aaa)$",
    "^.b",
    "^(abc)*ab$",
)


@given(
    st.lists(st.sampled_from(PATTERNS), max_size=2, unique=True),
    st.lists(st.sampled_from(PATTERNS), max_size=2, unique=True),
    st.integers(0, 9),
    st.integers(0, 4),
    st.lists(st.text("ab", max_size=6), max_size=5),
)
def test_a_text_of_a_length_is_found_exactly_where_there_is_one(
    wanted: list[str], unwanted: list[str], least: int, more: int, excluded: list[str]
) -> None:
    """Among all texts over four letters: `.` stands for the third, and for every other but those
    that end a line, for which the fourth stands."""
    meter = Meter(10**9, 1_000.0, 10**9)
    found = shortest_word(wanted, unwanted, least, least + more, excluded, meter)

    def does(text: str) -> bool:
        return (
            text not in excluded
            and all(found_in(name, text) for name in wanted)
            and not any(found_in(name, text) for name in unwanted)
        )

    layer = [""]
    for length in range(least + more + 1):
        if length >= least and any(does(text) for text in layer):
            assert found is not None
            assert len(found) == length
            assert does(found)
            return
        if len(layer) > 4**5:
            return
        layer = [text + letter for text in layer for letter in "abc\n"]
    assert found is None


@given(st.sampled_from(PATTERNS), st.integers(40, 400), st.integers(0, 7))
def test_a_long_text_is_read_off_the_period(pattern: str, least: int, more: int) -> None:
    """Every length in turn, from the one before the first to the last."""
    meter = Meter(10**9, 1_000.0, 10**9)
    found = shortest_word([pattern], [], least, least + more, [], meter)
    alone = [shortest_word([pattern], [], n, n, [], meter) for n in range(least, least + more + 1)]
    lengths = [len(name) for name in alone if name is not None]
    assert (None if found is None else len(found)) == min(lengths, default=None)
    for name in alone:
        assert name is None or found_in(pattern, name)
