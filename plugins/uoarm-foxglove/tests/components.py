"""Components that the tests play on."""

from __future__ import annotations

from typing import Annotated, TypedDict

from uoarm.local import Range
from uoarm.testing import Script

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  numbers:
    components:
      - {name: counter, bridge: python, output: {endpoint: ["components:numbers"]}}
  picture: {components: [{name: eye, bridge: python, output: {endpoint: ["components:picture"]}}]}
  shown: {components: [{name: shower, bridge: python, output: {endpoint: ["components:shown"]}}]}
  loose: {components: [{name: loose, bridge: python, output: {endpoint: ["components:loose"]}}]}
  odd: {components: [{name: odd, bridge: python, output: {endpoint: ["components:odd"]}}]}
  level: {components: [{name: level, bridge: python, output: {endpoint: ["components:level"]}}]}
  doubled:
    components:
      - name: doubler
        bridge: python
        input: {from: numbers, endpoint: ["components:double"]}
        output: {endpoint: ["components:double"]}
  echo:
    components:
      - name: echo
        bridge: python
        input: {endpoint: ["components:echo"], queue: {length: 1000}}
        output: {endpoint: ["components:echo"]}
  note:
    components:
      - name: note
        bridge: python
        input: {endpoint: ["components:note"]}
        output: {endpoint: ["components:note"]}
  add: {components: [{name: adder, bridge: python, service: {endpoint: ["components:add"]}}]}
  broken: {components: [{name: broken, bridge: python, service: {endpoint: ["components:broken"]}}]}
"""

Int32 = Annotated[int, Range(-(2**31), 2**31 - 1)]


class Number(TypedDict):
    data: Int32


Number.__name__ = "std_msgs/msg/Int32"


class Picture(TypedDict):
    width: Int32
    data: bytes


class Shown(TypedDict):
    format: str
    data: bytes


class Loose(TypedDict, total=False):
    any_number: float
    text: str


class Odd(TypedDict):
    count: int
    perhaps: float | None
    pair: tuple[float, str]


class Pair(TypedDict):
    a: float
    b: float


numbers_script, pictures_script, loose_script = Script(), Script(), Script()
shown_script = Script()
numbers = numbers_script.source(Number)
picture = pictures_script.source(Picture)
shown = shown_script.source(Shown)
loose = loose_script.source(Loose)
odd, level, words = Script().source(Odd), Script().source(float), Script().source(str)
taken: list[object] = []


def renew() -> None:
    """Forget what was played and taken, and end what still plays."""
    for source in (numbers_script, pictures_script, shown_script, loose_script):
        source.reset()
    taken.clear()


def double(message: Number) -> Number:
    return {"data": 2 * message["data"]}


def echo(message: Number) -> Number:
    taken.append(message)
    return message


def note(message: Loose) -> Loose:
    taken.append(message)
    return message


def add(message: Pair) -> Number:
    return {"data": int(message["a"] + message["b"])}


def broken(message: Pair) -> Number:
    raise ValueError(f"a fault of this service: {message['a']}")
