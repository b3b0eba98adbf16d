"""Pixels: messages to arrays and back, and pictures brought to the size that detectors like."""

from __future__ import annotations

import time
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from uoarm_vision.messages import Box, Frame

__all__ = ["Picture", "as_frame", "as_picture", "boxed", "resized"]

Picture: TypeAlias = NDArray[np.uint8]
"""Rows, columns, and three channels with blue first."""


def as_frame(picture: Picture, source: str, sequence: int) -> Frame:
    """Return a picture as a message, taken now."""
    height, width = picture.shape[:2]
    return {
        "source": source,
        "sequence": sequence,
        "time": time.time(),
        "width": width,
        "height": height,
        "encoding": "bgr8",
        "data": picture.tobytes(),
    }


def as_picture(frame: Frame) -> Picture:
    """Return the pixels of a message without copying them; they cannot be written to.

    Raises:
        ValueError: there are not as many octets as width and height say.
    """
    height, width = frame["height"], frame["width"]
    found, expected = len(frame["data"]), height * width * 3
    if found != expected:
        text = f"{frame['source']}: {width} x {height} pixels need {expected} octets, got {found}"
        raise ValueError(text)
    return np.frombuffer(frame["data"], np.uint8).reshape(height, width, 3)


def resized(picture: Picture, longest: int) -> tuple[Picture, float]:
    """Return the picture with its longer side at `longest` pixels, and the factor applied."""
    height, width = picture.shape[:2]
    factor = longest / max(height, width)
    size = max(1, round(width * factor)), max(1, round(height * factor))
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    return cv2.resize(picture, size, interpolation=how).astype(np.uint8, copy=False), factor


def boxed(picture: Picture, left: float, top: float, right: float, bottom: float) -> Box:
    """Return a rectangle as a message, cut at the edges of the picture."""
    height, width = picture.shape[:2]
    x, x_end = _cut(left, right, width)
    y, y_end = _cut(top, bottom, height)
    return {"x": x, "y": y, "width": x_end - x, "height": y_end - y}


def _cut(begin: float, end: float, length: int) -> tuple[int, int]:
    first = min(max(round(begin), 0), length - 1)
    return first, max(min(round(end), length), first + 1)
