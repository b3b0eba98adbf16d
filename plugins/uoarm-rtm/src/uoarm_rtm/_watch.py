"""What the bridge checks again and again: channels first, then which components there are."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health
from uoarm_rtm._directory import Directory

__all__ = ["DirectoryMonitor", "Ticker"]

_AGAIN_SECONDS = 0.02

_log = logging.getLogger("uoarm.rtm")

Tick = Callable[[], None]


class DirectoryMonitor:
    """Which components are there, compared with the last check.

    Args:
        directory: names and what stands behind them.
        report: that of the bridge.
        own: path to leave out: the bridge's own component.
    """

    def __init__(self, directory: Directory, report: Callable[..., None], own: str) -> None:
        self._directory = directory
        self._report = report
        self._own = own
        self._conditions: dict[str, str] | None = None
        self._is_unreachable = False

    def tick(self) -> None:
        """Report what came, left, died, hung or woke up; the first check reports nothing."""
        try:
            entries = self._directory.entries()
        except BridgeError as error:
            if error.reason is FailureReason.CLOSED:
                return
            # A naming service that is gone says nothing of the components.
            if not self._is_unreachable:
                self._is_unreachable = True
                self._report(Health.DEGRADED, str(error))
            return
        if self._is_unreachable:
            self._is_unreachable = False
            self._report(Health.OK, "a naming service answers again")
        now = {entry.path: entry.condition for entry in entries if entry.path != self._own}
        before, self._conditions = self._conditions, now
        if before is None:
            return
        for path in sorted(before.keys() | now.keys()):
            was, is_now = before.get(path), now.get(path)
            if was != is_now:
                self._report_change(path, was, is_now)

    def _report_change(self, path: str, was: str | None, is_now: str | None) -> None:
        if is_now == "alive":
            word = "answers again" if was == "hung" else "appeared"
            self._report(Health.OK, f"component {path} {word}", component=path)
        elif is_now == "hung":
            text = f"component {path} does not answer: it hangs"
            self._report(Health.LOST, text, component=path)
        elif was in {"alive", "hung"}:
            end = "left" if is_now is None else "died: only its name is left"
            self._report(Health.LOST, f"component {path} {end}", component=path)


class Ticker:
    """A thread that calls some ticks again and again, each on its own, and others on request.

    Args:
        ticks: returns what to call now.
        seconds: pause between rounds; 0 for no thread at all.
    """

    def __init__(self, ticks: Callable[[], list[Tick]], seconds: float) -> None:
        self._ticks = ticks
        self._seconds = seconds
        self._changed = threading.Condition(threading.Lock())
        self._ended = False
        self._urgent: dict[Tick, None] = {}
        self._thread = threading.Thread(target=self._run, name="uoarm-rtm-watch", daemon=True)

    def start(self) -> None:
        """Begin, where there are rounds at all."""
        if self._seconds:
            self._thread.start()

    def soon(self, tick: Tick) -> None:
        """Have a tick called next, after the one under way, and once more 20 ms later.

        A component reports a state before it is in it (observed). Several that wait are one.
        """
        with self._changed:
            self._urgent[tick] = None
            self._changed.notify_all()

    def close(self, seconds: float) -> None:
        """End the thread after the tick under way, and wait for that up to `seconds`.

        A thread that lets go of references while the interpreter ends aborts the process.
        """
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(seconds)

    def _run(self) -> None:
        while True:
            for tick in self._ticks():
                if not self._rest(0):
                    return
                _call(tick)
            if not self._rest(self._seconds):
                return

    def _rest(self, seconds: float) -> bool:
        """Let time pass, and call what is urgent meanwhile; returns whether to go on.

        What comes faster than it is called does not keep the others from their turn.
        """
        until = time.monotonic() + seconds
        while True:
            with self._changed:
                left = until - time.monotonic()
                self._changed.wait_for(lambda: self._ended or self._urgent, left)
                if self._ended:
                    return False
                urgent, self._urgent = self._urgent, {}
            if not urgent:
                return True
            for _ in range(2):
                for tick in urgent:
                    _call(tick)
                with self._changed:  # also because a component may report without end
                    if self._changed.wait_for(lambda: self._ended, _AGAIN_SECONDS):
                        return False
            if time.monotonic() >= until:
                return True


def _call(tick: Tick) -> None:
    try:
        tick()
    except Exception:  # noqa: BLE001 - one that fails hurts no other
        _log.exception("a check of OpenRTM failed")
