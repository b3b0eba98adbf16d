"""What flows between the components."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from uoarm.local import Octets, Range

Pixels = Annotated[int, Range(0, 10_000)]
Pixel = NDArray[Any]


class Frame(TypedDict):
    """One picture: rows of blue, green, red octets."""

    number: Annotated[int, Range(0)]
    source: str
    width: Pixels
    height: Pixels
    encoding: Literal["bgr8"]
    data: Octets


class Box(TypedDict):
    """Where a face is, in pixels from the upper left corner."""

    left: int
    top: int
    right: int
    bottom: int


class Faces(TypedDict):
    """A picture and the faces found in it."""

    frame: Frame
    boxes: list[Box]


class Person(TypedDict):
    """One face with a name; `unknown` when nobody enrolled is near enough."""

    name: str
    distance: float
    box: Box


class People(TypedDict):
    """Who is in one picture."""

    frame: Frame
    people: list[Person]


def pixels_of(frame: Frame) -> Pixel:
    """Return a picture as an array of height, width, three colours; the octets are not copied."""
    return np.frombuffer(frame["data"], np.uint8).reshape(frame["height"], frame["width"], 3)
