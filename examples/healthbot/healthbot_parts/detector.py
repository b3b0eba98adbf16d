"""The spare face detector: the RT-Component's own search, run in the robot manager's process."""

from __future__ import annotations

from typing import cast

from healthbot_parts.finding import FaceFinder, picture_of
from healthbot_parts.messages import Faces, View

__all__ = ["Detector"]


class Detector:
    """Finds the faces in every picture."""

    def __init__(self) -> None:
        self._finder = FaceFinder()

    def __call__(self, view: View) -> Faces:
        """Return the faces of a picture."""
        picture = picture_of(view["width"], view["height"], view["encoding"], view["data"])
        return cast("Faces", self._finder.find(picture))
