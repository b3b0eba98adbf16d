"""Enrolled people: a folder with one folder of photos for each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2

from uoarm_vision.messages import Pixel

_WIDTH = 500


def photos(folder: str) -> Iterator[tuple[str, Pixel]]:
    """Yield name and photo of every enrolled person."""
    people = sorted(one for one in Path(folder).iterdir() if one.is_dir())
    if not people:
        raise FileNotFoundError(f"nobody is enrolled in {folder}")
    for person in people:
        for file in sorted(person.iterdir()):
            photo = cv2.imread(str(file))
            if photo is None:
                raise ValueError(f"{file} is not a picture")
            height = round(photo.shape[0] * _WIDTH / photo.shape[1])
            yield person.name, cv2.resize(photo, (_WIDTH, height))
