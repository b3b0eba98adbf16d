"""Components for the conformance suite that are driven through files, since they are hosted."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TypedDict


class Value(TypedDict):
    value: int


def until_killed(killed: str) -> Iterator[Value]:
    deadline = time.monotonic() + 600.0
    pause = threading.Event()
    while time.monotonic() < deadline:
        if Path(killed).exists():
            raise RuntimeError("the component was killed")
        pause.wait(0.005)
    yield {"value": 0}


def silent(message: Value) -> Value:
    threading.Event().wait()
    return message
