"""Plain Python components for the conformance suite."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Annotated, Literal, TypedDict

from typing_extensions import NotRequired

from uoarm.local import Octets, Range
from uoarm.testing import patience


class Value(TypedDict):
    value: int


class Number(TypedDict):
    small: Annotated[int, Range(-128, 127)]
    large: Annotated[int, Range(0, 2**64 - 1)]
    real: float
    truth: bool


class Text(TypedDict):
    text: str
    kind: Literal["a", "b"]
    remark: NotRequired[str]


class Picture(TypedDict):
    width: int
    data: Octets


class Whole(TypedDict):
    numbers: list[Number]
    texts: dict[str, Text]
    either: int | str | None
    pair: tuple[bool, float]


class Numbers:
    def __call__(self, message: Number) -> Number:
        return message


class Texts:
    def __call__(self, message: Text) -> Text:
        return message


class Pixels:
    def __call__(self, message: Picture) -> Picture:
        return message


class Everything:
    def __call__(self, message: Whole) -> Whole:
        return message


def until_killed(killed: threading.Event) -> Iterator[Value]:
    if killed.wait(patience()):
        raise RuntimeError("the component was killed")
    yield {"value": 0}


def double(message: Value) -> Value:
    return {"value": 2 * message["value"]}


def measure(message: Text) -> Value:
    return {"value": len(message["text"])}


def broken(message: Value) -> Value:
    raise RuntimeError(f"the service is broken: {message}")


def silent(message: Value, released: threading.Event) -> Value:
    released.wait(patience())
    return message
