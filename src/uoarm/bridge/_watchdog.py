"""The watchdog of one input that moves something, before the `send` of its bridge.

It depends on nothing but its own thread and a clock, so that the stop goes out when the client,
the manager, or the link between died, hangs, or stands still. What it decides is in
`_command_state.py`.
"""

from __future__ import annotations

import copy
import logging
import math
import threading
import time
from collections.abc import Callable

from uoarm._raised import LimitedLog, foreign, text_of
from uoarm.bridge._command_state import CommandState
from uoarm.errors import CommandRefusedError
from uoarm.model import CommandPhase, CommandPolicy, CommandStatus, Message

__all__ = ["Watchdog", "boot_seconds"]

_log = logging.getLogger("uoarm.commands")
_LONGEST_SECONDS = 3600.0
_LAST_SECONDS = 0.5


def boot_seconds() -> float:
    """Return seconds of a clock that nobody sets and that goes on while the machine is suspended.

    All processes of a machine have the same one.
    """
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


class Watchdog:
    """Lets the commands of one input through, and sends the stop when they cease. Thread safe.

    Args:
        policy: of the input.
        send: hands a message to the framework.
        name: of the input, for people.
        parallel: whether `send` may be called while another call of it is under way. Otherwise
            the stop waits for a `send` that does not return.
        report_stop: called when a stop was not taken, with the cause; with an empty text when one
            was taken again.
        clock: seconds.
    """

    def __init__(
        self,
        policy: CommandPolicy,
        send: Callable[[Message], None],
        name: str,
        *,
        parallel: bool = False,
        report_stop: Callable[[str], None] = lambda _: None,
        clock: Callable[[], float] = boot_seconds,
    ) -> None:
        self._send = send
        self._name = name
        self._report_stop = report_stop
        self._clock = clock
        self._stop = policy.stop
        self._state = CommandState(policy, clock())
        self._changed = threading.Condition()
        self._turn = None if parallel else threading.Lock()
        self._asleep_until = -math.inf
        self._thread: threading.Thread | None = None
        self._ended = False
        self._records = LimitedLog(_log)

    def send(self, message: Message, age: float) -> None:
        """Send a command, unless it is refused.

        Raises:
            CommandRefusedError: with the reason by which it counts as dropped.
            Exception: what `send` of the framework raises.
        """
        with self._changed:  # before its turn: what is refused must not keep the stop waiting
            if self._state.held or self._state.phase is CommandPhase.STOPPING:
                self._offer(message, age)
        if self._turn is None:
            self._send_command(message, age)
        else:
            with self._turn:
                self._send_command(message, age)

    def halt(self, timeout: float) -> CommandStatus:
        """Stop what moves now; wait for the stop to be taken. Refuses nothing afterwards."""
        with self._changed:
            self._state.halt(self._clock())
            self._wake()
            self._changed.wait_for(self._is_at_rest, timeout)
            return self._state.status(self._clock())

    def hold(self, timeout: float) -> CommandStatus:
        """Stop, and refuse every command until `release`; wait for the stop to be taken."""
        with self._changed:
            self._state.hold(self._clock())
            self._wake()
            self._changed.wait_for(lambda: self._ended or self._is_at_rest(), timeout)
            return self._state.status(self._clock())

    def release(self) -> None:
        """Let commands through again."""
        with self._changed:
            self._state.release()

    def status(self) -> CommandStatus:
        """Return what it was told last, and how long that holds."""
        with self._changed:
            return self._state.status(self._clock())

    def close(self) -> bool:
        """Let nothing more through, and stop what moves; wait for that half a second at most.

        Returns whether a stop was taken last, now or before: it may not have arrived yet.
        """
        with self._changed:
            self._state.close(self._clock())
            if not self._is_at_rest():
                self._wake()
                self._changed.wait_for(self._is_at_rest, _LAST_SECONDS)
            is_at_rest = self._is_at_rest()
            self._ended = True
            self._changed.notify_all()
            was_stopped = self._state.phase is CommandPhase.STOPPED
        if not is_at_rest:
            _log.error("%s was closed before it took its stop message", self._name)
        return was_stopped

    def _is_at_rest(self) -> bool:
        return self._state.phase in {CommandPhase.IDLE, CommandPhase.STOPPED} or self._stop is None

    def _offer(self, message: Message, age: float) -> None:
        refused = self._state.offer(message, self._clock(), age)
        if refused:
            raise CommandRefusedError(f"{self._name}: {refused.sentence}", refused.reason)

    def _send_command(self, message: Message, age: float) -> None:
        with self._changed:
            self._offer(message, age)
            if self._state.wake_at() < self._asleep_until or self._thread is None:
                self._wake()
        try:
            self._send(message)
        finally:
            with self._changed:
                self._state.sent(self._clock())
                if self._state.phase is CommandPhase.STOPPING:
                    self._changed.notify_all()

    def _wake(self) -> None:
        """Have the thread look again; it is there from the first command on."""
        if self._stop is None:
            return
        if self._thread is None:
            name = f"uoarm-watchdog-{self._name}"
            self._thread = threading.Thread(target=self._watch, name=name, daemon=True)
            self._thread.start()
        self._changed.notify_all()

    def _watch(self) -> None:
        while self._wait_until_due():
            if self._turn is None:
                self._send_stop()
            else:
                with self._turn:
                    self._send_stop()

    def _wait_until_due(self) -> bool:
        """Return True when the stop is due; False at the end."""
        with self._changed:
            while not self._ended:
                now = self._clock()
                if self._state.is_due(now):
                    return True
                self._asleep_until = self._state.wake_at()
                self._changed.wait(min(self._asleep_until - now, _LONGEST_SECONDS))
        return False

    def _send_stop(self) -> None:
        assert self._stop is not None, "without a stop message none is due"
        with self._changed:
            # While it waited for its turn, what was due may have been taken back by nobody: only
            # the end of the channel is left.
            if self._ended or not self._state.begin_stop(self._clock()):
                return
        try:
            foreign(self._send, copy.deepcopy(self._stop.message))
        except Exception as error:  # noqa: BLE001 - a framework may raise anything
            self._failed(text_of(error))
        else:
            self._taken()

    def _taken(self) -> None:
        with self._changed:
            was_failing = bool(self._state.cause)
            self._state.stop_taken(self._clock())
            self._changed.notify_all()
        if was_failing:
            self._report_stop("")

    def _failed(self, cause: str) -> None:
        with self._changed:
            was_failing = bool(self._state.cause)
            self._state.stop_failed(self._clock(), cause)
        self._records.write(logging.ERROR, f"{self._name} did not take its stop message: {cause}")
        if not was_failing:
            self._report_stop(f"its stop message was not taken: {cause}")
