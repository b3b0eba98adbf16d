"""Face detection with dlib's histograms of oriented gradients."""

from __future__ import annotations

import cv2
import dlib
import numpy as np

from uoarm_vision.messages import Box, Faces, Frame
from uoarm_vision.pixels import Picture, as_picture, boxed, resized

__all__ = ["HogDetector"]


class HogDetector:
    """Finds upright faces seen from the front.

    Args:
        size: pixels of the longer side on which faces are looked for; the smallest face that is
            found has 80 of these.
    """

    def __init__(self, size: int = 640) -> None:
        self._size = size
        self._find = dlib.get_frontal_face_detector()

    def __call__(self, frame: Frame) -> Faces:
        """Return the frame with its faces."""
        return {"frame": frame, "boxes": self.find(as_picture(frame))}

    def find(self, picture: Picture) -> list[Box]:
        """Return the faces of a picture."""
        small, factor = resized(picture, self._size)
        found = self._find(np.ascontiguousarray(cv2.cvtColor(small, cv2.COLOR_BGR2RGB)), 0)
        return [
            boxed(picture, *(edge / factor for edge in (r.left(), r.top(), r.right(), r.bottom())))
            for r in found
        ]
