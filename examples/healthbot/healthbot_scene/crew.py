"""Starts the parts, waits until each is ready, notices deaths, and ends them all."""

from __future__ import annotations

import os
import signal
import string
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType

from attrs import frozen
from typing_extensions import Self

__all__ = [
    "Crew",
    "Part",
    "PartError",
    "Running",
    "end_in_silence",
    "environment_of",
    "fill_in_robot",
    "host_of",
    "print_running",
    "watch",
]

_LOOK_SECONDS = 0.1
_STOP_SECONDS = 8.0
_LAST_LINES = 5


@frozen
class Part:
    """One process of the scene.

    Attributes:
        name: for people and for the name of its log.
        what: what it stands for, in a few words.
        framework: whose program it is.
        command: the program, by its path, and its arguments.
        ready: whether it is ready, given its log.
        seconds: within which it must be.
        vital: whether the scene ends with it; the robot goes on without the others.
    """

    name: str
    what: str
    framework: str
    command: tuple[str, ...]
    ready: Callable[[Path], bool]
    seconds: float = 60.0
    vital: bool = False


def end_in_silence(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Report what ends a program as Python does, as its `sys.excepthook`, but Ctrl-C."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)


class PartError(Exception):
    """A part did not become ready; the text has its last words."""


@frozen(eq=False)
class Running:
    """A part that was started."""

    part: Part
    process: subprocess.Popen[bytes]
    log: Path

    def last_words(self) -> str:
        """Return the end of its log."""
        lines = self.log.read_text(errors="replace").strip().splitlines()
        return "\n".join(lines[-_LAST_LINES:])


class Crew:
    """The running parts; a context manager that ends them in reverse order.

    Args:
        run: the working directory of every part, and where logs are.
        environment: of every part.
    """

    def __init__(self, run: Path, environment: Mapping[str, str]) -> None:
        self._run = run
        self._environment = dict(environment)
        self._running: dict[str, Running] = {}

    def __getitem__(self, name: str) -> Running:
        return self._running[name]

    def start(self, part: Part) -> Running:
        """Start a part, or start it again, and return once it is ready.

        The part ends with the thread that calls this, at the latest.

        Raises:
            PartError: it ended, or is not ready in time.
        """
        running = self._launch(part)
        self._wait(running)
        return running

    def start_all(self, parts: Sequence[Part], report: Callable[[Running], None]) -> None:
        """Start the first part, and once it is ready the others side by side.

        Args:
            parts: the others may need the first, the naming service.
            report: called with each part once it is ready.

        Raises:
            PartError: one did not become ready.
        """
        first, *others = parts
        report(self.start(first))
        for running in [self._launch(part) for part in others]:
            self._wait(running)
            report(running)

    def _launch(self, part: Part) -> Running:
        log = self._run / f"{part.name}.log"
        with_us = ("setpriv", "--pdeathsig", "KILL")  # the kernel ends it with this thread
        with log.open("wb") as out:
            process = subprocess.Popen(
                (*with_us, *part.command),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                cwd=self._run,
                env=self._environment,
                start_new_session=True,
            )
        running = self._running[part.name] = Running(part, process, log)
        return running

    def _wait(self, running: Running) -> None:
        part = running.part
        deadline = time.monotonic() + part.seconds
        while not part.ready(running.log):
            code = running.process.poll()
            if code is not None:
                raise PartError(f"{part.name} ended with {code}:\n{running.last_words()}")
            if time.monotonic() > deadline:
                text = f"{part.name} is not ready after {part.seconds:g} s"
                raise PartError(f"{text}:\n{running.last_words()}")
            time.sleep(_LOOK_SECONDS)

    def dead(self) -> list[Running]:
        """Return the parts that have ended by themselves since the last look, and forget them."""
        ended = [
            running for running in self._running.values() if running.process.poll() is not None
        ]
        for running in ended:
            del self._running[running.part.name]
        return ended

    def kill(self, name: str) -> None:
        """End a part as a crash would: at once, without a farewell."""
        running = self._running.pop(name)
        running.process.kill()
        running.process.wait()

    def close(self) -> None:
        """End what still runs, politely first."""
        for running in reversed(list(self._running.values())):
            running.process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + _STOP_SECONDS
        for running in reversed(list(self._running.values())):
            try:
                running.process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                running.process.kill()
                running.process.wait()
        self._running.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def print_running(running: Running) -> None:
    """Print what runs, and as which process."""
    part = running.part
    where = f"{part.name:<11} {part.framework:<14} pid {running.process.pid:<8}"
    print(where, part.what, flush=True)


def watch(crew: Crew, seconds: float | None = None) -> int:
    """Print which parts die; return 1 once a vital one has, 0 when the time is over.

    Args:
        crew: that runs.
        seconds: None: without a limit.
    """
    until = time.monotonic() + seconds if seconds else float("inf")
    while time.monotonic() < until:
        for running in crew.dead():
            part = running.part
            code = running.process.returncode
            print(f"{part.name} ended with {code}: {running.last_words()}", flush=True)
            if part.vital:
                return 1
        time.sleep(_LOOK_SECONDS)
    return 0


def host_of(robot: int, library: str) -> int:
    """Return the process of `uoarm serve` in which a bridge with this library runs.

    Raises:
        LookupError: there is none.
    """
    children = Path(f"/proc/{robot}/task").glob("*/children")
    for pid in {int(word) for child in children for word in child.read_text().split()}:
        if library in Path(f"/proc/{pid}/maps").read_text():
            return pid
    raise LookupError(f"no process of the robot has loaded {library}")


def environment_of(run: Path, domain: int, paths: Sequence[Path], profiles: Path) -> dict[str, str]:
    """Return the environment variables of every part of a scene: loopback only, its own domain.

    Args:
        run: folder of the run.
        domain: of ROS 2.
        paths: where its modules are.
        profiles: of Fast DDS.
    """
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "PYTHONUNBUFFERED": "1",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(domain),
        "ROS_LOG_DIR": str(run / "ros"),
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles),
    }


def fill_in_robot(template: Path, words: Mapping[str, object], run: Path) -> Path:
    """Fill a robot file in, whose names stand behind dollar signs, and leave it with the run."""
    file = run / "robot.yaml"
    file.write_text(string.Template(template.read_text()).substitute(words))
    return file
