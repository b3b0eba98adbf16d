"""Records whose hints name what is defined later: quoted, which CPython 3.14 does without."""

from dataclasses import dataclass
from typing import NamedTuple, Optional

from attrs import define
from typing_extensions import TypedDict


@dataclass
class Whole:
    parts: list["Part"]
    spare: Optional["Part"]


@define
class Defined:
    parts: list["Part"]
    spare: Optional["Part"]


class Tuple(NamedTuple):
    parts: list["Part"]
    spare: Optional["Part"]


class Mapped(TypedDict):
    parts: list["Part"]
    spare: Optional["Part"]


@dataclass
class Part:
    value: int


@dataclass
class Tree:
    value: int
    children: list["Tree"]
