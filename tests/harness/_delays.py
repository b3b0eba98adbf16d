"""Threads that begin late and go on late, as on a machine that has no time for them.

With UOARM_TEST_DELAYS=<number> every thread of the tests' own process begins up to 50 ms late, and
one of four waits for a condition, an event or a queue goes on up to 20 ms after what it waited for:
orders that a busy machine shows once in thousands of runs come in each. One of forty delays is
twenty times as long, which outlasts a round trip to a server. The number chooses them.
"""

from __future__ import annotations

import os
import queue
import random
import sys
import threading
import time
from typing import Any

DELAYS = "UOARM_TEST_DELAYS"
_BEGIN_SECONDS = 0.05
_WAKE_SECONDS = 0.02
_SHARE = 0.25
_LONG_SHARE = 0.025
_LONG = 20


def begin() -> None:
    """Delay threads from now on, if the environment says so."""
    seed = os.environ.get(DELAYS)
    if not seed:
        return
    chance = random.Random(seed)
    run, wait = threading.Thread.run, threading.Condition.wait

    def delay(seconds: float) -> None:
        factor = _LONG if chance.random() < _LONG_SHARE else 1
        time.sleep(chance.random() * seconds * factor)

    def wake() -> None:
        if chance.random() < _SHARE:
            delay(_WAKE_SECONDS)

    def run_late(thread: threading.Thread) -> None:
        delay(_BEGIN_SECONDS)
        run(thread)

    def wait_late(condition: threading.Condition, timeout: float | None = None) -> bool:
        is_met = wait(condition, timeout)
        wake()
        return is_met

    class LateQueue(queue.SimpleQueue):  # type: ignore[type-arg]  # of anything
        def get(self, block: bool = True, timeout: float | None = None) -> Any:
            item = super().get(block, timeout)
            wake()
            return item

    threading.Thread.run = run_late  # type: ignore[method-assign, assignment]
    threading.Condition.wait = wait_late  # type: ignore[method-assign, assignment]
    for module in list(sys.modules.values()):  # the plugin of pytest has imported some already
        if vars(module).get("SimpleQueue") is LateQueue.__base__:
            module.SimpleQueue = LateQueue  # type: ignore[attr-defined]
