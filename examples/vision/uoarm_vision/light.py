"""Detection and recognition with OpenCV alone: for small machines, and less sure."""

from __future__ import annotations

import cv2
import numpy as np

from uoarm_vision.enrolment import photos
from uoarm_vision.messages import Box, Faces, Frame, People, Person, Pixel, pixels_of

_SIDE = (100, 100)
_CASCADE = "haarcascade_frontalface_default.xml"


def _cascade() -> cv2.CascadeClassifier:
    return cv2.CascadeClassifier(cv2.data.haarcascades + _CASCADE)  # type: ignore[attr-defined] # not in its stubs


class Detector:
    """Finds faces with a Haar cascade."""

    def __init__(self) -> None:
        self._cascade = _cascade()

    def __call__(self, frame: Frame) -> Faces:
        """Return the picture with the faces in it."""
        return {"frame": frame, "boxes": _find(self._cascade, pixels_of(frame))}


class Recogniser:
    """Compares local binary patterns with those of enrolled people.

    Args:
        people: folder with one folder of photos for each person.
        threshold: faces further apart than this are of different people.
    """

    def __init__(self, people: str, threshold: float = 100.0) -> None:
        self._threshold = threshold
        self._names: list[str] = []
        cascade, faces, labels = _cascade(), [], []
        for name, photo in photos(people):
            if name not in self._names:
                self._names.append(name)
            for box in _find(cascade, photo)[:1]:
                faces.append(_face(photo, box))
                labels.append(self._names.index(name))
        self._model = cv2.face.LBPHFaceRecognizer_create()  # type: ignore[attr-defined] # not in its stubs
        self._model.train(faces, np.array(labels))

    def __call__(self, faces: Faces) -> People:
        """Return the picture with a name for every face."""
        picture = pixels_of(faces["frame"])
        people = [self._name(picture, box) for box in faces["boxes"]]
        return {"frame": faces["frame"], "people": people}

    def _name(self, picture: Pixel, box: Box) -> Person:
        label, distance = self._model.predict(_face(picture, box))
        name = self._names[label] if distance <= self._threshold else "unknown"
        return {"name": name, "distance": float(distance), "box": box}


def _find(cascade: cv2.CascadeClassifier, picture: Pixel) -> list[Box]:
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    found = cascade.detectMultiScale(grey, 1.1, 6, minSize=(60, 60))
    return [
        {"left": int(x), "top": int(y), "right": int(x + w), "bottom": int(y + h)}
        for x, y, w, h in found
    ]


def _face(picture: Pixel, box: Box) -> Pixel:
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    part = grey[max(box["top"], 0) : box["bottom"], max(box["left"], 0) : box["right"]]
    return cv2.equalizeHist(cv2.resize(part, _SIDE))
