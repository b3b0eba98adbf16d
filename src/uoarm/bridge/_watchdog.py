"""The watchdog of one input that moves something, before the `send` of its bridge.

It depends on nothing but its own thread and a clock, so that the stop goes out when the client,
the manager, or the link between died, hangs, or stands still. What it decides is in
`CommandState`: a state machine that touches no thread, clock or framework. Commands, results and
the time go in, what to do comes out. Times are seconds of one monotonic clock.
"""

from __future__ import annotations

import copy
import logging
import math
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from numbers import Real
from typing import ClassVar, final

from attrs import frozen

from uoarm._backoff import Backoff
from uoarm._forks import at_exit, forks
from uoarm._raised import LimitedLog, Log, foreign, text_of
from uoarm.errors import CommandRefusedError
from uoarm.model import CommandPhase, CommandPolicy, CommandStatus, FieldLimit, Message

_STOP_BACKOFF = Backoff(first=0.02, most=0.5)


@frozen
class Refusal:
    """Why a command is not sent: one word, by which it is counted, and a sentence."""

    reason: str
    sentence: str


class CommandState:
    """The last command of one input, until when it holds, and whether the stop is due.

    Who uses it asks `offer` before each command is sent and says `sent` after it, sends the stop
    message when `is_due`, and says what became of it. Commands are sent one at a time. The
    stop may be sent while a command is: it then counts as taken only when it is sent once more,
    since the command may arrive behind it.

    Attributes:
        phase: of its last command.
        held: whether every command is refused.
        dropped: commands refused, by reason.
        cause: why the last stop was not taken.
        stops: how many stop messages were taken.
    """

    def __init__(self, policy: CommandPolicy, now: float) -> None:
        self._lifetime = math.inf if policy.lifetime is None else policy.lifetime
        self._can_stop = policy.stop is not None
        rest = None if policy.stop is None else policy.stop.message
        self._limits = [(limit, _at(rest, limit.path)) for limit in policy.limits]
        self._values: list[tuple[float | None, float]] = [(at, -math.inf) for _, at in self._limits]
        self._since = now
        self._until = math.inf
        self._due = math.inf
        self._failed = 0
        self._is_sending = False
        self._has_crossed = False
        self._closed = False
        self.phase = CommandPhase.IDLE
        self.held = False
        self.dropped: dict[str, int] = {}
        self.cause = ""
        self.stops = 0

    def offer(self, message: Message, now: float, age: float = 0.0) -> Refusal | None:
        """Take a command in; return why it may not be sent, None when it must be sent now.

        Args:
            message: the command.
            now: the time.
            age: seconds since it left its sender.
        """
        self.advance(now)
        refusal = self._refusal(message, now, max(0.0, age))
        if refusal is not None:
            self.dropped[refusal.reason] = self.dropped.get(refusal.reason, 0) + 1
            return refusal
        self._is_sending = True
        self._until = now - max(0.0, age) + self._lifetime
        self._values = [(_at(message, field_limit.path), now) for field_limit, _ in self._limits]
        if self.phase is not CommandPhase.MOVING:
            self._turn(CommandPhase.MOVING, now)
        return None

    def sent(self, now: float) -> None:
        """Take in that the sending of a command is over, whatever it came to.

        One that raised may have arrived all the same, so it is stopped as any other.
        """
        self._is_sending = False
        if self.phase is CommandPhase.STOPPING and self._due == math.inf:
            self._due = now

    def advance(self, now: float) -> None:
        """Let a command expire whose time is over."""
        if self.phase is CommandPhase.MOVING and now >= self._until:
            self._stop(now)

    def is_due(self, now: float) -> bool:
        """Say whether the stop message must be sent now."""
        self.advance(now)
        return self.phase is CommandPhase.STOPPING and now >= self._due

    def begin_stop(self, now: float) -> bool:
        """Say whether the stop is due still; the caller then sends it, one at a time."""
        self._has_crossed = self._is_sending
        return self.is_due(now)

    def stop_taken(self, now: float) -> None:
        """Take in that the sink took the stop message."""
        self.stops += 1
        self.cause = ""
        self._failed = 0
        if self.phase is not CommandPhase.STOPPING:
            return
        if self._has_crossed:
            self._due = math.inf if self._is_sending else now
        else:
            self._turn(CommandPhase.STOPPED, now)
            self._values = [(rest, -math.inf) for _, rest in self._limits]

    def stop_failed(self, now: float, cause: str) -> None:
        """Take in that the sink did not take the stop message: it is due again after a pause."""
        self.cause = cause
        self._failed += 1
        self._due = now + _STOP_BACKOFF.pause(self._failed)

    def halt(self, now: float) -> None:
        """Stop what moves, now and not when it expires; the next command moves it again."""
        if self.phase is CommandPhase.MOVING:
            self._stop(now)

    def hold(self, now: float) -> None:
        """Refuse every command from now on, and stop, also what stands still."""
        self.held = True
        self._stop(now)

    def release(self) -> None:
        """Let commands through again; what has stopped stays so until the next one."""
        self.held = False

    def close(self, now: float) -> None:
        """Refuse every command for good; what moves is stopped."""
        self._closed = True
        if self.phase is CommandPhase.MOVING:
            self._stop(now)

    def wake_at(self) -> float:
        """Return when `is_due` may change without anything being said, infinity for never."""
        if self.phase is CommandPhase.MOVING:
            return self._until
        return self._due if self.phase is CommandPhase.STOPPING else math.inf

    def status(self, now: float) -> CommandStatus:
        """Return what the status map shows."""
        moving = self.phase is CommandPhase.MOVING and self._until < math.inf
        return CommandStatus(
            self.phase,
            since=now - self._since,
            left=max(0.0, self._until - now) if moving else None,
            held=self.held,
            stops=self.stops,
            dropped=tuple(sorted(self.dropped.items())),
            cause=self.cause,
        )

    def _refusal(self, message: Message, now: float, age: float) -> Refusal | None:
        if self._closed:
            return Refusal("closed", "it is closed")
        if self.held:
            return Refusal("held", "commands are refused until the emergency stop is released")
        if self.phase is CommandPhase.STOPPING:
            return Refusal("stopping", "it has not taken the stop message yet that is on its way")
        if age >= self._lifetime:
            lifetime = f"more than its lifetime of {self._lifetime:g} s"
            return Refusal("late", f"the command is {age:.3f} s old, {lifetime}")
        for (limit, _), (before, when) in zip(self._limits, self._values, strict=True):
            elapsed = min(now - when, self._lifetime)  # a pause gives no leave for a jump
            text = _beyond(limit, _at(message, limit.path), before, elapsed)
            if text:
                return Refusal("beyond-limits", text)
        return None

    def _stop(self, now: float) -> None:
        if not self._can_stop:
            return
        self._due = now
        self._failed = 0
        if self.phase is not CommandPhase.STOPPING:
            self._turn(CommandPhase.STOPPING, now)

    def _turn(self, phase: CommandPhase, now: float) -> None:
        self.phase = phase
        self._since = now


def _at(message: object, path: str) -> float | None:
    """Return the number at a path, None where there is none."""
    for part in () if path == "." else path.split("."):
        if not isinstance(message, Mapping):
            return None
        message = message.get(part)
    if isinstance(message, bool) or not isinstance(message, Real):
        return None
    try:
        return float(message)
    except OverflowError:  # of an integer that JSON writes and no motor means
        return math.inf


def _beyond(limit: FieldLimit, value: float | None, before: float | None, elapsed: float) -> str:
    """Return how a value is beyond its limits; nothing where it is within them."""
    if value is None or not math.isfinite(value):
        return f"{limit.path} is no finite number, which its limits need"
    if limit.minimum is not None and value < limit.minimum:
        return f"{limit.path} is {value:g}, less than {limit.minimum:g}"
    if limit.maximum is not None and value > limit.maximum:
        return f"{limit.path} is {value:g}, more than {limit.maximum:g}"
    if limit.rate is None or before is None or elapsed == math.inf:
        return ""
    if abs(value - before) > limit.rate * elapsed * (1 + 1e-9):
        rate = abs(value - before) / elapsed if elapsed > 0 else math.inf
        return f"{limit.path} would change by {rate:g} in a second, more than {limit.rate:g}"
    return ""


_log = Log("uoarm.commands")
_LONGEST_SECONDS = 3600.0
_LAST_SECONDS = 0.5
_BEGIN_SECONDS = 5.0  # for a thread to get the processor; a machine that needs longer stands still


def boot_seconds() -> float:
    """Return seconds of a clock that is never set and that goes on while the machine is suspended.

    All processes of a machine have the same one.
    """
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


class Watchdog:
    """Lets the commands of one input through, and sends the stop when they cease. Thread safe.

    Args:
        send: hands a message to the framework.
        name: of the input, for people.
        parallel: whether `send` may be called while another call of it is under way. Otherwise
            the stop waits for a `send` that does not return.
        report_stop: called when a stop was not taken, with the cause; with an empty text when one
            was taken again.
        report_first: called before the first command is sent; returns at once.
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
        report_first: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = boot_seconds,
    ) -> None:
        self._send = send
        self._name = name
        self._report_stop = report_stop
        self._report_first = report_first
        self._clock = clock
        self._stop = policy.stop
        self._state = CommandState(policy, clock())
        self._changed = threading.Condition()
        self._turn = None if parallel else threading.Lock()
        self._asleep_until = -math.inf
        self._is_stopping = False  # whether the thread sends the stop, or waits for its turn to
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
        """Return its last command, and how long that holds."""
        with self._changed:
            return self._state.status(self._clock())

    def begin_close(self) -> None:
        """Let nothing more through, and have what moves stopped; waits for nothing."""
        with self._changed:
            self._state.close(self._clock())
            if not self._is_at_rest():
                self._wake()

    def close(self) -> bool:
        """Let nothing more through, and stop what moves.

        Waits for the framework half a second at most, once the thread has the processor, for which
        it has five. Returns whether a stop was taken last, now or before: it may not have arrived
        yet.
        """
        with self._changed:
            self.begin_close()
            if not self._is_at_rest():
                # On a busy machine the half second is over before the thread has begun.
                self._changed.wait_for(self._has_begun, _BEGIN_SECONDS)
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

    def _has_begun(self) -> bool:
        return self._is_stopping or not self._state.is_due(self._clock())

    def _offer(self, message: Message, age: float) -> None:
        refused = self._state.offer(message, self._clock(), age)
        if refused:
            raise CommandRefusedError(f"{self._name}: {refused.sentence}", refused.reason)

    def _send_command(self, message: Message, age: float) -> None:
        with self._changed:
            if self._thread is None:
                self._wake()  # first: a command that no thread watches would never be stopped
            self._offer(message, age)
            if self._state.wake_at() < self._asleep_until:
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
            thread = threading.Thread(target=self._watch, name=name, daemon=True)
            thread.start()
            self._report_first()
            self._thread = thread
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
                    self._is_stopping = True
                    self._changed.notify_all()
                    return True
                self._asleep_until = self._state.wake_at()
                self._changed.wait(min(self._asleep_until - now, _LONGEST_SECONDS))
        return False

    def _send_stop(self) -> None:
        assert self._stop is not None, "without a stop message none is due"
        with self._changed:
            # While it waited for its turn, what was due may not have been taken back: only
            # the end of the channel is left.
            if self._ended or not self._state.begin_stop(self._clock()):
                self._is_stopping = False
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
            self._is_stopping = False
            self._changed.notify_all()
        if was_failing:
            self._report_stop("")

    def _failed(self, cause: str) -> None:
        with self._changed:
            was_failing = bool(self._state.cause)
            self._state.stop_failed(self._clock(), cause)
            self._is_stopping = False
        self._records.write(logging.ERROR, f"{self._name} did not take its stop message: {cause}")
        if not was_failing:
            self._report_stop(f"its stop message was not taken: {cause}")


@final
class ExitStops:
    """What is stopped where a program ends without closing: the moving inputs of one bridge.

    They are registered together, with the first command: what the framework registered for its end
    came before, and runs later. `atexit` keeps the place of all that it was ever given, so one for
    each input would be one for each time that it was opened. The first of all bridges has those of
    the others begin, too. Thread safe.
    """

    _all: ClassVar[weakref.WeakSet[ExitStops]] = weakref.WeakSet()

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stops: dict[Callable[[], object], Callable[[], object]] = {}
        self._forget: Callable[[], None] | None = None
        self._process = 0

    def add(self, begin: Callable[[], object], end: Callable[[], object]) -> None:
        """Have an input stopped as the interpreter ends.

        Args:
            begin: has the stop sent; returns at once.
            end: waits for it.
        """
        with self._lock:
            self._stops[end] = begin
            if self._forget is None:
                self._forget = at_exit(self._stop_all)
                self._process = forks.generation
                self._all.add(self)

    def discard(self, end: Callable[[], object]) -> None:
        """Do without an input: it was stopped. Idempotent."""
        with self._lock:
            self._stops.pop(end, None)

    def close(self) -> None:
        """Let go of the interpreter's end. Idempotent."""
        with self._lock:
            forget, self._forget = self._forget, None
        if forget is not None:
            forget()

    def _stop_all(self) -> None:
        # All of them first: none waits for one whose component hangs.
        begins = [
            begin
            for stops in tuple(self._all)
            if stops._process == self._process  # noqa: SLF001 - others of a parent are its own
            for begin in tuple(stops._stops.values())  # noqa: SLF001 - one of these
        ]
        for call in (*begins, *tuple(self._stops)):
            try:
                foreign(call)
            except Exception as error:  # noqa: BLE001 - the others must be stopped, too
                text = "what moves was not stopped as its program ended"
                LimitedLog(_log).write(logging.ERROR, text, error)
