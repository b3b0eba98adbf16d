"""The pulse of a host: asked twice a second, so that one that hangs is noticed.

A token of the link drops when the process dies, but stays while the process hangs and holds the
interpreter lock; only an answer shows that it lives.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from uoarm._host import _keys
from uoarm._host._link import Link
from uoarm.errors import UoarmError

__all__ = ["Pulse"]

_EACH_SECONDS = 0.5
_BEAT_SECONDS = 0.5
_DOUBT = 1 / 3


class Pulse:
    """Asks a host whether it lives, in a thread, until it is stopped or the host is given up.

    Args:
        name: of the bridge, for the thread.
        link: to the host.
        silence: seconds without an answer after which it is given up.
        heard: told what an answer holds.
        doubted: told True when a third of the silence has passed, False when it is over.
        given_up: told for how many seconds there was no answer; the last call.
    """

    def __init__(
        self,
        name: str,
        link: Link,
        *,
        silence: float,
        heard: Callable[[Any], None],
        doubted: Callable[[bool], None],
        given_up: Callable[[float], None],
    ) -> None:
        self._link = link
        self._silence = silence
        self._heard = heard
        self._doubted = doubted
        self._given_up = given_up
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"uoarm-pulse-{name}", daemon=True)

    def start(self) -> None:
        """Begin to ask."""
        self._thread.start()

    def stop(self) -> None:
        """Ask no more, from any thread; a question under way ends within half a second."""
        self._stopped.set()

    def join(self, timeout: float) -> None:
        """Wait for the thread to end, unless this is it."""
        if self._thread is not threading.current_thread() and self._thread.ident is not None:
            self._thread.join(timeout)

    def _run(self) -> None:
        last = time.monotonic()
        missed = 0
        in_doubt = False
        while not self._stopped.wait(_EACH_SECONDS):
            try:
                self._heard(self._link.ask(_keys.PING, None, timeout=_BEAT_SECONDS))
                last, missed = time.monotonic(), 0
            except UoarmError:
                missed += 1
            # The clock alone would give up a host whenever this process has been stopped.
            silent = min(time.monotonic() - last, missed * (_EACH_SECONDS + _BEAT_SECONDS))
            if self._stopped.is_set():
                return
            if in_doubt != (silent > self._silence * _DOUBT):
                in_doubt = not in_doubt
                self._doubted(in_doubt)
            if silent > self._silence:
                self._given_up(silent)
                return
