"""Detectors and recognisers on real photos, called directly."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from uoarm_vision import lbph, resnet
from uoarm_vision.camera import camera
from uoarm_vision.haar import HaarDetector
from uoarm_vision.hog import HogDetector
from uoarm_vision.lbph import LbphRecogniser
from uoarm_vision.messages import Box, Faces, Frame, People
from uoarm_vision.photos import Photo, photos_in
from uoarm_vision.pixels import Picture, as_frame, as_picture, boxed
from uoarm_vision.resnet import Describer, ResnetRecogniser
from vision_demo.footage import Footage

Detector = Callable[[Frame], Faces]
Chain = tuple[Detector, Callable[[Faces], People]]
Enrol = Callable[[Iterable[Photo], Path], None]

EMPTY = as_frame(np.full((240, 320, 3), 128, np.uint8), "grey", 0)


@pytest.fixture(scope="module")
def accurate(footage: Footage, tmp_path_factory: pytest.TempPathFactory) -> Chain:
    gallery = tmp_path_factory.mktemp("resnet")
    resnet.enrol(photos_in(footage.photos), gallery)
    return HogDetector(), ResnetRecogniser(str(gallery))


@pytest.fixture(scope="module")
def light(footage: Footage, tmp_path_factory: pytest.TempPathFactory) -> Chain:
    gallery = tmp_path_factory.mktemp("lbph")
    lbph.enrol(photos_in(footage.photos), gallery)
    return HaarDetector(), LbphRecogniser(str(gallery))


def still(footage: Footage, name: str) -> Frame:
    file = next(path for path in sorted(footage.playlist.iterdir()) if name in path.name)
    return next(camera(str(file)))


def names(chain: Chain, frame: Frame) -> list[str | None]:
    detect, recognise = chain
    return [person["name"] for person in recognise(detect(frame))["persons"]]


@pytest.fixture(scope="module", params=[HogDetector, HaarDetector])
def detector(request: pytest.FixtureRequest) -> Detector:
    """Built where it is used: to read a model takes longer than all that is collected."""
    built: Detector = request.param()
    return built


@pytest.mark.parametrize(
    ("name", "inside"), [("obama", (300, 440)), ("biden", (590, 370)), ("passenger", (90, 65))]
)
def test_detectors_find_the_one_face(
    footage: Footage, detector: Detector, name: str, inside: tuple[int, int]
) -> None:
    boxes = detector(still(footage, name))["boxes"]
    assert len(boxes) == 1
    assert boxes[0]["x"] < inside[0] < boxes[0]["x"] + boxes[0]["width"]
    assert boxes[0]["y"] < inside[1] < boxes[0]["y"] + boxes[0]["height"]


def test_detectors_find_no_face_in_an_empty_picture(detector: Detector) -> None:
    assert detector(EMPTY)["boxes"] == []


def test_accurate_chain_names_every_person_rightly(footage: Footage, accurate: Chain) -> None:
    for name, person in footage.expected.items():
        assert names(accurate, still(footage, name)) == [person], name


def test_light_chain_names_those_who_are_enrolled(footage: Footage, light: Chain) -> None:
    for name, person in footage.expected.items():
        if person is not None:
            assert names(light, still(footage, name)) == [person], name


def test_light_chain_does_not_know_the_passenger(footage: Footage, light: Chain) -> None:
    if footage.expected.get("3-passenger.mp4", "enrolled") is None:
        assert names(light, still(footage, "passenger")) == [None]


def test_no_person_is_recognised_without_a_face(accurate: Chain, light: Chain) -> None:
    assert names(accurate, EMPTY) == names(light, EMPTY) == []


def test_descriptors_are_near_for_one_person_and_far_for_two(footage: Footage) -> None:
    detector, describer = HogDetector(), Describer()
    described = []
    for photo in photos_in(footage.photos):
        picture = photo.read()
        described.append((photo.person, describer.describe(picture, detector.find(picture)[0])))
    for (person, ndarray), (other, two) in combinations(described, 2):
        distance = float(np.linalg.norm(ndarray - two))
        if person == other:
            assert distance < 0.55
        else:
            assert distance > 0.65


def thumbnail(picture: Picture) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return cv2.resize(picture, (48, 32), interpolation=cv2.INTER_AREA).astype(np.float64)


def test_no_picture_is_both_enrolled_and_played(footage: Footage) -> None:
    enrolled = [thumbnail(photo.read()) for photo in photos_in(footage.photos)]
    for frame in camera(str(footage.playlist), excerpt=90):
        played = thumbnail(as_picture(frame))
        nearest = min(float(np.abs(played - ndarray).mean()) for ndarray in enrolled)
        assert nearest > 2.5, f"{frame['source']}, picture {frame['sequence']}"


@pytest.mark.parametrize("enrol", [resnet.enrol, lbph.enrol])
def test_enrolling_refuses_photos_without_a_face(tmp_path: Path, enrol: Enrol) -> None:
    photos = tmp_path / "photos"
    (photos / "Stranger").mkdir(parents=True)
    assert cv2.imwrite(str(photos / "Stranger" / "grey.png"), as_picture(EMPTY))
    with pytest.raises(ValueError, match=r"grey\.png shows 0 faces"):
        enrol(photos_in(photos), tmp_path / "gallery")
    assert not (tmp_path / "gallery").exists()


@pytest.mark.parametrize("recogniser", [ResnetRecogniser, LbphRecogniser])
def test_recognisers_say_that_no_person_is_enrolled(
    tmp_path: Path, recogniser: Callable[[str], object]
) -> None:
    with pytest.raises(FileNotFoundError, match="no one is enrolled"):
        recogniser(str(tmp_path))


def test_no_photos_to_enrol(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no photos"):
        photos_in(tmp_path)


@pytest.mark.parametrize(
    ("edges", "expected"),
    [
        ((10, 20, 30, 50), {"x": 10, "y": 20, "width": 20, "height": 30}),
        ((-9, -9, 30, 50), {"x": 0, "y": 0, "width": 30, "height": 50}),
        ((90, 70, 200, 200), {"x": 90, "y": 70, "width": 10, "height": 10}),
        ((300, 300, 400, 400), {"x": 99, "y": 79, "width": 1, "height": 1}),
    ],
)
def test_boxes_are_cut_at_the_edges(
    edges: tuple[float, float, float, float], expected: Box
) -> None:
    assert boxed(np.zeros((80, 100, 3), np.uint8), *edges) == expected
