"""When checks are made: in rounds, or at once on request, and beside any that takes long.

`CheckQueue` decides which check is next, without threads or a clock; `Ticker` makes them in threads
of a bridge. A check asks one component, which may hang for the limit of a call: nothing that is
healthy waits for that. On the other hand checks are made one after the other as long as all answer,
since a thread for each of hundreds of components would only have them wait for each other.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress

from attrs import define

from uoarm.bridge import LimitedLog

Check = Callable[[], None]
"""Asks what may hang. A bound method of one object is one check."""

_SLOW_SECONDS = 0.02
_SUSPECT_SECONDS = 0.25
_AGAIN_SECONDS = 0.02
_MOST_THREADS = 32
_MOST_RESTING = 2

_log = logging.getLogger("uoarm.rtm")


@define
class _Request:
    """A check that is to be made soon.

    Attributes:
        due: when; None while it is being made.
        turns: how often it is still made.
    """

    due: float | None
    turns: int = 2


class CheckQueue:
    """Which check is to be made now. Times are in seconds of one clock of the caller.

    One check is made after the other, but one that takes longer than 20 ms holds up no other: the
    next begins beside it. One that took a quarter of a second the last time is a suspect: it waits
    until the others of its round have begun, and suspects have half of the places at most. So what
    is known to hang takes no place from what is not.

    No check is made twice at the same time. A round that finds one still under way leaves it out.

    Args:
        collect: makes a round due: it leads to `begin_round`, and is a check itself.
        pause: seconds between the end of a round and the next; what takes long is not waited for.
        most: that may be under way at once.
    """

    def __init__(self, collect: Check, pause: float, most: int = _MOST_THREADS) -> None:
        self._collect, self._pause, self._most = collect, pause, most
        self._round_at: float | None = 0.0  # None: the last one is not over
        self._followers: dict[Check, None] = {}
        self._requests: dict[Check, _Request] = {}
        self._waiting: dict[Check, None] = {}
        self._suspects: dict[Check, None] = {}
        # When each began, and from when on it counts as slow.
        self._running: dict[Check, tuple[float, float]] = {}
        self._hung: set[Check] = set()
        self._was_requested = False

    def begin_round(self, checks: Collection[Check]) -> None:
        """Have each of these made once, unless it is being made, or waits to be."""
        self._hung &= {*checks, *self._running}
        for check in checks:
            if check not in self._running:
                line = self._suspects if check in self._hung else self._waiting
                line[check] = None

    def follow(self, check: Check) -> None:
        """Have a check made before all others, unless it is being made: it goes on with one."""
        if check not in self._running:
            self._followers[check] = None

    def request(self, check: Check, now: float) -> None:
        """Have a check made before its turn, and once more 20 ms later.

        A component reports a state before it is in it (observed). Several requests are one.
        """
        known = self._requests.get(check)
        if known is not None:
            known.turns = 2
        else:
            self._requests[check] = _Request(None if check in self._running else now)

    def take(self, now: float) -> Check | None:
        """Return the check to make now, which is under way from then on; None for none.

        What comes faster than it is checked does not keep the others from their turn.
        """
        if len(self._running) >= self._most or self._quick(now):
            return None
        check, slow = next(iter(self._followers), None), _SLOW_SECONDS
        if check is None:
            requested, in_turn = self._requested(now), next(iter(self._waiting), None)
            is_request = in_turn is None or not self._was_requested
            check = requested if requested is not None and is_request else in_turn
            self._was_requested = check is not None and check is requested
        if check is None and self._is_round_due(now):
            check, self._round_at = self._collect, None
        if check is None and self._suspects_may_begin:
            check, slow = next(iter(self._suspects)), 0.0
        if check is None:
            return None
        for line in (self._followers, self._waiting, self._suspects):
            line.pop(check, None)
        request = self._requests.get(check)
        if request is not None:
            request.turns -= 1
            request.due = None
            if not request.turns:
                del self._requests[check]
        self._running[check] = now, now + slow
        return check

    def done(self, check: Check, now: float) -> None:
        """Note that a check was made."""
        began, _ = self._running.pop(check)
        if now - began >= _SUSPECT_SECONDS:
            self._hung.add(check)
        else:
            self._hung.discard(check)
        request = self._requests.get(check)
        if request is not None:
            request.due = now + _AGAIN_SECONDS

    def wake_at(self, now: float) -> float | None:
        """Return when `take` may have a check that it does not have now; None: after `done`."""
        if len(self._running) >= self._most:
            return None
        quick = self._quick(now)
        if quick:
            return max(quick)
        if self._followers or self._waiting or self._suspects_may_begin:
            return now
        dues = [request.due for request in self._requests.values() if request.due is not None]
        if self._is_round_over(now) and self._round_at is not None:
            dues.append(self._round_at)
        return min(dues, default=None)

    @property
    def _suspects_may_begin(self) -> bool:
        return bool(self._suspects) and len(self._running) < self._most // 2

    def _quick(self, now: float) -> list[float]:
        """Return from when on those count as slow that do not yet: there is one at most."""
        return [slow_at for _, slow_at in self._running.values() if now < slow_at]

    def _requested(self, now: float) -> Check | None:
        for check, request in self._requests.items():
            if request.due is not None and request.due <= now and check not in self._running:
                return check
        return None

    def _is_round_over(self, now: float) -> bool:
        if self._waiting or self._followers or self._collect in self._running:
            return False
        if self._round_at is None:
            self._round_at = now + self._pause
        return True

    def _is_round_due(self, now: float) -> bool:
        return self._is_round_over(now) and self._round_at is not None and self._round_at <= now


class Ticker:
    """Makes checks in threads: mostly two, and another for each that takes long, 32 at most.

    Args:
        checks: returns those of a round; it does not block.
        seconds: pause between rounds; 0 for no check at all.
    """

    def __init__(self, checks: Callable[[], Collection[Check]], seconds: float) -> None:
        self._checks = checks
        self._seconds = seconds
        self._records = LimitedLog(_log)
        # Guards all fields below: requests come in threads of the ORB. Never held in a check.
        self._changed = threading.Condition(threading.Lock())
        self._queue = CheckQueue(self._collect, seconds)
        self._ended = False
        self._threads: set[threading.Thread] = set()
        # Until when; a thread that has not begun yet rests, too, or another would be added for it.
        self._resting: dict[threading.Thread, float] = {}

    def start(self) -> None:
        """Begin, where there are rounds at all.

        Raises:
            RuntimeError: the system gives no thread.
        """
        if self._seconds:
            with self._changed:
                for _ in range(_MOST_RESTING):  # as many as stay in the end
                    self._add_thread()
                if not self._threads:
                    raise RuntimeError("there is no thread that could watch components")

    def soon(self, check: Check) -> None:
        """Have a check made before its turn, and once more 20 ms later."""
        with self._changed:
            self._queue.request(check, time.monotonic())
            self._changed.notify()

    def follow(self, check: Check) -> None:
        """Have a check made after the one in whose thread this is called, before all others."""
        with self._changed:
            self._queue.follow(check)

    def close(self, seconds: float) -> None:
        """End the threads after the checks under way, and wait for these up to `seconds` in all.

        A thread that lets go of references while the interpreter ends aborts the process.
        """
        with self._changed:
            self._ended = True
            self._changed.notify_all()
            threads = self._threads - {threading.current_thread()}
        deadline = time.monotonic() + seconds
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))

    def _collect(self) -> None:
        checks = self._checks()
        with self._changed:
            self._queue.begin_round(checks)

    def _add_thread(self) -> None:
        """Have one more thread make checks; the caller holds the lock."""
        thread = threading.Thread(target=self._run, name="uoarm-rtm-watch", daemon=True)
        self._threads = {known for known in self._threads if known.is_alive()}
        with suppress(RuntimeError):  # no more can begin: those that there are go on
            thread.start()
            self._threads.add(thread)
            self._resting[thread] = math.inf

    def _run(self) -> None:
        # The check is not kept in this frame, which would hold its component while it rests.
        while self._make_next():
            pass

    def _make_next(self) -> bool:
        """Wait for a check and make it; returns whether this thread goes on."""
        check = self._next()
        if check is None:
            return False
        try:
            check()
        except Exception as error:  # noqa: BLE001 - one that fails hurts no other
            self._records.write(logging.ERROR, "a check of OpenRTM failed", error)
        with self._changed:
            self._queue.done(check, time.monotonic())
        return True

    def _next(self) -> Check | None:
        """Return the check to make in this thread; None ends it.

        While one is made another thread rests, and looks when that has taken long.
        """
        this = threading.current_thread()
        with self._changed:
            self._resting.pop(this, None)  # of one that begins
            while not self._ended:
                now = time.monotonic()
                check = self._queue.take(now)
                wake_at = self._queue.wake_at(now)
                until = math.inf if wake_at is None else wake_at
                if check is not None:
                    if not self._resting:
                        self._add_thread()
                    elif until < min(self._resting.values()):
                        self._changed.notify()  # it rests for too long
                    return check
                if len(self._resting) >= _MOST_RESTING:
                    return None
                self._resting[this] = until
                self._changed.wait(None if wake_at is None else max(0.0, wake_at - now))
                del self._resting[this]
            return None
