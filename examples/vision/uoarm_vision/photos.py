"""Photos of persons to enrol: one folder a person, named after them."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from attrs import frozen

from uoarm_vision.messages import Box
from uoarm_vision.pixels import Picture

__all__ = ["Photo", "gallery_file", "only_face", "photos_in"]


@frozen
class Photo:
    """A file with one person's face, and whose."""

    person: str
    file: Path

    def read(self) -> Picture:
        """Return the pixels.

        Raises:
            OSError: the file is not a picture.
        """
        picture = cv2.imread(str(self.file), cv2.IMREAD_COLOR)
        if picture is None:
            raise OSError(f"{self.file} cannot be read as a picture")
        return picture.astype(np.uint8, copy=False)


def photos_in(folder: Path) -> list[Photo]:
    """Return the photos below a folder, person by person.

    Raises:
        FileNotFoundError: there are none.
    """
    photos = [Photo(file.parent.name, file) for file in sorted(folder.glob("*/*.*"))]
    if not photos:
        raise FileNotFoundError(f"{folder} has no photos: expected PERSON/PHOTO.jpg")
    return photos


def only_face(photo: Photo, picture: Picture, find: Callable[[Picture], list[Box]]) -> Box:
    """Return the face of a photo.

    Raises:
        ValueError: there is none, or more than one.
    """
    boxes = find(picture)
    if len(boxes) != 1:
        raise ValueError(f"{photo.file} shows {len(boxes)} faces: enrol photos that show one")
    return boxes[0]


def gallery_file(folder: str, name: str) -> Path:
    """Return the file of what a recogniser has learnt.

    Raises:
        FileNotFoundError: no one was enrolled; the text says what to do.
    """
    file = Path(os.path.expandvars(folder)).expanduser() / name
    if not file.is_file():
        text = f"no one is enrolled: {file} is missing; demo.py makes it, and so does `enrol`"
        raise FileNotFoundError(text)
    return file
