"""Face detection in plain Python. It knows nothing of ROS, and uoarm only by its type hints.

A stand-in for a real detector: it finds the largest box of face-coloured pixels.
"""

from __future__ import annotations

from typing import Annotated, TypedDict

import numpy as np

from uoarm.local import Octets, Range

Count = Annotated[int, Range(0, 2**32 - 1)]
SKIN = np.array([224, 172, 105])
TOLERANCE = 40


class Picture(TypedDict):
    """The part of a picture that is needed here: rows of RGB pixels."""

    height: Count
    width: Count
    data: Octets


class Face(TypedDict):
    """A box within the picture, in pixels."""

    x_offset: Count
    y_offset: Count
    height: Count
    width: Count
    do_rectify: bool


def find_face(picture: Picture) -> Face | None:
    """Return where the face is, None when there is none."""
    pixels = np.frombuffer(picture["data"], np.uint8)
    pixels = pixels.reshape(picture["height"], picture["width"], 3)
    alike = (np.abs(pixels.astype(np.int16) - SKIN) < TOLERANCE).all(axis=2)
    if not alike.any():
        return None
    rows, columns = np.nonzero(alike.any(axis=1))[0], np.nonzero(alike.any(axis=0))[0]
    return {
        "x_offset": int(columns[0]),
        "y_offset": int(rows[0]),
        "height": int(rows[-1] - rows[0] + 1),
        "width": int(columns[-1] - columns[0] + 1),
        "do_rectify": False,
    }
