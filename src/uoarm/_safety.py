"""What keeps inputs that move something safe: the emergency stop, and the lease of one sender.

The emergency stop holds all of them at once, until it is released; a file keeps that over restarts.
`Lease` decides who may command an input, as a state machine without thread and clock; `InputLease`
wraps it for the threads that send.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import TypeAlias, TypeVar

from attrs import evolve

from uoarm._dataplane import Clock
from uoarm._raised import Log, foreign, reason_of, text_of
from uoarm._support.files import write_whole
from uoarm.bridge import Bridge, Sink, boot_seconds
from uoarm.errors import BridgeError, CommandRefusedError, FailureReason, UoarmError
from uoarm.model import (
    CommandPhase,
    CommandStatus,
    Endpoint,
    LeaseHolder,
    LeasePolicy,
    LeaseStatus,
    StopOutcome,
    StopReport,
)


class StopFile:
    """Whether all is stopped, kept over restarts. Thread safe."""

    def __init__(self, path: Path) -> None:
        self.path = path
        # Held from the question what is wanted to its answer on the disk: of two that settle it,
        # the later one asks later.
        self._lock = threading.Lock()

    def is_there(self) -> bool:
        """Say whether it is there; one that cannot be looked at is taken to be."""
        try:
            self.path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            return True
        return True

    def settle(self, wanted: Callable[[], bool]) -> None:
        """Have it there, readable by this user only, or not, as is wanted at this moment.

        Raises:
            OSError: it cannot be written or removed.
        """
        with self._lock:  # what is wanted is asked within: the one who settles last asks last
            if not wanted():
                self.path.unlink(missing_ok=True)
            elif not self.is_there():
                self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                text = (
                    f"stopped {datetime.now(timezone.utc).isoformat()} by process {os.getpid()}\n"
                )
                write_whole(self.path, text.encode(), private=True)

    def remove(self) -> None:
        """Have it there no more.

        Raises:
            OSError: it cannot be removed.
        """
        with self._lock:
            self.path.unlink(missing_ok=True)


T = TypeVar("T")
_log = Log("uoarm.commands")
_OPENING_SECONDS = 2.0
_SHARE = 0.8  # of the time, for the answer of an input; the rest is for what it says to get here


class _Call:
    """A call under way of a service that moves something.

    Attributes:
        is_cancelled: whether it was cancelled by an emergency stop.
    """

    closed = False

    def __init__(self, bridge: Bridge, endpoint: Endpoint, number: int) -> None:
        self.endpoint = endpoint
        self._number = number
        self.ended = threading.Event()
        self.is_cancelled = False
        self._bridge = bridge

    def cancel(self) -> bool:
        """Cancel it; say whether the framework could be notified."""
        return self._bridge.cancel_call(self._number)

    def hold(self, timeout: float) -> CommandStatus | str:
        """Cancel it, and wait for its end; say what came of it."""
        self.is_cancelled = True
        is_reported = self.cancel()
        if self.ended.wait(timeout):
            return CommandStatus(CommandPhase.STOPPED, since=0.0, held=True)
        if is_reported:
            return "a call of it was cancelled, and has not ended yet"
        return "a call of it is under way, which its framework cannot cancel"


_Moving: TypeAlias = "Sink | _Call | Bridge"
_Answer: TypeAlias = "CommandStatus | str | tuple[StopOutcome, ...]"


class EmergencyStop:
    """Holds what moves something: open inputs, calls under way, what begins meanwhile. Thread safe.

    Each is stopped in a thread of its own, so that none waits for one that hangs.

    Args:
        file: is there while all is held; where it is there already, all is held from the beginning.
        elsewhere: returns the bridges behind which everything that moves is stopped, too.
    """

    def __init__(
        self,
        clock: Clock,
        file: StopFile | None = None,
        elsewhere: Callable[[], Sequence[Bridge]] = tuple,
    ) -> None:
        self._clock = clock
        self._elsewhere = elsewhere
        self._file = file
        # Guards what is held and what is listed: what begins while it stops either is in the list
        # or sees that all is held.
        self._lock = threading.Lock()
        self._sinks: dict[Sink, str] = {}
        self._most_listed = 0  # with more, closed ones are left out: each would cost a look at all
        self._calls: dict[_Call, str] = {}
        self._numbers = itertools.count(1)
        self._asked = 0
        self._since = clock() if file is not None and file.is_there() else None

    @property
    def is_held(self) -> bool:
        """Whether commands are refused."""
        return self._since is not None

    def held(self) -> float | None:
        """Return for how many seconds commands are refused; None where they are not."""
        since = self._since
        return None if since is None else self._clock() - since

    def enter(self, sink: Sink, function: str) -> None:
        """Take in an input that was just opened; it is stopped where the others are held.

        Whichever comes first, this or `stop`: it is listed before it is asked whether all is held,
        and they are held before the list is read.
        """
        if sink.endpoint.command is None:
            return
        with self._lock:
            self._sinks[sink] = function
            if len(self._sinks) > self._most_listed:
                self._sinks = dict(self._open_sinks())
                self._most_listed = 2 * len(self._sinks)
        if self.is_held:
            sink.hold(_OPENING_SECONDS)

    def _open_sinks(self) -> list[tuple[Sink, str]]:
        return [(sink, function) for sink, function in self._sinks.items() if not sink.closed]

    def refuse(self, sink: Sink) -> None:
        """Raise CommandRefusedError for a command while all is held.

        The watchdog at the last hop refuses it as well; this spares the way there.
        """
        if self._since is not None and sink.endpoint.command is not None:
            text = f"{sink.endpoint}: commands are refused until the emergency stop is released"
            raise CommandRefusedError(text, "held")

    @contextmanager
    def calling(self, bridge: Bridge, endpoint: Endpoint, function: str) -> Iterator[int]:
        """Have a call of a service cancelled by a stop, where the service moves something.

        Gives the number that the call is to be made with.

        Raises:
            CommandRefusedError: all is held, or was meanwhile, so that the call was cancelled.
        """
        number = next(self._numbers)
        if endpoint.command is None:
            yield number
            return
        call = _Call(bridge, endpoint, number)
        with self._lock:  # a stop sees it listed, or it sees the stop
            if self._since is not None:
                text = f"{endpoint}: calls are refused until the emergency stop is released"
                raise CommandRefusedError(text, "held")
            self._calls[call] = function
        try:
            yield number
        except UoarmError as error:
            if call.is_cancelled:
                text = f"{endpoint}: the emergency stop cancelled the call: {error}"
                raise CommandRefusedError(text, "held") from error
            raise
        finally:
            with self._lock:
                del self._calls[call]
            call.ended.set()

    def begin_close(self) -> None:
        """Have every input stopped, and take no more, and calls cancelled; waits for nothing.

        Before what they belong to is closed, one after another: no stop waits for what hangs.
        """
        with self._lock:
            sinks, calls = self._open_sinks(), tuple(self._calls)
        for sink, _ in sinks:
            sink.begin_close()
        _each(_Call.cancel, calls, {}, 0.0)

    def stop(self, timeout: float) -> StopReport:
        """Stop everything; say what came of it. Blocks for `timeout` seconds at most."""
        with self._lock:
            since = self._since = self._clock() if self._since is None else self._since
            self._asked += 1
            listed: Iterable[tuple[_Moving, str]] = (
                *self._open_sinks(),
                *self._calls.items(),
                *((bridge, "") for bridge in self._elsewhere()),
            )
            moving = dict(listed)
        keeping = self._keep()
        deadline = time.monotonic() + timeout
        results: dict[_Moving, _Answer] = {}

        def hold(item: _Moving) -> None:
            if isinstance(item, Bridge):
                results[item] = item.stop_all(timeout=_SHARE * timeout)
            else:
                results[item] = (
                    item.hold(_SHARE * timeout) or "its bridge host is gone: it was not asked"
                )

        _each(hold, moving, results, timeout)
        late = f"no answer within {timeout:g} s"
        unkept = keeping(max(0.0, deadline - time.monotonic()))
        outcomes = [
            outcome
            for item, function in moving.items()
            if not item.closed
            for outcome in _outcomes(item, function, results.get(item, late))
        ]
        return StopReport(
            self._clock() - since,
            tuple(sorted(outcomes, key=lambda outcome: (outcome.component, outcome.port))),
            unkept,
        )

    def _keep(self) -> Callable[[float], str]:
        """Begin to settle the file; what is returned waits for it, and says why it is not there.

        A disk that hangs keeps nothing from being stopped.
        """
        file = self._file
        if file is None:
            return lambda _: ""
        reports = [f"{file.path} is not settled yet"]

        def write() -> None:
            try:
                file.settle(lambda: self.is_held)
            except OSError as error:
                reports[0] = f"{file.path} cannot be written: {reason_of(error, file.path)}"
            else:
                reports[0] = ""

        thread = threading.Thread(target=write, name="uoarm-stop-file", daemon=True)
        with suppress(RuntimeError):  # the system gives no more threads
            thread.start()

        def wait(timeout: float) -> str:
            if thread.ident is None:
                write()
            else:
                thread.join(timeout)
            return reports[0]

        return wait

    def release(self, timeout: float) -> None:
        """Let commands through again; what has stopped stays so until the next one.

        Raises:
            BridgeError: inputs could not be reached, which go on refusing commands; or nothing was
                released, since the file cannot be removed, or another stop came meanwhile.
        """
        asked = self._asked
        self._forget()
        with self._lock:
            overtaken = self._asked != asked
            if not overtaken:
                self._since = None
            sinks = dict(self._open_sinks())
        unsettled = self._keep()(timeout)  # a stop may have written it since, or be writing it
        if unsettled:
            _log.warning("%s", unsettled)
        if overtaken:
            text = "nothing was released: everything was stopped again meanwhile"
            raise BridgeError(text, FailureReason.REFUSED)
        results: dict[Sink | Bridge, _Answer] = {}

        def release(item: Sink | Bridge) -> None:
            if isinstance(item, Bridge):
                item.stop_all(release=True, timeout=_SHARE * timeout)
            else:
                item.release()
            results[item] = ""

        held_items: tuple[Sink | Bridge, ...] = (*sinks, *self._elsewhere())
        _each(release, held_items, results, timeout)
        held = [
            f"{_place(item)}: {report}"
            for item in held_items
            if not item.closed and (report := results.get(item, f"no answer within {timeout:g} s"))
        ]
        if held:
            text = f"these inputs go on refusing commands: {'; '.join(held)}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def _forget(self) -> None:
        if self._file is None:
            return
        try:
            self._file.remove()
        except OSError as error:
            why = reason_of(error, self._file.path)
            text = f"nothing was released: {self._file.path} cannot be removed: {why}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error


def _each(
    act: Callable[[T], object],
    moving: Iterable[T],
    results: dict[T, _Answer],
    timeout: float,
) -> None:
    """Do something to everything that moves, in a thread for each; note what it raises."""

    def begin(item: T) -> None:
        try:
            foreign(act, item)
        except Exception as error:  # noqa: BLE001 - a bridge may raise anything
            results[item] = text_of(error)

    threads: list[threading.Thread] = []
    left: list[T] = []
    for item in moving:
        thread = threading.Thread(target=begin, args=(item,), name="uoarm-stop", daemon=True)
        try:
            thread.start()
        except RuntimeError:  # the system gives no more threads
            left.append(item)
        else:
            threads.append(thread)
    deadline = time.monotonic() + timeout
    for item in left:  # here, one after another: late is better than not at all
        begin(item)
    for thread in threads:
        thread.join(max(0.0, deadline - time.monotonic()))


def _place(item: Sink | Bridge) -> str:
    if isinstance(item, Bridge):
        return f"bridge {item.name}"
    return f"{item.endpoint.component}.{item.endpoint.port}"


def _outcomes(moved: _Moving, function: str, answer: _Answer) -> Iterator[StopOutcome]:
    if not isinstance(moved, Bridge):
        assert not isinstance(answer, tuple), "of a bridge only"
        yield _outcome(moved, function, answer)
    elif isinstance(answer, tuple):
        for outcome in answer:
            yield evolve(outcome, component=f"{moved.name}/{outcome.component}")
    else:
        assert isinstance(answer, str), "a bridge returns outcomes, or raises"
        cause = f"what is behind the bridge could not be asked: {answer}"
        yield StopOutcome("", moved.name, "*", stopped=False, cause=cause)


def _outcome(moved: Sink | _Call, function: str, answer: CommandStatus | str) -> StopOutcome:
    endpoint = moved.endpoint
    component, port = endpoint.component, endpoint.port
    if isinstance(answer, str):
        return StopOutcome(function, component, port, stopped=False, cause=answer)
    if answer.phase is CommandPhase.STOPPED and answer.held:
        return StopOutcome(function, component, port, stopped=True, since=answer.since)
    assert endpoint.command is not None, "only those are listed"
    if endpoint.command.stop is None:
        cause = "it has no stop message; commands are refused"
    else:
        cause = answer.cause or "it has not taken the stop message yet"
    return StopOutcome(function, component, port, stopped=False, cause=cause)


class Lease:
    """One holder at a time, until it gives it back, sends nothing for a while, or is overridden."""

    def __init__(self, policy: LeasePolicy) -> None:
        self._duration = policy.duration
        self._priorities = dict(policy.priorities)
        self._holder: LeaseHolder | None = None
        self._until = 0.0
        self._refused = 0

    def holder(self, now: float) -> LeaseHolder | None:
        """Return who holds it; None where it is free."""
        return self._holder if now < self._until else None

    def ask(self, sender: LeaseHolder, now: float, *, take_over: bool = False) -> str:
        """Give it to a sender or renew it; return why it may not have it, nothing where it has it.

        The first to ask has it. One of a higher priority takes it over; one of the same
        priority does where it wants to.
        """
        holder = self.holder(now)
        if holder is not None and holder.id != sender.id:
            mine, other = self._priority(sender), self._priority(holder)
            if mine < other or (mine == other and not take_over):
                self._refused += 1
                left = f"for another {self._until - now:.3f} s without a command of its own"
                return f"{holder} holds its lease, {left}"
        self._holder, self._until = sender, now + self._duration
        return ""

    def passes(self, sender: LeaseHolder, now: float) -> bool:
        """Say whether a command that was let in may still go on: no other client has the input."""
        holder = self.holder(now)
        if holder is None or holder.id == sender.id:
            return True
        self._refused += 1
        return False

    def give_back(self, sender: LeaseHolder, now: float) -> bool:
        """Free it; return whether this sender held it."""
        holder = self.holder(now)
        if holder is None or holder.id != sender.id:
            return False
        self._holder = None
        self._until = now
        return True

    def status(self, now: float) -> LeaseStatus:
        """Return what the status map shows."""
        holder = self.holder(now)
        if holder is None:
            return LeaseStatus(refused=self._refused)
        return LeaseStatus(holder, self._priority(holder), self._until - now, self._refused)

    def _priority(self, sender: LeaseHolder) -> float:
        return self._priorities.get(sender.role, 0.0)


class InputLease:
    """The lease of one open input. Thread safe.

    Args:
        place: of the input, `base.default`.
        announce: called with a sentence on who holds it, whenever a client's call changes that;
            a lapse is not announced.
    """

    def __init__(
        self,
        policy: LeasePolicy,
        place: str,
        announce: Callable[[str], None],
        clock: Clock = boot_seconds,
    ) -> None:
        self._lease = Lease(policy)
        self._place = place
        self._announce = announce
        self._clock = clock
        # Guards the lease, which knows no threads. Listeners are notified without it.
        self._lock = threading.Lock()

    def ask(self, sender: LeaseHolder, *, take_over: bool = False) -> None:
        """Give it to a sender or renew it; see `Lease.ask`.

        Raises:
            CommandRefusedError: another client holds it, which the text names.
        """
        with self._lock:
            now = self._clock()
            before = self._lease.holder(now)
            refused = self._lease.ask(sender, now, take_over=take_over)
        if refused:
            raise CommandRefusedError(f"{self._place}: {refused}", "leased")
        if before is None or before.id != sender.id:
            over = "" if before is None else f", who took it over from {before}"
            self._announce(f"{self._place}: {sender} holds its lease{over}")

    def require(self, sender: LeaseHolder) -> None:
        """Refuse a command whose sender has lost it since.

        Raises:
            CommandRefusedError: another client holds it.
        """
        with self._lock:
            passes = self._lease.passes(sender, self._clock())
        if not passes:
            text = f"{self._place}: its lease was taken over while the command waited"
            raise CommandRefusedError(text, "leased")

    def is_open_to(self, sender: LeaseHolder) -> bool:
        """Say whether this sender holds it, or no client does."""
        with self._lock:
            holder = self._lease.holder(self._clock())
        return holder is None or holder.id == sender.id

    def give_back(self, sender: LeaseHolder) -> bool:
        """Free it; return whether this sender held it."""
        with self._lock:
            held = self._lease.give_back(sender, self._clock())
        if held:
            self._announce(f"{self._place}: {sender} gave its lease back")
        return held

    def status(self) -> LeaseStatus:
        """Return what the status map shows."""
        with self._lock:
            return self._lease.status(self._clock())
