"""Components of Python that give what is shown on a board."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, TypedDict


class Tag(TypedDict):
    name: Annotated[str, {"x-max-utf8": 22}]
    wide: Annotated[str, {"maxLength": 11}]
    note: str


class LongTag(TypedDict):
    name: Annotated[str, {"maxLength": 22}]
    wide: Annotated[str, {"maxLength": 11}]
    note: str


def short() -> Iterator[Tag]:
    yield {"name": "one", "wide": "two", "note": "three"}


def long() -> Iterator[LongTag]:
    yield {"name": "é" * 22, "wide": "two", "note": "three"}
