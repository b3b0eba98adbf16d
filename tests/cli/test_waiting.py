"""Who waits at a terminal for bridges gets a notice."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from uoarm import RobotManager
from uoarm.cli import _output, main
from uoarm.errors import UsageError
from uoarm.testing import patience

ROBOT = "version: 1\nbridges: {}\nfunctions: {}\n"


@contextmanager
def a_screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], bytes]]:
    """Standard error is a terminal; yields what returns the text that comes there."""
    ours, theirs = os.openpty()
    monkeypatch.setattr(_output, "_SILENT_SECONDS", 0.0)

    def read() -> bytes:
        assert select.select([ours], [], [], patience())[0], "nothing came"
        return os.read(ours, 4096)

    try:
        with os.fdopen(theirs, "w") as terminal:
            monkeypatch.setattr(sys, "stderr", terminal)
            yield read
            monkeypatch.undo()
    finally:
        os.close(ours)


def test_waiting_at_a_terminal_says_for_what_and_how_long(monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        a_screen(monkeypatch) as screen,
        _output.saying_what_is_waited_for("bridges to start", 7.0),
    ):
        assert screen() == b"waiting for bridges to start, at most 7 s\r\n"


@pytest.mark.parametrize("command", ["request", "resolve"])
def test_commands_that_open_or_resolve_say_it(
    command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    texts: list[bytes] = []
    with a_screen(monkeypatch) as screen:

        def read(*_: object, **__: object) -> None:
            texts.append(screen())
            raise UsageError("it is enough")

        monkeypatch.setattr(RobotManager, command, read)
        with suppress(SystemExit):
            main.main([command, str(tmp_path / "robot.yaml"), "f"])
    assert [text.startswith(b"waiting for ") for text in texts] == [True]
