"""The messages between camera, detector, recogniser and application.

Pixels travel along: a recogniser must see them, and an application may want to draw on them.
Within one process that costs nothing, since messages hold the same octets.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypedDict

from uoarm.local import Octets, Range

__all__ = ["Box", "Faces", "Frame", "People", "Person"]

Position = Annotated[int, Range(0, 65535)]
Length = Annotated[int, Range(1, 65535)]


class Frame(TypedDict):
    """One picture: rows from the top, three octets a pixel, blue first; time in s since 1970."""

    source: str
    sequence: Annotated[int, Range(0, 2**63 - 1)]
    time: Annotated[float, Range(minimum=0)]
    width: Length
    height: Length
    encoding: Literal["bgr8"]
    data: Octets


class Box(TypedDict):
    """A rectangle within a picture, in pixels from its upper left corner."""

    x: Position
    y: Position
    width: Length
    height: Length


class Faces(TypedDict):
    """A picture and where the faces are in it."""

    frame: Frame
    boxes: list[Box]


class Person(TypedDict):
    """One face and whose it is; no name when it is of no person who was enrolled.

    `distance` is how far the face is from the nearest person enrolled; its unit is the
    recogniser's own.
    """

    box: Box
    name: str | None
    distance: Annotated[float, Range(minimum=0)]


class People(TypedDict):
    """A picture and who is in it."""

    frame: Frame
    persons: list[Person]
