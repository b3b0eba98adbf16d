"""Face recognition with OpenCV's histograms of local binary patterns.

Light, and good with people who look alike each time; it takes some strangers for friends.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uoarm_vision.haar import HaarDetector
from uoarm_vision.messages import Box, Faces, People, Person
from uoarm_vision.photos import Photo, gallery_file, only_face
from uoarm_vision.pixels import Picture, as_picture

__all__ = ["LbphRecogniser", "enrol"]

if not hasattr(cv2, "face"):
    raise ImportError(
        "OpenCV's face module is missing: put opencv-contrib-python-headless<5 in the place of "
        "opencv-python-headless (the extra `vision-lbph` of uoarm instead of `vision`)"
    )

_FILE = "lbph.yml"
_SIDE = 128
_MARGIN = 0.1


class LbphRecogniser:
    """Names the faces of those who were enrolled.

    Args:
        gallery: folder where `enrol` left what it learnt; `~` and `$NAME` are replaced.
        threshold: distance of histograms up to which two faces are one person's.
    """

    def __init__(self, gallery: str, threshold: float = 100.0) -> None:
        self._model = cv2.face.LBPHFaceRecognizer.create()
        self._model.read(str(gallery_file(gallery, _FILE)))
        self._threshold = threshold

    def __call__(self, faces: Faces) -> People:
        """Return the frame with the persons in it."""
        picture = as_picture(faces["frame"])
        persons = [self._recognise(picture, box) for box in faces["boxes"]]
        return {"frame": faces["frame"], "persons": persons}

    def _recognise(self, picture: Picture, box: Box) -> Person:
        label, distance = self._model.predict(_normalised(picture, box))
        name = self._model.getLabelInfo(label) if distance <= self._threshold else None
        return {"box": box, "name": name, "distance": float(distance)}


def enrol(photos: Iterable[Photo], gallery: Path) -> None:
    """Learn persons from photos, and leave what was learnt in a folder.

    Raises:
        ValueError: a photo does not show exactly one face.
        OSError: a photo cannot be read.
    """
    detector = HaarDetector()
    model = cv2.face.LBPHFaceRecognizer.create()
    labels: dict[str, int] = {}
    faces, owners = [], []
    for photo in photos:
        picture = photo.read()
        faces.append(_normalised(picture, only_face(photo, picture, detector.find)))
        owners.append(labels.setdefault(photo.person, len(labels)))
    model.train(faces, np.array(owners, np.int32))
    for name, label in labels.items():
        model.setLabelInfo(label, name)
    gallery.mkdir(parents=True, exist_ok=True)
    unfinished = gallery / f"{os.getpid()}-{_FILE}"
    model.write(str(unfinished))
    unfinished.replace(gallery / _FILE)


def _normalised(picture: Picture, box: Box) -> NDArray[np.uint8]:
    """Return the inner part of a face, grey and of one size."""
    across, down = round(box["width"] * _MARGIN), round(box["height"] * _MARGIN)
    rows = slice(box["y"] + down, box["y"] + box["height"] - down)
    columns = slice(box["x"] + across, box["x"] + box["width"] - across)
    grey = cv2.cvtColor(picture[rows, columns], cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    return small.astype(np.uint8, copy=False)
