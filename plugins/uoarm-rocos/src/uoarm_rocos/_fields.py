"""The types of the profile: what a catalogue says of each field."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TypeAlias

from attrs import field, frozen

__all__ = [
    "INT64",
    "NAME",
    "BooleanField",
    "Field",
    "Fields",
    "IntegerField",
    "ListField",
    "Member",
    "NumberField",
    "OctetsField",
    "StringField",
    "StructField",
]

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.\-]{0,63}", re.ASCII)
INT64 = (-(2**63), 2**63 - 1)


@frozen
class BooleanField:
    """True or false."""


@frozen
class IntegerField:
    """A whole number within inclusive bounds; `unit` as UCUM writes it."""

    minimum: int = INT64[0]
    maximum: int = INT64[1]
    unit: str = ""


@frozen
class NumberField:
    """A 64-bit float; None is no bound; `nonfinite` admits NaN and infinities."""

    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    nonfinite: bool = False


@frozen
class StringField:
    """Text of at most `max_length` code points, or one of `choices` where there are any."""

    choices: tuple[str, ...] = ()
    max_length: int | None = None


@frozen
class OctetsField:
    """At most `max_length` octets."""

    max_length: int | None = None


@frozen
class StructField:
    """Named members, in the catalogue's order."""

    members: Fields = field(factory=dict, hash=False)


@frozen
class ListField:
    """Items of one type."""

    items: Field
    min_items: int = 0
    max_items: int | None = None


Field: TypeAlias = (
    BooleanField | IntegerField | NumberField | StringField | OctetsField | StructField | ListField
)


@frozen
class Member:
    """A field with its name's rules: whether a message may leave it out."""

    type: Field
    required: bool = True


Fields: TypeAlias = Mapping[str, Member]
