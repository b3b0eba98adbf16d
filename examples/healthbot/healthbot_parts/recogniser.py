"""Face recognition in plain Python: dlib's network where it is installed, else OpenCV's histograms.

Both are the components of the vision example, shown the one face that the detector cut out.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from uoarm_vision.messages import Box, Frame

from healthbot_parts.messages import Faces, People, Person

__all__ = ["LightRecogniser", "NetworkRecogniser"]


class _Recogniser:
    """Names the largest face.

    Args:
        learnt: the recogniser of the vision example.
        detector: of the vision example; it finds the face again, tighter, within the cut-out.
    """

    def __init__(self, learnt: Any, detector: Any) -> None:
        self._learnt = learnt
        self._detector = detector

    def __call__(self, faces: Faces) -> People:
        """Return who is there."""
        face = faces["face"]
        width, height = face["width"], face["height"]
        if not width or not height:
            return {"persons": []}
        frame: Frame = {
            "source": "face",
            "sequence": 0,
            "time": 0.0,
            "width": width,
            "height": height,
            "encoding": "bgr8",
            "data": bytes(face["data"]),
        }
        pixels = np.frombuffer(frame["data"], np.uint8).reshape(height, width, 3)
        boxes: list[Box] = self._detector.find(pixels)
        people = self._learnt({"frame": frame, "boxes": boxes[:1]})
        return {"persons": [_person(person) for person in people["persons"]]}


class NetworkRecogniser(_Recogniser):
    """Names faces by dlib's descriptors.

    Args:
        gallery: folder with what was learnt; `$NAME` is replaced from the environment.
        threshold: distance up to which two faces are one person's.
    """

    def __init__(self, gallery: str, threshold: float = 0.6) -> None:
        hog = importlib.import_module("uoarm_vision.hog")
        resnet = importlib.import_module("uoarm_vision.resnet")
        super().__init__(resnet.ResnetRecogniser(gallery, threshold), hog.HogDetector(320))


class LightRecogniser(_Recogniser):
    """Names faces by local binary patterns; mixes people up now and then.

    Args:
        gallery: folder with what was learnt; `$NAME` is replaced from the environment.
        threshold: distance of histograms up to which two faces are one person's.
    """

    def __init__(self, gallery: str, threshold: float = 100.0) -> None:
        haar = importlib.import_module("uoarm_vision.haar")
        lbph = importlib.import_module("uoarm_vision.lbph")
        super().__init__(lbph.LbphRecogniser(gallery, threshold), haar.HaarDetector(320))


def _person(person: Any) -> Person:
    return {"name": person["name"], "distance": person["distance"]}
