"""The camera: what it plays, in which order, how fast, and what it says when it cannot."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from uoarm_vision.camera import camera, count
from uoarm_vision.pixels import as_frame, as_picture


def write_picture(file: Path, grey: int) -> None:
    assert cv2.imwrite(str(file), np.full((48, 64, 3), grey, np.uint8))


def write_video(file: Path, greys: list[int]) -> None:
    video = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for grey in greys:
        video.write(np.full((48, 64, 3), grey, np.uint8))
    video.release()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_video(tmp_path / "1.avi", [10, 20, 30, 40])
    write_picture(tmp_path / "2.png", 200)
    (tmp_path / "notes.txt").write_text("not a picture")
    return tmp_path


def test_folder_is_played_in_the_order_of_names(folder: Path) -> None:
    frames = list(camera(str(folder)))
    assert [frame["source"] for frame in frames] == ["1.avi"] * 4 + ["2.png"]
    assert [frame["sequence"] for frame in frames] == [0, 1, 2, 3, 4]
    greys = [float(as_picture(frame).mean()) for frame in frames]
    assert np.allclose(greys, [10, 20, 30, 40, 200], atol=3)
    sizes = {(frame["width"], frame["height"], len(frame["data"])) for frame in frames}
    assert sizes == {(64, 48, 64 * 48 * 3)}


@pytest.mark.parametrize(("excerpt", "pictures"), [(0, 5), (2, 3), (1, 2), (9, 5)])
def test_excerpt_limits_each_video_and_count_agrees(
    folder: Path, excerpt: int, pictures: int
) -> None:
    assert len(list(camera(str(folder), excerpt=excerpt))) == pictures
    assert count(str(folder), excerpt) == pictures


def test_limit_and_loop(folder: Path) -> None:
    assert len(list(camera(str(folder), limit=2))) == 2
    looped = list(camera(str(folder), limit=12, loop=True))
    assert [frame["sequence"] for frame in looped] == list(range(12))
    assert looped[11]["source"] == "1.avi"


def test_path_may_name_a_variable(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOME_FOOTAGE", str(folder))
    assert next(camera("$SOME_FOOTAGE/2.png"))["source"] == "2.png"


class Clock:
    """Stands in for time, which passes only where a thread sleeps."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.waits: list[float] = []
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        monkeypatch.setattr(time, "sleep", self.sleep)

    def sleep(self, seconds: float) -> None:
        self.waits.append(seconds)
        self.now += seconds


def test_rate_waits_until_a_picture_is_due(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    list(camera(str(folder), rate=4))
    assert clock.waits == [0.0, 0.25, 0.25, 0.25, 0.25]


def test_rate_does_not_hurry_after_a_late_picture(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock(monkeypatch)
    frames = camera(str(folder), rate=4)
    next(frames)
    clock.now += 10.0
    assert len(list(itertools.islice(frames, 3))) == 3
    assert clock.waits == [0.0, 0.0, 0.25, 0.25]


def test_nothing_to_play(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="does not exist"):
        next(camera(str(tmp_path / "missing.mp4")))
    with pytest.raises(FileNotFoundError, match="no pictures or videos"):
        next(camera(str(tmp_path)))
    with pytest.raises(FileNotFoundError, match="no such variable is set"):
        next(camera("$NO_SUCH_VARIABLE_HERE/playlist"))


@pytest.mark.parametrize(("name", "text"), [("a.jpg", "as a picture"), ("a.mp4", "as a video")])
def test_broken_files_are_named(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_bytes(b"not what the name says")
    with pytest.raises(OSError, match=f"{name}.*{text}"):
        next(camera(str(tmp_path / name)))


def test_a_video_without_a_picture_is_no_end_in_order(tmp_path: Path) -> None:
    """Looped, it would be opened again and again, and nothing would ever come."""
    write_video(tmp_path / "empty.avi", [])
    for loop in (False, True):
        with pytest.raises(OSError, match=r"empty\.avi has no pictures"):
            next(camera(str(tmp_path / "empty.avi"), loop=loop))


@pytest.fixture
def device(folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """A camera that is unplugged after four pictures."""

    capture = cv2.VideoCapture()

    class Device:  # a subclass of OpenCV's crashes as it is collected
        read, release = capture.read, capture.release

        def open(self, number: object) -> bool:
            assert number == 7
            return bool(capture.open(str(folder / "1.avi")))

    monkeypatch.setattr(cv2, "VideoCapture", Device)
    return 7


def test_a_device_that_gives_no_more_pictures_is_lost(device: int) -> None:
    frames = camera(device)
    assert [frame["source"] for frame in itertools.islice(frames, 4)] == ["device 7"] * 4
    with pytest.raises(OSError, match="device 7 gives no more pictures"):
        next(frames)
    assert len(list(camera(str(device), limit=3))) == 3


def test_a_device_keeps_its_own_rate(device: int, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    assert len(list(camera(device, rate=4, limit=4))) == 4
    assert clock.waits == []


def test_octets_must_match_width_and_height() -> None:
    frame = as_frame(np.zeros((4, 6, 3), np.uint8), "test", 0)
    frame["width"] = 7
    with pytest.raises(ValueError, match="test: 7 x 4 pixels need 84 octets, got 72"):
        as_picture(frame)
