"""Live messages against their structure: octets and numeric buffers count as arrays."""

from __future__ import annotations

from array import array

import numpy as np
import pytest

from uoarm.errors import MessageError
from uoarm.flow import make_check
from uoarm.model import Message, MessageStructure, ValidationMode

OCTETS = {"type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}}
IMAGE = MessageStructure(
    {
        "type": "object",
        "properties": {
            "width": {"type": "integer", "minimum": 0},
            "data": OCTETS | {"maxItems": 1000},
            "ranges": {"type": "array", "items": {"type": "number", "minimum": 0}},
        },
        "required": ["width", "data"],
        "additionalProperties": False,
    }
)


def check(message: Message) -> None:
    checker = make_check(IMAGE, ValidationMode.ALWAYS, "camera.default")
    assert checker is not None
    checker(message)


@pytest.mark.parametrize(
    "data", [b"", b"\x00\xff", bytearray(b"ab"), memoryview(b"ab"), [0, 255], array("B", [1])]
)
def test_every_form_of_octets_is_an_array(data: object) -> None:
    check({"width": 1, "data": data})


@pytest.mark.parametrize("ranges", [np.array([0.0, 2.5]), array("d", [0.5]), [1, 2.5], np.empty(0)])
def test_numeric_buffers_are_arrays(ranges: object) -> None:
    check({"width": 1, "data": b"", "ranges": ranges})


@pytest.mark.parametrize(
    ("message", "path"),
    [
        ({"width": -1, "data": b""}, "width"),
        ({"width": 1, "data": "text"}, "data"),
        ({"width": 1, "data": [256]}, r"data\.0"),
        ({"width": 1, "data": array("i", [7, -1])}, "data"),
        ({"width": 1, "data": b"x" * 1001}, "data"),
        ({"width": 1, "data": b"", "ranges": np.array([1.0, -0.5])}, "ranges"),
        ({"data": b""}, "the message"),
        ({"width": 1, "data": b"", "more": 1}, "the message"),
        ("text", "the message"),
    ],
)
def test_a_mismatch_names_port_and_field(message: Message, path: str) -> None:
    with pytest.raises(MessageError, match=rf"camera\.default: {path}"):
        check(message)


def test_off_makes_no_check() -> None:
    assert make_check(IMAGE, ValidationMode.OFF, "x") is None


def test_sampled_checks_the_first_and_then_some() -> None:
    checker = make_check(IMAGE, ValidationMode.SAMPLED, "x")
    assert checker is not None
    failures = 0
    for _ in range(1 + 2 * 128):
        try:
            checker("wrong")
        except MessageError:
            failures += 1
    assert failures == 3
