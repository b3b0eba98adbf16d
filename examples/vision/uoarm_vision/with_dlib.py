"""Detection and recognition with dlib: sure, and the first choice where it is installed."""

from __future__ import annotations

from pathlib import Path

import cv2
import dlib
import face_recognition_models
import numpy as np
from numpy.typing import NDArray

from uoarm_vision.enrolment import photos
from uoarm_vision.messages import Box, Faces, Frame, People, Person, Pixel, pixels_of

_MODELS = Path(face_recognition_models.__file__).parent / "models"


class Detector:
    """Finds faces by histograms of oriented gradients."""

    def __init__(self) -> None:
        self._detect = dlib.get_frontal_face_detector()

    def __call__(self, frame: Frame) -> Faces:
        """Return the picture with the faces in it."""
        found = self._detect(cv2.cvtColor(pixels_of(frame), cv2.COLOR_BGR2RGB), 0)
        return {"frame": frame, "boxes": [_box(one) for one in found]}


class Recogniser:
    """Compares descriptors of 128 numbers with those of enrolled people.

    Args:
        people: folder with one folder of photos for each person.
        threshold: faces further apart than this are of different people.
    """

    def __init__(self, people: str, threshold: float = 0.6) -> None:
        self._threshold = threshold
        self._align = dlib.shape_predictor(str(_MODELS / "shape_predictor_5_face_landmarks.dat"))
        self._encode = dlib.face_recognition_model_v1(
            str(_MODELS / "dlib_face_recognition_resnet_model_v1.dat")
        )
        detect = dlib.get_frontal_face_detector()
        self._known: list[tuple[str, NDArray[np.float64]]] = []
        for name, photo in photos(people):
            rgb = cv2.cvtColor(photo, cv2.COLOR_BGR2RGB)
            for face in detect(rgb, 1):
                self._known.append((name, self._describe(rgb, face)))

    def __call__(self, faces: Faces) -> People:
        """Return the picture with a name for every face."""
        rgb = cv2.cvtColor(pixels_of(faces["frame"]), cv2.COLOR_BGR2RGB)
        return {
            "frame": faces["frame"],
            "people": [self._name(rgb, box) for box in faces["boxes"]],
        }

    def _name(self, rgb: Pixel, box: Box) -> Person:
        where = dlib.rectangle(box["left"], box["top"], box["right"], box["bottom"])
        descriptor = self._describe(rgb, where)
        distances = [
            (float(np.linalg.norm(known - descriptor)), name) for name, known in self._known
        ]
        distance, name = min(distances)
        if distance > self._threshold:
            name = "unknown"
        return {"name": name, "distance": distance, "box": box}

    def _describe(self, rgb: Pixel, face: dlib.rectangle) -> NDArray[np.float64]:
        return np.array(self._encode.compute_face_descriptor(rgb, self._align(rgb, face)))


def _box(face: dlib.rectangle) -> Box:
    return {"left": face.left(), "top": face.top(), "right": face.right(), "bottom": face.bottom()}
