"""The one reader and the one writer of JSON."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.model import read_json, to_json, write_json

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1e400", "1e400 is beyond what a number of 64 bits can hold"),
        ("[-1E+0400]", "beyond"),
        ("1" * 400 + ".0", "beyond"),
        ('{"a": NaN}', "NaN is no number of JSON"),
        ("[Infinity]", "Infinity is no number"),
        ("-Infinity", "-Infinity is no number"),
        (r'"\ud800"', "half of a surrogate pair"),
        (r'{"\uDC00a": 1}', "half of a surrogate pair"),
        ("[" * 200_000, "nested too deep"),
        ("{", "Expecting"),
        ('{"a": 1, "a": 2}', 'the key "a" is given twice'),
        (f"{10**1000}", "a whole number of 1,001 digits; 1,000 are allowed"),
        (b"\xff", "can't decode"),
    ],
)
def test_what_no_reader_agrees_on_is_refused(text: str | bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        read_json(text)


def test_what_looks_alike_is_taken() -> None:
    assert read_json(r'["\ud83d\ude00", 1e308, 1e-400, "1e400", "\\ud800"]') == [
        "\U0001f600",
        1e308,
        0.0,
        "1e400",
        r"\ud800",
    ]
    assert read_json(f"[{10**999}, {-(2**70)}]") == [10**999, -(2**70)]


@given(VALUES)
def test_what_is_written_is_read_by_every_reader(value: object) -> None:
    text = write_json(value)
    read = json.loads(text, parse_constant=pytest.fail)
    assert text == write_json(read)


@pytest.mark.parametrize("value", ["\ud800", {"\udc00a": 1}, ["\U0001f600", "\ude00"]])
def test_half_of_a_surrogate_pair_is_not_written(value: object) -> None:
    with pytest.raises(ValueError, match="half of a surrogate pair"):
        write_json(value)
    assert read_json(write_json(to_json(value))) == to_json(value)
    assert read_json(write_json("\U0001f600")) == "\U0001f600"


def test_what_is_not_finite_is_written_as_its_name() -> None:
    value = {"a": (math.nan, [math.inf, -math.inf]), "b": 1.5}
    assert json.loads(write_json(value)) == {"a": ["NaN", ["Infinity", "-Infinity"]], "b": 1.5}
