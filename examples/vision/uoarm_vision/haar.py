"""Face detection with OpenCV's cascade of Haar features."""

from __future__ import annotations

from pathlib import Path

import cv2
import cv2.data

from uoarm_vision.messages import Box, Faces, Frame
from uoarm_vision.pixels import Picture, as_picture, boxed, resized

__all__ = ["HaarDetector"]

if not hasattr(cv2, "CascadeClassifier"):
    raise ImportError("OpenCV 5 has no cascades: pip install 'opencv-python-headless<5'")

_CASCADE = Path(cv2.data.haarcascades) / "haarcascade_frontalface_default.xml"
_STEP = 1.1
_NEIGHBOURS = 8
_SMALLEST = 80


class HaarDetector:
    """Finds upright faces seen from the front.

    Args:
        size: pixels of the longer side on which faces are looked for; the smallest face that is
            found has 80 of these.
    """

    def __init__(self, size: int = 640) -> None:
        self._size = size
        self._cascade = cv2.CascadeClassifier(str(_CASCADE))

    def __call__(self, frame: Frame) -> Faces:
        """Return the frame with its faces."""
        return {"frame": frame, "boxes": self.find(as_picture(frame))}

    def find(self, picture: Picture) -> list[Box]:
        """Return the faces of a picture."""
        small, factor = resized(picture, self._size)
        grey = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)
        found = self._cascade.detectMultiScale(
            grey, _STEP, _NEIGHBOURS, minSize=(_SMALLEST, _SMALLEST)
        )
        return [
            boxed(picture, x / factor, y / factor, (x + width) / factor, (y + height) / factor)
            for x, y, width, height in found
        ]
