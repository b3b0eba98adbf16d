"""One picture with what was recognised: the clearest frame of every source, side by side."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from attrs import define, field
from uoarm_vision.messages import People, Person
from uoarm_vision.pixels import Picture, as_picture

__all__ = ["Album"]

_HEIGHT = 360
_KNOWN = (80, 200, 60)
_UNKNOWN = (40, 140, 255)
_INK = (20, 20, 20)


@define
class Album:
    """Keeps one message of every source: the one whose faces were recognised most clearly."""

    _best: dict[str, People] = field(factory=dict)

    def add(self, message: People) -> None:
        """Keep a message if it shows its source better than any before."""
        source = message["frame"]["source"]
        kept = self._best.get(source)
        if kept is None or _clearness(message) > _clearness(kept):
            self._best[source] = message

    def write(self, file: Path) -> Path:
        """Write the picture and return its path.

        Raises:
            ValueError: nothing was added.
            OSError: the file cannot be written.
        """
        if not self._best:
            raise ValueError("there is nothing to draw: no message came")
        panels = [_panel(self._best[source]) for source in sorted(self._best)]
        if not cv2.imwrite(str(file), np.hstack(panels)):
            raise OSError(f"{file} cannot be written")
        return file


def _clearness(message: People) -> tuple[int, float]:
    """Order messages: a name, the surer the better, before one stranger before no one."""
    persons = message["persons"]
    named = [person["distance"] for person in persons if person["name"] is not None]
    if named:
        return 2, -min(named)
    return (1, -len(persons)) if persons else (0, 0)


def _panel(message: People) -> Picture:
    whole = as_picture(message["frame"])
    factor = _HEIGHT / whole.shape[0]
    size = round(whole.shape[1] * factor), _HEIGHT
    panel = cv2.resize(whole, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
    for person in message["persons"]:
        _draw(panel, person, factor)
    return panel


def _draw(panel: Picture, person: Person, factor: float) -> None:
    box = person["box"]
    left, top = round(box["x"] * factor), round(box["y"] * factor)
    right = round((box["x"] + box["width"]) * factor)
    bottom = round((box["y"] + box["height"]) * factor)
    colour = _UNKNOWN if person["name"] is None else _KNOWN
    label = f"{person['name'] or 'unknown'} {person['distance']:.2f}"
    (width, height), _ = cv2.getTextSize(label, cv2.FONT_HERSHEY_DUPLEX, 0.5, 1)
    begin = max(0, min(left, panel.shape[1] - width - 8))
    under = max(top, height + 10)
    cv2.rectangle(panel, (left, top), (right, bottom), colour, 2)
    cv2.rectangle(panel, (begin, under - height - 10), (begin + width + 8, under), colour, -1)
    cv2.putText(panel, label, (begin + 4, under - 5), cv2.FONT_HERSHEY_DUPLEX, 0.5, _INK, 1)
