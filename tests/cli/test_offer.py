"""`uoarm offer`: what is offered is printed, a line each, and whether it could be."""

from __future__ import annotations

import errno
import json
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.cli.terminal import on_a_terminal

from uoarm import RobotManager
from uoarm.cli import _run, main
from uoarm.model import StatusEvent
from uoarm.testing import Background

PARTS = """
import threading
from collections.abc import Iterator


class Numbers:
    def __init__(self) -> None:
        self.over = threading.Event()

    def __iter__(self) -> Iterator[int]:
        yield 1
        self.over.wait()

    def close(self) -> None:
        self.over.set()


def take(message: int) -> None:
    pass


def few() -> Iterator[int]:
    yield from range(3)


def narrow(message: str) -> None:
    pass
"""
ROBOT = """
version: 1
bridges: {{python: {{}}}}
functions:
  count:
    components:
      - {{name: counter, bridge: python, output: {{endpoint: ["parts:Numbers"]}}}}
{}
"""


def offered(folder: Path, offers: str) -> tuple[int, str]:
    (folder / "parts.py").write_text(PARTS)
    (folder / "robot.yaml").write_text(ROBOT.format(offers))
    words = ["offer", "--once", "--json", "-f", str(folder / "robot.yaml")]
    done = CliRunner().invoke(main, words)
    return done.exit_code, done.stdout or done.output


def test_what_is_offered_is_reported_with_its_state(tmp_path: Path) -> None:
    code, output = offered(
        tmp_path, "offer: {python: {count: {output: {endpoint: ['parts:take']}}}}"
    )
    status = json.loads(output)
    assert (code, status["name"], status["state"]) == (0, "python:count", "open")


def test_what_cannot_be_offered_is_a_failure_with_its_cause(tmp_path: Path) -> None:
    code, output = offered(
        tmp_path, "offer: {python: {count: {output: {endpoint: ['parts:narrow']}}}}"
    )
    status = json.loads(output)
    assert (code, status["state"]) == (4, "failed")
    assert "does not fit ['parts:narrow']" in status["cause"]


def test_it_ends_when_all_that_is_offered_has_finished(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    offers = "offer: {python: {count: {output: {endpoint: ['parts:take']}}}}"
    text = ROBOT.format(offers).replace("Numbers", "few")
    (tmp_path / "robot.yaml").write_text(text)
    done = CliRunner().invoke(main, ["offer", "-f", str(tmp_path / "robot.yaml")])
    assert done.exit_code == 0, done.output
    assert "python:count" in done.output


def test_a_file_without_offers_is_no_use(tmp_path: Path) -> None:
    code, output = offered(tmp_path, "")
    assert code == 3
    assert "has no `offer:`" in output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_what_fails_is_printed_once_on_a_terminal_and_ending_it_is_no_failure(
    tmp_path: Path, number: signal.Signals
) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    offers = (
        "offer: {python: {count: {output: {endpoint: ['parts:take']}},"
        " text: {output: {endpoint: ['parts:narrow']}}}}\n"
    )
    other = (
        "  text: {components: [{name: few, bridge: python, output: {endpoint: ['parts:few']}}]}\n"
    )
    (tmp_path / "robot.yaml").write_text(ROBOT.format(other + offers))
    seen = on_a_terminal(["offer"], tmp_path, interrupt_at="python:text ", number=number, width=200)
    assert seen.code == 0, seen.text
    assert "interrupted" not in seen.text
    assert "python:count" in seen.text
    assert seen.text.count("python:text failed") == 1, seen.text


@pytest.mark.parametrize("number", [errno.EPIPE, errno.ENOSPC])
def test_it_ends_where_nothing_more_can_be_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    offers = "offer: {python: {count: {output: {endpoint: ['parts:take']}}}}"
    (tmp_path / "robot.yaml").write_text(ROBOT.format(offers))
    printed: list[object] = []

    def echo(text: object) -> None:
        printed.append(text)
        if len(printed) > 1:
            raise OSError(number, os.strerror(number))

    def listen(robot: RobotManager, listener: Callable[[StatusEvent], None]) -> None:
        listener(StatusEvent(1, 0.0, "offer python:count", "failed", "its consumer has died"))

    monkeypatch.setattr(_run, "echo", echo)
    monkeypatch.setattr(RobotManager, "listen", listen)
    words = ["offer", "-f", str(tmp_path / "robot.yaml")]
    done = Background(lambda: CliRunner().invoke(main, words)).result()
    assert (done.exit_code, len(printed)) == (6, 2), done.output
