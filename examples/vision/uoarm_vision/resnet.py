"""Face recognition with dlib's residual network: 128 numbers a face, near for one person."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import cv2
import dlib
import face_recognition_models as models
import numpy as np
from numpy.typing import NDArray

from uoarm_vision.hog import HogDetector
from uoarm_vision.messages import Box, Faces, People, Person
from uoarm_vision.photos import Photo, gallery_file, only_face
from uoarm_vision.pixels import Picture, as_picture

__all__ = ["Describer", "ResnetRecogniser", "enrol"]

_FILE = "resnet.npz"


class Describer:
    """Turns faces into descriptors: align by five points, then run the network."""

    def __init__(self) -> None:
        self._align = dlib.shape_predictor(models.pose_predictor_five_point_model_location())
        self._network = dlib.face_recognition_model_v1(models.face_recognition_model_location())

    def describe(self, picture: Picture, box: Box) -> NDArray[np.float64]:
        """Return the 128 numbers of a face."""
        rgb = np.ascontiguousarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
        left, top = box["x"], box["y"]
        face = dlib.rectangle(left, top, left + box["width"], top + box["height"])
        return np.array(self._network.compute_face_descriptor(rgb, self._align(rgb, face)))


class ResnetRecogniser:
    """Names the faces of those who were enrolled.

    Args:
        gallery: folder where `enrol` left what it learnt; `~` and `$NAME` are replaced.
        threshold: Euclidean distance up to which two faces are one person's.
    """

    def __init__(self, gallery: str, threshold: float = 0.6) -> None:
        with np.load(gallery_file(gallery, _FILE), allow_pickle=False) as learnt:
            self._names: list[str] = learnt["names"].tolist()
            self._descriptors: NDArray[np.float64] = learnt["descriptors"]
        self._threshold = threshold
        self._describer = Describer()

    def __call__(self, faces: Faces) -> People:
        """Return the frame with the persons in it."""
        picture = as_picture(faces["frame"])
        persons = [self._recognise(picture, box) for box in faces["boxes"]]
        return {"frame": faces["frame"], "persons": persons}

    def _recognise(self, picture: Picture, box: Box) -> Person:
        found = self._describer.describe(picture, box)
        distances = np.linalg.norm(self._descriptors - found, axis=1)
        nearest = int(distances.argmin())
        distance = float(distances[nearest])
        name = self._names[nearest] if distance <= self._threshold else None
        return {"box": box, "name": name, "distance": distance}


def enrol(photos: Iterable[Photo], gallery: Path) -> None:
    """Learn persons from photos, and leave what was learnt in a folder.

    Raises:
        ValueError: a photo does not show exactly one face.
        OSError: a photo cannot be read.
    """
    detector, describer = HogDetector(), Describer()
    names, descriptors = [], []
    for photo in photos:
        picture = photo.read()
        face = only_face(photo, picture, detector.find)
        names.append(photo.person)
        descriptors.append(describer.describe(picture, face))
    gallery.mkdir(parents=True, exist_ok=True)
    unfinished = gallery / f"{os.getpid()}-{_FILE}"
    np.savez(unfinished, names=np.array(names), descriptors=np.array(descriptors))
    unfinished.replace(gallery / _FILE)
