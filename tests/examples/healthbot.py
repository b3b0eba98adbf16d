"""The HealthBot scene as a user starts it: one command, in a process of its own."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from uoarm.testing import patience, wait

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "healthbot"
NODE = ("node", "--experimental-websocket", "--no-warnings")


class Scene:
    """A running scene.

    Attributes:
        run: its folder.
        output: what it printed until everything was ready.
        pids: of its parts, by name.
    """

    def __init__(self, run: Path) -> None:
        self.run = run
        self._output = run / "scene.out"
        run.mkdir(exist_ok=True)
        command = [sys.executable, str(EXAMPLE / "scene.py"), "--free-ports", "--run", str(run)]
        with self._output.open("wb") as out:
            self._process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
        try:
            wait(self._ready)
        except AssertionError as error:
            self.close()
            raise AssertionError(f"the scene did not start:\n{self.output}") from error

    def _ready(self) -> bool:
        return "Everything is ready" in self.output or self._process.poll() is not None

    @property
    def output(self) -> str:
        return self._output.read_text()

    @property
    def pids(self) -> Mapping[str, int]:
        return {
            name: int(pid)
            for name, pid in re.findall(r"^(\S+) .* pid (\d+)", self.output, re.MULTILINE)
        }

    @property
    def robot(self) -> str:
        return str(re.findall(r"uoarm serve at (\S+)", self.output)[0])

    @property
    def page(self) -> str:
        return str(re.findall(r"browser application at (\S+)", self.output)[0])

    def interrupt(self) -> int:
        """Press Ctrl-C; returns the exit code."""
        self._process.send_signal(signal.SIGINT)
        return self._process.wait(patience())

    def close(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def terminal_visit(robot: str) -> subprocess.Popen[str]:
    """Start the terminal application."""
    command = [*NODE, str(EXAMPLE / "terminal" / "main.mjs"), robot]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8"
    )
