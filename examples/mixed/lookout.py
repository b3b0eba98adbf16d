"""The application's own part: pictures and temperatures, and it does not know whose they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from uoarm.local import Range

Count = Annotated[int, Range(0, 2**32 - 1)]


@dataclass
class Picture:
    """What of an image this part needs; images of ROS 1 and ROS 2 both have it."""

    width: Count
    height: Count
    data: bytes


@dataclass
class Temperature:
    """What the thermometer sends."""

    celsius: float


@dataclass
class Report:
    """What the application gets for each picture."""

    brightness: float
    celsius: float


class Lookout:
    """Reports each picture's brightness with the last temperature."""

    def __init__(self) -> None:
        self._celsius: float | None = None

    def __call__(self, picture: Picture) -> Report | None:
        """Report a picture; before the first temperature there is nothing to report."""
        if self._celsius is None or not picture.data:
            return None
        return Report(sum(picture.data) / len(picture.data), self._celsius)

    def temperature(self, temperature: Temperature) -> None:
        """Keep it for the pictures that follow."""
        self._celsius = temperature.celsius
