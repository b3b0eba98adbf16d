"""The chain through the manager: it fits, it is proven to fit, and what does not is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from uoarm_vision import resnet
from uoarm_vision.photos import photos_in
from vision_demo.footage import Footage

from uoarm import OverflowPolicy, QueuePolicy, ResolutionError, RobotManager
from uoarm.config import loads
from uoarm.model import Robot
from uoarm.testing import patience


def robot_without(vision: Path, *names: str) -> Robot:
    """Return the example's robot with some candidates left out."""
    file = vision / "robot.yaml"
    tree = yaml.safe_load(file.read_text(encoding="utf-8"))
    for function in tree["functions"].values():
        function["components"] = [
            component for component in function["components"] if component["name"] not in names
        ]
    return loads(yaml.safe_dump(tree), str(file))


@pytest.fixture
def filled(footage: Footage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Footage:
    """Footage, with a gallery of this test."""
    (tmp_path / "playlist").symlink_to(footage.playlist)
    resnet.enrol(photos_in(footage.photos), tmp_path / "gallery")
    monkeypatch.setenv("UOARM_VISION", str(tmp_path))
    return footage


def test_plan_takes_the_candidates_of_highest_priority(vision: Path) -> None:
    with RobotManager.from_file(vision / "robot.yaml") as robot:
        plan = robot.resolve("faceRecognition")
    chosen = [step.component.name for step in plan.steps]
    assert chosen == ["recorded", "hog_detector", "resnet_recogniser"]
    assert plan.rejected == ()
    assert {(edge.producer, edge.consumer) for edge in plan.edges} == {
        ("recorded", "hog_detector"),
        ("hog_detector", "resnet_recogniser"),
    }


@pytest.mark.parametrize(("detector", "other"), [("hog", "haar"), ("haar", "hog")])
@pytest.mark.parametrize(("recogniser", "rest"), [("resnet", "lbph"), ("lbph", "resnet")])
def test_every_detector_fits_every_recogniser(
    vision: Path, detector: str, other: str, recogniser: str, rest: str
) -> None:
    chosen = robot_without(vision, f"{other}_detector", f"{rest}_recogniser")
    with RobotManager(chosen) as robot:
        plan = robot.resolve("faceRecognition")
    names = [step.component.name for step in plan.steps]
    assert names == ["recorded", f"{detector}_detector", f"{recogniser}_recogniser"]
    assert len(plan.edges) == 2


def test_a_camera_of_other_pixels_is_refused_with_the_field(vision: Path, tmp_path: Path) -> None:
    messages = (vision / "uoarm_vision" / "messages.py").read_text(encoding="utf-8")
    (tmp_path / "other_messages.py").write_text(messages.replace("bgr8", "yuv422"))
    (tmp_path / "other_camera.py").write_text(
        "from collections.abc import Iterator\n"
        "from other_messages import Frame\n"
        "def camera() -> Iterator[Frame]:\n"
        "    yield from ()\n"
    )
    file = vision / "robot.yaml"
    tree = yaml.safe_load(file.read_text(encoding="utf-8"))
    tree["bridges"]["python"] = {"options": {"path": [str(tmp_path), str(vision)]}}
    camera = tree["functions"]["camera"]["components"][0]
    del camera["parameters"]
    camera["output"]["endpoint"] = ["other_camera:camera"]
    other = loads(yaml.safe_dump(tree), str(file))
    with RobotManager(other) as robot, pytest.raises(ResolutionError) as refused:
        robot.resolve("faceRecognition")
    assert "encoding" in str(refused.value)
    assert "yuv422" in str(refused.value)


def test_every_message_matches_its_structure_and_none_is_lost(
    vision: Path, filled: Footage
) -> None:
    file = vision / "robot.yaml"
    text = file.read_text(encoding="utf-8").replace("excerpt: 90", "excerpt: 3")
    everything = QueuePolicy(length=4, policy=OverflowPolicy.BLOCK, timeout=patience())
    with (
        RobotManager(loads(text, str(file))) as robot,
        robot.request("faceRecognition", validate="always", queue=everything) as people,
    ):
        seen = [
            (message["frame"]["source"], [person["name"] for person in message["persons"]])
            for message in people
        ]
    videos = [name for name in filled.expected if name.endswith(".mp4")]
    assert len(seen) == 3 * len(videos) + len(filled.expected) - len(videos)
    assert all(names == [filled.expected[source]] for source, names in seen)


NEEDS = """
version: 1
bridges:
  python:
    options:
      path: [$HERE]
      discover:
        - {component: "uoarm_vision.lbph:LbphRecogniser", parameters: {gallery: x}}
        - "uoarm_vision.haar:HaarDetector"
        - {component: "uoarm_vision.camera:camera", parameters: {path: x, excerpt: 90}}
        - {component: "uoarm_vision.resnet:ResnetRecogniser", parameters: {gallery: x}}
        - "uoarm_vision.hog:HogDetector"
functions:
  camera: {needs: {like: Frame}}
  faceDetection: {needs: {like: Faces, name: [Hog*, "*"]}}
  faceRecognition: {needs: {like: People, name: [Resnet*, "*"]}}
"""


def provided(robot: RobotManager) -> list[str]:
    """Return what provides the functions of the scene, in the order of the steps."""
    plan = robot.resolve("faceRecognition")
    return [step.component.outputs[0].endpoint.address[0] for step in plan.steps]


def test_three_lines_of_needs_choose_what_the_written_file_chooses(vision: Path) -> None:
    with RobotManager.from_file(vision / "robot.yaml") as robot:
        written = provided(robot)
    with RobotManager(loads(NEEDS.replace("$HERE", str(vision)))) as robot:
        assert provided(robot) == written
        spare = robot.config.functions["faceDetection"].components[1]
    assert spare.outputs[0].endpoint.address == ("uoarm_vision.haar:HaarDetector",)
