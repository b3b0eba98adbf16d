"""Components behind the server that `serve_clients` measures."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TypedDict

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  add:
    components:
      - {name: add, bridge: python, service: {endpoint: ["bench._serve_components:add"]}}
  echo:
    components:
      - name: echo
        bridge: python
        input: {endpoint: ["bench._serve_components:echo"], queue: {length: 100000}}
        output: {endpoint: ["bench._serve_components:echo"]}
"""
SOURCE = """
  {name}:
    components:
      - name: {name}
        bridge: python
        parameters: {{hertz: {hertz}, size: {size}}}
        output: {{endpoint: ["bench._serve_components:{kind}"]}}
"""


class Pair(TypedDict):
    a: int
    b: int


class Sum(TypedDict):
    sum: int


class Text(TypedDict):
    data: str


class Stamped(TypedDict):
    number: int
    time: int
    data: str


class Image(TypedDict):
    number: int
    data: bytes


def add(pair: Pair) -> Sum:
    return {"sum": pair["a"] + pair["b"]}


def echo(text: Text) -> Text:
    return text


def texts(hertz: float, size: int) -> Iterator[Stamped]:
    """Yield numbered texts at a steady rate, each with the time at which it left."""
    data = "x" * size
    for number in _paced(hertz):
        yield {"number": number, "time": time.monotonic_ns(), "data": data}


def ticks(hertz: float, size: int) -> Iterator[Stamped]:
    """Yield as `texts`, seldom, so that a thousand of them cost next to nothing."""
    data, number = "x" * size, 0
    while True:
        yield {"number": number, "time": time.monotonic_ns(), "data": data}
        number += 1
        time.sleep(1 / hertz)


def images(hertz: float, size: int) -> Iterator[Image]:
    """Yield numbered pictures at a steady rate."""
    data = bytes(range(256)) * (size // 256)
    for number in _paced(hertz):
        yield {"number": number, "data": data}


def _paced(hertz: float) -> Iterator[int]:
    """Count at a rate; what a late wake-up missed follows at once, so that the rate holds."""
    start, number = time.perf_counter(), 0
    while True:
        due = int((time.perf_counter() - start) * hertz)
        while number <= due:
            yield number
            number += 1
        time.sleep(min(0.001, 1 / hertz))
