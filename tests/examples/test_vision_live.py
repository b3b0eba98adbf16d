"""The vision example for browsers: its recordings never end."""

from __future__ import annotations

import socket
import sys
from itertools import islice
from pathlib import Path
from unittest.mock import Mock

import cv2
import live
import numpy as np
import pytest
from live import RATE, endless
from rich.console import Console
from tests.processes import run_python
from uoarm_vision.messages import Frame

from uoarm import RobotManager

EXAMPLE = Path(__file__).parents[2] / "examples" / "vision" / "robot.yaml"


def test_an_interrupt_before_it_serves_ends_it_as_one_afterwards_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(port: int, console: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(live, "serve", interrupted)
    monkeypatch.setattr(sys, "argv", ["live.py"])
    assert live.main() == 0


@pytest.mark.parametrize(("program", "code"), [("live.py", 0), ("demo.py", 130)])
def test_an_interrupt_while_it_imports_shows_no_traceback(
    program: str, code: int, tmp_path: Path
) -> None:
    package = tmp_path / "rich"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "console.py").write_text("raise KeyboardInterrupt")
    done = run_python(EXAMPLE.parent / program, env={"PYTHONPATH": str(tmp_path)})
    assert (done.returncode, done.stderr) == (code, "")


def test_a_port_that_is_none_is_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["live.py", "--port", "65536"])
    assert live.main() == 2
    assert "port must be 0-65535" in capsys.readouterr().out


def test_a_port_that_is_taken_is_reported_before_anything_is_fetched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UOARM_CACHE", str(tmp_path / "cache"))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(OSError, match=f"port {port} is in use.*PORT="):
            live.serve(port, Console())
    assert not (tmp_path / "cache").exists()


def test_the_address_that_it_prints_shows_the_pictures() -> None:
    console = Console(record=True, width=40)
    live.announce(console, Mock(ports=(9080,)))
    text = console.export_text()
    assert "http://127.0.0.1:9080/#/graph/function/faceRecognition/use\n" in text
    assert "press Watch" in text


def test_its_recordings_play_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    playlist = tmp_path / "playlist"
    playlist.mkdir()
    for name in ("a", "b"):
        cv2.imwrite(str(playlist / f"{name}.png"), np.zeros((8, 8, 3), np.uint8))
    monkeypatch.setenv("UOARM_VISION", str(tmp_path))
    robot = endless(EXAMPLE)
    [camera] = robot.functions["camera"].components
    assert camera.outputs[0].endpoint.parameters["rate"] == RATE
    with RobotManager(robot) as manager, manager.request("camera") as frames:
        played: list[Frame] = list(islice(frames, 5))
    assert [item["source"] for item in played] == ["a.png", "b.png", "a.png", "b.png", "a.png"]
