"""The messages of the HealthBot's functions, as the plain Python components take and give them.

The components of ROS 2, OpenRTM and the devices bring their own structures; robot.yaml says what
is renamed and what is given up on the way.
"""

from __future__ import annotations

from typing import Annotated, TypedDict

from uoarm.local import Octets, Range

__all__ = [
    "Box",
    "Faces",
    "People",
    "Person",
    "Picture",
    "Pressure",
    "Said",
    "Speech",
    "Time",
    "View",
]

Length = Annotated[int, Range(0, 65535)]


class View(TypedDict):
    """One picture of the camera; a part of ROS 2's sensor_msgs/msg/Image."""

    width: Annotated[int, Range(0, 2**32 - 1)]
    height: Annotated[int, Range(0, 2**32 - 1)]
    encoding: str
    data: Octets


class Box(TypedDict):
    """A rectangle within a picture, in pixels from its upper left corner."""

    x: Length
    y: Length
    width: Length
    height: Length


class Picture(TypedDict):
    """Rows from the top, three octets a pixel, blue first."""

    width: Length
    height: Length
    data: Octets


class Time(TypedDict):
    """Seconds and nanoseconds since 1970, as OpenRTM has them."""

    sec: Annotated[int, Range(0, 2**32 - 1)]
    nsec: Annotated[int, Range(0, 2**32 - 1)]


class Faces(TypedDict):
    """Where faces are in a picture of this size, and the pixels around the largest.

    Without a face there are no boxes, and `face` is 0 by 0. It is HealthBot::Faces of faces.idl, to
    the letter: a spare takes over in mid-stream only where no consumer can see the difference.
    """

    tm: Time
    width: Length
    height: Length
    boxes: list[Box]
    face: Picture


class Person(TypedDict):
    """Whose the largest face is; no name when it is of no person who was enrolled."""

    name: str | None
    distance: Annotated[float, Range(minimum=0)]


class People(TypedDict):
    """Who is there: one person or none."""

    persons: list[Person]


class Pressure(TypedDict):
    """A measurement of blood pressure in mm[Hg], and the pulse with it."""

    systolic: Annotated[int, Range(0, 510)]
    diastolic: Annotated[int, Range(0, 255)]
    mean: Annotated[int, Range(0, 255)]
    pulse: Annotated[int, Range(0, 255)]
    battery: Annotated[int, Range(0, 255)]


class Speech(TypedDict):
    """What is to be said."""

    text: str


class Said(TypedDict):
    """A WAV file, empty where nothing was spoken, and how long it lasts in seconds."""

    audio: Octets
    duration: Annotated[float, Range(minimum=0)]
    played: bool
