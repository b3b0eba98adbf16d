"""Frames of clients: what is read, and what is refused; no socket."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from uoarm_foxglove._protocol import (
    ClientFrame,
    PublishedFrame,
    ServiceRequest,
    message_data,
    read_frame,
    service_response,
)

from uoarm.errors import ControlMessageError
from uoarm.model import Budget, BudgetUse

NUMBERS = st.integers(0, 2**32 - 1)


def read(frame: str | bytes, **budget: int) -> ClientFrame:
    return read_frame(frame, BudgetUse(Budget(**budget)))


@given(number=NUMBERS, payload=st.binary())
def test_a_message_is_read_as_it_was_written(number: int, payload: bytes) -> None:
    assert read(struct.pack("<BI", 1, number) + payload) == PublishedFrame(number, payload)


@given(
    service=NUMBERS, call=NUMBERS, encoding=st.sampled_from(["cdr", "json"]), payload=st.binary()
)
def test_a_call_is_read_as_it_was_written(
    service: int, call: int, encoding: str, payload: bytes
) -> None:
    head = struct.pack("<BIII", 2, service, call, len(encoding))
    request = ServiceRequest(service, call, encoding, payload)
    assert read(head + encoding.encode() + payload) == request
    assert (
        service_response(request, encoding, payload)[1:] == head[1:] + encoding.encode() + payload
    )


@given(number=NUMBERS, stamp=st.integers(0, 2**64 - 1), payload=st.binary())
def test_data_has_the_subscription_and_the_time(number: int, stamp: int, payload: bytes) -> None:
    assert message_data(number, stamp, payload) == struct.pack("<BIQ", 1, number, stamp) + payload


@given(st.binary(max_size=40))
def test_any_octets_are_read_or_refused(frame: bytes) -> None:
    try:
        read(frame)
    except ControlMessageError as error:
        assert "expected" in str(error)


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (b"", "is empty"),
        (b"\x07abcdef", "begins with 7"),
        ("[1]", "got list"),
        ("{", "not JSON"),
    ],
)
def test_what_is_wrong_is_said(frame: str | bytes, text: str) -> None:
    with pytest.raises(ControlMessageError, match=text):
        read(frame)


def test_a_budget_is_held_before_anything_is_read() -> None:
    with pytest.raises(ControlMessageError):
        read(struct.pack("<BI", 1, 1) + bytes(100), octets=64)
    with pytest.raises(ControlMessageError):
        read("[" * 100 + "]" * 100, depth=8)
