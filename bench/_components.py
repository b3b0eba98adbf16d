"""Components that benches run in hosts and behind servers.

Those of the soak keep a journal and do harm to themselves when a file asks for it. A journal has
one octet for each message, so that no death of the process can falsify it. Harms: `slow` and
`refuse` last as long as their file is there, `hang` is taken by the first that sees it.
"""

from __future__ import annotations

import ctypes
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypedDict

from uoarm.local import Octets

_PAUSE_SECONDS = 0.02
_EACH = 10


class Packet(TypedDict):
    """What round trips carry."""

    data: Octets


class Text(TypedDict):
    """What is said."""

    text: str


class Pair(TypedDict):
    """What is added."""

    a: float
    b: float


class Sum(TypedDict):
    """What it makes."""

    value: float


class Command(TypedDict):
    """How fast a base drives."""

    speed: float


class Numbers(TypedDict):
    """Many of them."""

    data: list[float]


def echo(message: Packet) -> Packet:
    """Give back what came."""
    return message


def text(message: Text) -> Text:
    """Give back what was said."""
    return message


def slowly() -> Iterator[int]:
    """Emit a number every millisecond."""
    number = 0
    while True:
        yield number
        number += 1
        time.sleep(0.001)


def hang(value: int) -> int:
    """Sleep without letting go of the interpreter lock."""
    ctypes.PyDLL(None).sleep(value)
    return value


def add(pair: Pair) -> Sum:
    """Add two numbers."""
    return {"value": pair["a"] + pair["b"]}


def anything(message: Any) -> Sum:
    """Take a value of any structure."""
    del message
    return {"value": 1}


def sleep(pair: Pair) -> Sum:
    """Never answer."""
    threading.Event().wait()
    return {"value": pair["a"]}


def hold(numbers: Numbers) -> Numbers:
    """Never give back what came."""
    threading.Event().wait()
    return numbers


def drive(command: Command) -> None:
    """Take a command, or the message that stops."""


def _folder() -> Path:
    return Path(os.environ["UOARM_SOAK"])


def _journal(name: str) -> int:
    path = _folder() / f"{name}-{os.getpid()}.journal"
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)


def numbers() -> Iterator[int]:
    """Emit some hundred numbers a second, until there are enough."""
    begun, undelivered = _journal("begun"), _journal("undelivered")
    number = 0
    while not (_folder() / "enough").exists():
        for _ in range(_EACH):
            os.write(begun, b"x")  # before, as it may wait long in the sending
            try:
                yield number
            except GeneratorExit:  # it came when its consumer had ended
                os.write(undelivered, b"x")
                raise
            number += 1
        time.sleep(_PAUSE_SECONDS)
    time.sleep(3600)


class finder:  # noqa: N801 - a function to the robot
    """Give back what came, unless a file says otherwise."""

    def __init__(self) -> None:
        self._refused = _journal("refused")

    def __call__(self, value: int) -> int:
        """Give back what came.

        Raises:
            ValueError: the file `refuse` is there.
        """
        if (_folder() / "slow").exists():
            time.sleep(_PAUSE_SECONDS)
        if (_folder() / "refuse").exists():
            os.write(self._refused, b"x")
            raise ValueError(f"{value} is not wanted")
        try:
            (_folder() / "hang").unlink()
        except FileNotFoundError:
            return value
        ctypes.PyDLL(None).sleep(3600)  # keeps the interpreter lock
        return value
