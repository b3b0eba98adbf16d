"""How far a request, a message and a death go: calls, modules, changes of module, threads."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

import uoarm
from bench.tables import print_table
from uoarm.config import loads
from uoarm.testing import MemoryBridge

NUMBER: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components:
      - {name: best, bridge: one, priority: 2, output: {endpoint: [best]}}
      - {name: spare, bridge: two, priority: 1, output: {endpoint: [spare]}}
  finder:
    components:
      - {name: finder, bridge: two, input: {from: camera, endpoint: [finder]},
         output: {endpoint: [finder]}}
  name:
    components:
      - {name: namer, bridge: two, input: {from: finder, endpoint: [namer]},
         output: {endpoint: [namer]}}
"""
CONTROL = "uoarm._control"
OWN = ("uoarm.", "uoarm_")
_QUIET_SECONDS = 0.5


class Trace:
    """Counts the calls of this package's functions, in threads that began after it was made.

    A change of module is one call inside the control plane that follows a call of another of its
    modules in the same thread, or is its thread's first. What the bridges in memory and
    the tests' helpers do is not counted.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._recording = False
        self._calls: list[tuple[int, str]] = []
        self._last = 0.0
        threading.setprofile(self._profile)
        sys.setprofile(self._profile)

    def run(
        self, action: Callable[[], object], quiet: float = _QUIET_SECONDS
    ) -> tuple[int, int, int, int]:
        """Return calls, modules, changes of module and threads of an action.

        What other threads do for it belongs to it, until nothing has happened for half a second,
        or as long as is said: with 0, until it has returned.
        """
        with self._lock:
            self._calls.clear()
        self._last, self._recording = time.monotonic(), True
        action()
        while time.monotonic() - self._last < quiet:
            time.sleep(quiet / 10)
        self._recording = False
        calls = list(self._calls)
        modules = {module for _, module in calls}
        threads = {thread for thread, _ in calls}
        return len(calls), len(modules), self.changes(CONTROL), len(threads)

    def changes(self, below: str) -> int:
        """Return the changes of module of the last action, of those below a package."""
        return len(self.path(below))

    def folder_changes(self, below: str) -> int:
        """Return the changes of folder of the last action, below a package and beside it not."""
        last: dict[int, str] = {}
        changes = 0
        for thread, module in list(self._calls):
            folder = module.rpartition(".")[0]
            if module.startswith(below):
                changes += last.get(thread) != folder
                last[thread] = folder
        return changes

    def path(self, below: str) -> list[str]:
        """Return the modules below a package that the last action entered, each time it did."""
        last: dict[int, str] = {}
        entered = []
        for thread, module in list(self._calls):
            if module.startswith(below):
                if last.get(thread) != module:
                    entered.append(module)
                last[thread] = module
        return entered

    def close(self) -> None:
        """Count nothing more."""
        threading.setprofile(None)
        sys.setprofile(None)

    def _profile(self, frame: FrameType, event: str, _: object) -> None:
        if not self._recording or event != "call":
            return
        module = frame.f_globals.get("__name__", "")
        if module.startswith(OWN) and not module.startswith("uoarm.testing"):
            with self._lock:
                self._calls.append((threading.get_ident(), module))
                self._last = time.monotonic()


def main() -> None:
    """Print the table of ways."""
    trace = Trace()
    one, two = MemoryBridge("one"), MemoryBridge("two")
    best, _ = one.emitter("best", NUMBER), two.emitter("spare", NUMBER)
    two.loop("finder", NUMBER)
    two.loop("namer", NUMBER)
    with uoarm.RobotManager(loads(ROBOT), bridges={"one": one, "two": two}) as robot:
        robot.request("name").kill()
        time.sleep(_QUIET_SECONDS)
        requested = trace.run(lambda: robot.request("name")), trace.folder_changes(CONTROL)
        (connection,) = robot.connections()
        best.emit(1)  # which starts the queues' workers
        connection.get(10)
        message = trace.run(lambda: best.emit(2)), trace.folder_changes(CONTROL)

        def die() -> None:
            one.die("best")
            while not connection.gaps:
                time.sleep(0.001)

        died = trace.run(die), trace.folder_changes(CONTROL)
    trace.close()
    rows = [
        (what, *map(str, (*counts, folders)))
        for what, (counts, folders) in (
            ("request of three steps, warm", requested),
            ("one message over two edges, to the inbox", message),
            ("death of the source, to the next one", died),
        )
    ]
    columns = ("way", "calls", "modules", "changes of module in control", "threads", "of folder")
    print_table("Ways through the manager", columns, rows)
    print(f"load {os.getloadavg()[0]:.1f}, which changes times and not these counts")


if __name__ == "__main__":
    main()
