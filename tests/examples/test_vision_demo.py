"""The demo as a stranger runs it: with dlib, without it, without npm, and interrupted."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from attrs import evolve
from rich.console import Console
from tests.processes import run_python
from uoarm_vision.messages import Box, Frame, People
from vision_demo.footage import TALKING, Footage
from vision_demo.packages import FootageError
from vision_demo.run import Result, enrol_persons
from vision_demo.tally import Tally

from uoarm import RobotManager, StatusMap
from uoarm.model import Rejection, RouteStatus
from uoarm.testing import patience, wait


def run(vision: Path, output: Path, *options: str, **environment: str) -> tuple[int, Any, str]:
    done = run_python(vision / "demo.py", "--json", "--output", output, *options, env=environment)
    return done.returncode, json.loads(done.stdout) if done.stdout else None, done.stderr


def test_a_folder_that_cannot_be_made_is_reported_before_anything_is_fetched(
    vision: Path, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.touch()
    code, _, said = run(vision, file / "folder", UOARM_CACHE=str(tmp_path / "cache"))
    assert code == 2
    assert "Traceback" not in said
    assert str(file) in said
    assert not (tmp_path / "cache").exists()


@pytest.fixture
def brief(vision: Path, tmp_path: Path) -> Path:
    """The example with a third of each film, as dlib takes its time for every picture."""
    copied = shutil.copytree(vision, tmp_path / "brief")
    text = (copied / "robot.yaml").read_text(encoding="utf-8")
    assert "excerpt: 90" in text
    (copied / "robot.yaml").write_text(text.replace("excerpt: 90", "excerpt: 30"), encoding="utf-8")
    return copied


def test_every_person_is_recognised_for_who_they_are(
    brief: Path, footage: Footage, cache: Path, tmp_path: Path
) -> None:
    code, result, text = run(brief, tmp_path, UOARM_CACHE=str(cache.parent))
    assert code == 0, text
    assert result["plan"] == ["recorded", "hog_detector", "resnet_recogniser"]
    assert result["passed_over"] == []
    assert set(result["seen"]) == {name for name in footage.expected.values() if name}
    for source, person in footage.expected.items():
        assert set(result["by_source"][source]) == {person or "unknown"}
    assert (result["mistakes"], result["lost"], result["dropped"]) == (0, 0, 0)
    assert "plan for faceRecognition" in text
    picture = cv2.imread(result["picture"])
    assert picture is not None
    assert picture.shape[0] == 360


def test_without_dlib_lighter_candidates_are_chosen_and_the_reason_shown(
    vision: Path, footage: Footage, tmp_path: Path
) -> None:
    code, result, text = run(vision, tmp_path, "--light")
    assert code == 0, text
    assert result["plan"] == ["recorded", "haar_detector", "lbph_recogniser"]
    assert set(result["passed_over"]) == {"hog_detector", "resnet_recogniser"}
    assert "needs the package 'dlib', which is not installed" in text
    assert set(result["seen"]) == {name for name in footage.expected.values() if name}
    assert (result["lost"], result["dropped"]) == (0, 0)


@pytest.fixture
def without_npm(footage: Footage, cache: Path, tmp_path: Path) -> dict[str, str]:
    """An environment in which pip is found and npm is not."""
    del footage
    tools, packages = tmp_path / "tools", tmp_path / "cache" / "vision" / "packages"
    tools.mkdir()
    pip = shutil.which("pip")
    if pip is not None:
        (tools / "pip").symlink_to(pip)
    packages.mkdir(parents=True)
    for file in (cache / "packages").iterdir():
        if file.is_file() and file.name != TALKING.file:
            shutil.copy(file, packages)
    return {"PATH": str(tools), "UOARM_CACHE": str(tmp_path / "cache")}


def test_without_npm_the_demo_goes_on_with_what_pip_gives(
    brief: Path, without_npm: dict[str, str], tmp_path: Path
) -> None:
    code, result, text = run(brief, tmp_path, **without_npm)
    assert code == 0, text
    assert "npm is not installed" in text
    assert set(result["seen"]) == {"Passenger", "Obama"}
    assert result["by_source"]["4-biden.jpg"] == {"unknown": 1}
    assert result["mistakes"] == 0


def test_without_npm_and_without_dlib_it_goes_on_too(
    vision: Path, without_npm: dict[str, str], tmp_path: Path
) -> None:
    code, result, text = run(vision, tmp_path, "--light", **without_npm)
    assert code == 0, text
    assert result["plan"] == ["recorded", "haar_detector", "lbph_recogniser"]
    assert set(result["seen"]) == {"Passenger", "Obama"}


def test_no_footage_is_an_error_that_says_what_to_do(vision: Path, tmp_path: Path) -> None:
    offline = {"PIP_NO_INDEX": "1", "PIP_CONFIG_FILE": os.devnull, "PIP_FIND_LINKS": ""}
    code, result, text = run(vision, tmp_path, UOARM_CACHE=str(tmp_path), **offline)
    assert code == 2
    assert result is None
    assert "Without a network: fetch it on another machine" in text


@pytest.mark.usefixtures("footage")
def test_an_interrupt_closes_everything(vision: Path, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-u", str(vision / "demo.py"), "--output", str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    with process.stdout as lines:
        for line in lines:
            if line.startswith("I see"):
                break
        process.send_signal(signal.SIGINT)
        rest = lines.read()
    assert process.wait(timeout=patience()) == 130
    assert "interrupted; everything is closed" in rest


def test_a_photo_without_a_face_is_reported_and_leaves_no_thread(
    vision: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread of the progress bar that goes on keeps the whole program from ending."""
    photo = tmp_path / "photos" / "Stranger" / "1.png"
    photo.parent.mkdir(parents=True)
    cv2.imwrite(str(photo), np.zeros((64, 64, 3), np.uint8))
    monkeypatch.setenv("UOARM_VISION", str(tmp_path))
    with RobotManager.from_file(vision / "robot.yaml") as robot:
        plan = robot.resolve("faceRecognition")
    before = set(threading.enumerate())
    with pytest.raises(FootageError, match=r"1\.png shows 0 faces") as caught:
        enrol_persons(plan, Footage(tmp_path, {}), Console(quiet=True))
    assert caught.value.__cause__ is not None
    wait(lambda: set(threading.enumerate()) <= before)  # rich signals its thread, and does not join


def message(source: str, *names: str | None) -> People:
    box: Box = {"x": 0, "y": 0, "width": 1, "height": 1}
    frame: Frame = {
        "source": source,
        "sequence": 0,
        "time": 0.0,
        "width": 1,
        "height": 1,
        "encoding": "bgr8",
        "data": b"...",
    }
    return {
        "frame": frame,
        "persons": [{"box": box, "name": name, "distance": 0.0} for name in names],
    }


def test_tally_counts_pictures_mistakes_and_those_who_were_missed() -> None:
    tally = Tally({"a": "Ann", "b": "Bob", "s": None})
    assert tally.add(message("a", "Ann", "Ann")) == ["Ann"]
    assert tally.add(message("a", "Ann", None)) == []
    assert tally.add(message("b", "Ann")) == []
    assert tally.add(message("b")) == []
    assert tally.add(message("s", "Ann")) == []
    assert tally.names() == Counter({"Ann": 4, None: 1})
    assert tally.mistakes() == 2
    assert tally.missed() == ["Bob"]
    assert not tally.strangers_known()


def test_a_person_must_be_named_in_more_than_half_of_the_pictures() -> None:
    tally = Tally({"a": "Ann"})
    tally.add(message("a", "Ann"))
    tally.add(message("a"))
    assert tally.missed() == ["Ann"]
    tally.add(message("a", "Ann"))
    assert tally.missed() == []


def test_a_person_who_was_never_played_counts_as_missed() -> None:
    assert Tally({"a": "Ann", "s": None}).missed() == ["Ann"]


@pytest.fixture
def perfect(vision: Path) -> Result:
    """What a run comes to in which everything is right."""
    with RobotManager.from_file(vision / "robot.yaml") as robot:
        plan = robot.resolve("faceRecognition")
    tally = Tally({"a": "Ann", "s": None})
    tally.add(message("a", "Ann"))
    tally.add(message("s", None))
    return Result(plan, tally, 2, StatusMap(), Path("faces.png"))


def test_a_perfect_run_has_no_problems(perfect: Result) -> None:
    assert perfect.problems == []
    assert json.loads(perfect.as_json())["ok"]


def test_lost_pictures_and_dropped_messages_are_problems(perfect: Result) -> None:
    assert evolve(perfect, sent=3).problems == ["1 pictures were lost, 0 messages dropped"]
    route = RouteStatus("a", "b", received=5, delivered=1, dropped=(("failed", 3), ("x", 1)))
    dropping = evolve(perfect, status=StatusMap(routes=(route,)))
    assert dropping.problems == ["0 pictures were lost, 4 messages dropped"]


def test_a_person_who_is_not_recognised_is_a_problem(perfect: Result) -> None:
    perfect.tally.expected = {"a": "Bob", "s": None}
    assert "Bob was not recognised" in perfect.problems


def test_mistakes_are_forgiven_only_where_better_candidates_were_passed_over(
    perfect: Result,
) -> None:
    perfect.tally.add(message("s", "Ann"))
    mistaken = evolve(perfect, sent=3)
    assert mistaken.problems == ["a person was mistaken in 1 pictures"]
    rejected = (Rejection("faceRecognition", "resnet_recogniser", 20, ()),)
    assert evolve(mistaken, plan=evolve(mistaken.plan, rejected=rejected)).problems == []
