"""Another state of the code in turns with this one, and processes beside this one."""

from __future__ import annotations

import argparse
import gc
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from attrs import frozen

ROOT = Path(__file__).parents[1]
_LIMIT_SECONDS = 1800.0
_END_SECONDS = 20.0


def parser(text: str | None, rounds: int = 1) -> argparse.ArgumentParser:
    """Return a parser that knows `--before` and `--rounds`."""
    made = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("--before", type=Path, metavar="FOLDER", help="a checkout of another state")
    made.add_argument("--rounds", type=int, default=rounds)
    return made


def states(given: argparse.Namespace) -> dict[str, Path]:
    """Return the checkouts that are measured, by name."""
    return {"now": ROOT, **({"before": given.before.resolve()} if given.before else {})}


def environment(checkout: Path, *folders: Path, **variables: str) -> dict[str, str]:
    """Return the environment of a process with a checkout's uoarm, and modules of folders."""
    path = os.pathsep.join(map(str, (checkout / "src", *folders)))
    return {**os.environ, "PYTHONPATH": path, **variables}


def measured_apart(checkout: Path, name: str, *arguments: object) -> Any:
    """Return what `measure` of a bench prints as JSON, with the uoarm of a checkout.

    It runs in a process of its own; the bench is of this checkout.
    """
    done = subprocess.run(
        [sys.executable, "-c", f"from bench.{name} import measure; measure(*{arguments!r})"],
        env=environment(checkout, ROOT),
        stdout=subprocess.PIPE,
        check=True,
        timeout=_LIMIT_SECONDS,
    )
    return json.loads(done.stdout)


def load() -> str:
    """Return what else the machine does."""
    return f"load {os.getloadavg()[0]:.1f}"


class Collections:
    """The nanoseconds that the garbage collector has taken, in whichever thread."""

    def __init__(self, clock: Callable[[], int] = time.perf_counter_ns) -> None:
        self.spent = 0
        self._clock = clock
        self._begun = 0
        gc.callbacks.append(self._note)

    def _note(self, phase: str, _: dict[str, int]) -> None:
        now = self._clock()
        if phase == "start":
            self._begun = now
        else:
            self.spent += now - self._begun


@frozen
class Child:
    """A program beside this one."""

    process: subprocess.Popen[str]

    def said(self, pattern: str = r"(.*)") -> str:
        """Return what it says next of a pattern; on standard error, where that is a pipe.

        Raises:
            RuntimeError: it has ended.
        """
        stream = self.process.stderr or self.process.stdout
        assert stream is not None
        for line in stream:
            if found := re.search(pattern, line):
                return found[1]
        raise RuntimeError(f"{self.process.args!r} does not say {pattern!r}")


def module(name: str, *words: str) -> tuple[str, ...]:
    """Return the command of a Python module."""
    return (sys.executable, "-u", "-m", name, *words)


@contextmanager
def running(
    words: Sequence[str], end: signal.Signals | None = None, **more: Any
) -> Iterator[Child]:
    """Run a program until it is no longer needed: then its input ends, or it gets a signal."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, **more}
    with subprocess.Popen(words, **pipes) as process:
        try:
            yield Child(process)
        finally:
            if end is not None:
                process.send_signal(end)
            try:
                process.communicate(timeout=_END_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()


def wait_for_port(port: int) -> None:
    """Return once a program listens on a port of this machine.

    Raises:
        RuntimeError: none does for a long time.
    """
    until = time.monotonic() + _END_SECONDS
    while time.monotonic() < until:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        time.sleep(0.05)
    raise RuntimeError(f"nothing listens on port {port}")


@contextmanager
def serving(
    checkout: Path, text: str, *options: str, **more: Any
) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run `uoarm serve` of a checkout with a configuration; gives its address and process."""
    plugins = (plugin / "src" for plugin in (checkout / "plugins").iterdir())
    variables = environment(checkout, *plugins, ROOT)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        file.write_text(text, encoding="utf-8")
        words = module("uoarm", "serve", str(file), "--port", "0", *options)
        with running(words, signal.SIGTERM, env=variables, **more) as server:
            yield server.said(r"(ws://[^ ]+/)"), server.process


def resident_megabytes(process: int | str = "self") -> float:
    """Return the memory that a process has now."""
    pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
