"""Finding faces in a camera picture; used by the RT-Component and by its spare in plain Python."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from uoarm_vision.haar import HaarDetector
from uoarm_vision.messages import Box
from uoarm_vision.pixels import Picture

__all__ = ["FaceFinder", "picture_of"]

_SECOND = 1_000_000_000
_SIDE = 320
_MARGIN = 0.3
_CUT_OUT = 160
_ORDERS = {"rgb8": (2, 1, 0), "bgr8": (0, 1, 2)}


def picture_of(width: int, height: int, encoding: str, data: Any) -> Picture:
    """Return the pixels of a message with blue first.

    Raises:
        ValueError: the encoding is another one, or the octets are not as many as it needs.
    """
    order = _ORDERS.get(encoding)
    if order is None:
        raise ValueError(f"pictures must be rgb8 or bgr8, got {encoding!r}")
    pixels = np.frombuffer(data, np.uint8)
    if pixels.size != width * height * 3:
        raise ValueError(f"{width} x {height} pixels need {width * height * 3} octets")
    return pixels.reshape(height, width, 3)[:, :, order]


class FaceFinder:
    """Finds upright faces and cuts the largest one out."""

    def __init__(self) -> None:
        self._detector = HaarDetector(_SIDE)

    def find(self, picture: Picture) -> Mapping[str, Any]:
        """Return the fields of `messages.Faces`."""
        height, width = picture.shape[:2]
        boxes = sorted(self._detector.find(picture), key=lambda box: -box["width"])
        face = _around(picture, boxes[0]) if boxes else np.empty((0, 0, 3), np.uint8)
        rows, columns = face.shape[:2]
        now = time.time_ns()
        return {
            "tm": {"sec": now // _SECOND, "nsec": now % _SECOND},
            "width": width,
            "height": height,
            "boxes": boxes,
            "face": {"width": columns, "height": rows, "data": face.tobytes()},
        }


def _around(picture: Picture, box: Box) -> Picture:
    """Return the face with a margin for hair and chin, 160 pixels at most on each side."""
    margin = round(box["width"] * _MARGIN)
    top, left = max(0, box["y"] - margin), max(0, box["x"] - margin)
    bottom, right = box["y"] + box["height"] + margin, box["x"] + box["width"] + margin
    face = picture[top:bottom, left:right]
    factor = min(1.0, _CUT_OUT / max(face.shape[:2]))
    size = round(face.shape[1] * factor), round(face.shape[0] * factor)
    return cv2.resize(face, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
