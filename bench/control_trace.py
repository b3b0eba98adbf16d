"""How far a request, a message and a death go: calls, modules, changes of folder, threads."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from types import FrameType

from bench.tables import print_table
from bench.takeover import chain

CONTROL = "uoarm._control"
OWN = ("uoarm.", "uoarm_")
_QUIET_SECONDS = 0.5


class Trace:
    """Counts the calls of this package's functions, in threads that began after it was made.

    What the bridges in memory and the tests' helpers do is not counted.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._recording = False
        self._calls: list[tuple[int, str]] = []
        self._last = 0.0
        threading.setprofile(self._profile)
        sys.setprofile(self._profile)

    def run(self, action: Callable[[], object]) -> tuple[int, int, int, int]:
        """Return calls, modules, changes of folder and threads of an action.

        What other threads do for it belongs to it, until nothing has happened for half a second. A
        change of folder is one call inside the control plane that follows a call in another of its
        folders in the same thread, or is its thread's first.
        """
        with self._lock:
            self._calls.clear()
        self._last, self._recording = time.monotonic(), True
        action()
        while time.monotonic() - self._last < _QUIET_SECONDS:
            time.sleep(_QUIET_SECONDS / 10)
        self._recording = False
        calls = list(self._calls)
        last: dict[int, str] = {}
        changes = 0
        for thread, module in calls:
            folder = module.rpartition(".")[0]
            if module.startswith(CONTROL):
                changes += last.get(thread) != folder
                last[thread] = folder
        threads = {thread for thread, _ in calls}
        return len(calls), len({module for _, module in calls}), changes, len(threads)

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
    with chain() as (robot, one, best, _):
        robot.request("name").kill()
        time.sleep(_QUIET_SECONDS)
        rows = [("request of three steps, warm", *trace.run(lambda: robot.request("name")))]
        (connection,) = robot.connections()
        best.emit(1)  # which starts the queues' workers
        connection.get(10)
        rows.append(("message over two edges, to the inbox", *trace.run(lambda: best.emit(2))))

        def die() -> None:
            one.die("best")
            while not connection.gaps:
                time.sleep(0.001)

        rows.append(("death of the source, to the next one", *trace.run(die)))
    trace.close()
    columns = ("way", "calls", "modules", "changes of folder in control", "threads")
    print_table("Ways through the manager", columns, [tuple(map(str, row)) for row in rows])


if __name__ == "__main__":
    main()
