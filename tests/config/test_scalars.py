"""Unquoted scalars by the core schema of YAML 1.2."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.config import loads

VALUES: dict[str, object] = {
    "yes": "yes",
    "no": "no",
    "on": "on",
    "off": "off",
    "y": "y",
    "true": True,
    "True": True,
    "FALSE": False,
    "tRUE": "tRUE",
    "null": None,
    "~": None,
    "": None,
    "Null": None,
    "nULL": "nULL",
    "12": 12,
    "-12": -12,
    "+12": 12,
    "010": 10,
    "0o17": 15,
    "0x1F": 31,
    "-0o17": "-0o17",
    "0b11": "0b11",
    "1_000": "1_000",
    "1:30": "1:30",
    "12:30:45": "12:30:45",
    "2026-11-21": "2026-11-21",
    "1.5": 1.5,
    "1.": 1.0,
    ".5": 0.5,
    "1e3": 1000.0,
    "-1.5E-3": -0.0015,
    "1e": "1e",
    ".": ".",
    "+": "+",
    "=": "=",
    "'12'": "12",
    '"true"': "true",
    "!!str 12": "12",
    "! 12": "12",
}


def read(written: str) -> object:
    robot = loads(
        f"version: 1\nbridges:\n  p:\n    options:\n      x: {written}\nfunctions: {{}}\n"
    )
    return robot.bridges["p"].options["x"]


@pytest.mark.parametrize(("written", "value"), VALUES.items())
def test_a_scalar_means_what_yaml_1_2_says(written: str, value: object) -> None:
    found = read(written)
    assert found == value
    assert type(found) is type(value)


UNQUOTABLE = "".join(map(chr, [*range(0x7F, 0xA0), 0x2028, 0x2029, 0xFEFF, 0xFFFE, 0xFFFF]))
"""What libyaml takes for line ends, or YAML wants escaped where JSON does not."""

JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"], exclude_characters=UNQUOTABLE)),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.text(st.characters(codec="ascii", categories=["L"])), inner, max_size=4
        )
    ),
    max_leaves=20,
)


@given(JSON)
def test_json_with_its_characters_written_out_is_yaml(value: object) -> None:
    assert read(json.dumps(value, ensure_ascii=False)) == value
