"""Channels: one open native link each, with a close that always ends.

A `ReceiveQueue` stands between a framework's thread and one of the channel: bounded, and counted.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar, final

from uoarm._forks import forks
from uoarm._raised import LimitedLog
from uoarm._support import deadlines
from uoarm._support.deadlines import BoundedStep
from uoarm.bridge._border import Gate, translated
from uoarm.bridge._watchdog import ExitStops, Watchdog
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import CommandStatus, Endpoint, Message, QueuePolicy

Outcomes = Callable[[int, int, int, str], None]
"""Takes how many messages a component took, on how many it raised, on how many it failed that
were wrong themselves, and the text of the last failure."""

_CLOSE_SECONDS = 5.0
_LAST_SECONDS = 0.5
_log = logging.getLogger("uoarm")


class Channel:
    """One open native link of a bridge.

    Usable as it is, with a function that closes the link, and to be subclassed: a subclass must
    override `_close`, and may override `facts` and `drain`.

    Args:
        endpoint: where it is open.
        close: lets go of the native link; see `_close`, for which it stands.
    """

    def __init__(self, endpoint: Endpoint, close: Callable[[], object] | None = None) -> None:
        if close is None and not self._overrides("_close", Channel):
            text = f"{type(self).__name__}: pass a function `close`, or override `_close`"
            raise TypeError(text)
        self.endpoint = endpoint
        self._close_given = close
        self._closing = threading.Lock()
        self._closed = False
        self._closes_until = 0.0  # when a close that is under way is given up
        self._closer: int | None = None  # the thread that lets go of the link
        self._process = forks.generation
        self._let_go = False
        self._when_closed: Callable[[Channel], None] | None = None
        self._gate: Gate | None = None
        self._is_quick = False

    @final
    @property
    def closed(self) -> bool:
        """Whether `close` was called, whatever it came to."""
        return self._closed

    @final
    @property
    def is_in_use(self) -> bool:
        """Whether the framework has the link still: it is open, or has not let go yet."""
        return not self._let_go

    @final
    def close(self, *, timeout: float = _CLOSE_SECONDS) -> None:
        """Close the link. Idempotent; may be called from any thread, that of `deliver` too.

        Does nothing in a forked child.

        The channel counts as closed from the beginning of the call, also when it raises. No
        `deliver` begins after it has returned; one under way may still finish.

        Raises:
            BridgeTimeoutError: the framework did not let go within `timeout` seconds.
            BridgeError: the framework failed while closing.
        """
        if forks.generation != self._process:
            return  # in a child that was forked: it is its parent's
        with self._closing:
            if self._closed:
                return
            self._closed = True
            self._closes_until = time.monotonic() + timeout
        try:
            if self._gate is not None:
                # In this thread, not a step's: a `deliver` that closes its own channel has the turn
                self._gate.shut()
            step = BoundedStep(f"bridge {self.endpoint.bridge!r}: closing ", self.endpoint)
            with translated(step):
                deadlines.run(step, timeout, self._close_native, keeps_time=self._is_quick)
        finally:
            if self._when_closed is not None:
                self._when_closed(self)

    def _overrides(self, step: str, base: type[Channel]) -> bool:
        return getattr(type(self), step) is not getattr(base, step)

    def _close_native(self) -> None:
        self._closer = threading.get_ident()
        try:
            self._before_close()
            self._close()
        finally:
            self._let_go = True

    def _before_close(self) -> None:
        """Do what must be done while the link still stands."""

    def facts(self) -> Mapping[str, object]:
        """Return what the framework knows of the link now, for the status.

        May be overridden. Must return at once, from any thread, after `close` too. Names are
        free, but two have a meaning for the manager: `under_way` counts messages that the channel
        took and that have not arrived, `lost_on_link` those that never will. When a component
        dies, both are counted as lost.
        """
        return {}

    def drain(self, timeout: float) -> bool:
        """Wait until what is under way has arrived; False when `timeout` seconds were too few.

        May be overridden, by channels whose `send` or framework hands messages to a thread or a
        process beside, so that an orderly end loses nothing. Must not return True before
        the last message that was sent has arrived, nor take longer than `timeout`. It is never
        called from within `deliver`.
        """
        del timeout
        return True

    def _close(self) -> None:
        """Let go of the native link; called once, in a thread of the core.

        Must be overridden where no function `close` was given. Must not wait for a `deliver`
        under way, since that may be what asked for the close. May go on calling `deliver`, which
        does nothing any more. May raise: the link counts as closed all the same.
        """
        close, self._close_given = self._close_given, None  # most of them know the channel
        assert close is not None, "the constructor saw to that"
        close()


class NativeLink(Channel):
    """A native link from one component to another, of the same bridge.

    Usable as it is, with a function that closes the link, and to be subclassed, as any channel.
    What is reported of it is about the component at one of its ends: see `Bridge.report`.

    Args:
        source: the output at its beginning, its `endpoint`.
        sink: the input at its end.
        close: lets go of the native link.

    Attributes:
        sink: the input at its end.
    """

    def __init__(
        self, source: Endpoint, sink: Endpoint, close: Callable[[], object] | None = None
    ) -> None:
        super().__init__(source, close)
        self.sink = sink


class Source(Channel):
    """A channel out of a component, whose messages go to the `deliver` that it was opened with.

    A subclass must override `_close`.

    Args:
        endpoint: where it is open.
        close: lets go of the native link.
        latched: the attribute.

    Attributes:
        latched: whether the last message stands until the next one, as a map or a setting does
            and a measurement does not: each consumer that joins the open source first gets it.
            Read once, when the source has opened.
        depth: how many messages of each writer stand where it is latched. Read once, too.
        patience: seconds that `deliver` waits in a bridge host whose manager takes nothing, before
            messages are dropped and counted; more where the framework promises that nothing is
            lost, and keeps what is not taken yet. Read once, when the source has opened.
    """

    latched: bool = False
    depth: int = 1
    patience: float = 1.0

    def __init__(
        self,
        endpoint: Endpoint,
        close: Callable[[], object] | None = None,
        *,
        latched: bool | None = None,
    ) -> None:
        super().__init__(endpoint, close)
        if latched is not None:
            self.latched = latched

    @final
    @property
    def refused(self) -> int:
        """How many messages came after it was closed; they were not delivered."""
        return 0 if self._gate is None else self._gate.refused

    @final
    @property
    def unreadable(self) -> int:
        """How many messages came that could not be read, as `Delivery.unreadable` said."""
        return 0 if self._gate is None else self._gate.unread

    @final
    @property
    def refusal(self) -> str:
        """Why the last message could not be read; empty where one was read since."""
        return "" if self._gate is None else self._gate.refusal

    @final
    def watch_refused(self, on_refused: Callable[[], object]) -> None:
        """Have messages reported that come after it was closed, in their threads; for the core."""
        if self._gate is not None:
            self._gate.on_refused = on_refused


class Sink(Channel):
    """A channel into a component.

    A subclass must override `_send` and `_close`.

    Args:
        endpoint: where it is open.
        send: hands one message to the component; see `_send`, for which it stands.
        close: lets go of the native link.
        blocking: the attribute.

    Attributes:
        blocking: whether sending may wait or compute. The manager calls a sink that does not
            block in the thread in which the message arrived; before any other it puts a
            bounded queue with one worker. True unless the bridge says otherwise.
        default_queue: that queue, where the configuration states none. A bridge whose framework
            promises that nothing is lost sets one with the policy `block`.
        parallel: whether `_send` may be called while another call of it is under way. Where it
            may, the stop of an input that moves something waits for no `_send` that hangs.
    """

    blocking: bool = True
    default_queue: QueuePolicy = QueuePolicy()
    parallel: bool = False
    _watchdog: Watchdog | None = None
    _exit_stops: ExitStops | None = None

    def __init__(
        self,
        endpoint: Endpoint,
        send: Callable[[Message], object] | None = None,
        close: Callable[[], object] | None = None,
        *,
        blocking: bool | None = None,
    ) -> None:
        super().__init__(endpoint, close)
        if send is None and not self._overrides("_send", Sink):
            text = f"{type(self).__name__}: pass a function `send`, or override `_send`"
            raise TypeError(text)
        self._send_given = send
        if blocking is not None:
            self.blocking = blocking

    @final
    def send(self, message: Message, age: float = 0.0) -> None:
        """Hand one message to the component. Called by one thread at a time.

        Args:
            message: the message.
            age: seconds since it left its sender; matters where the input moves something.

        Raises:
            MessageError: it does not fit the structure.
            CommandRefusedError: the input moves something, and may not be sent this now.
            BridgeError: the channel is closed, or the component is gone or refuses.
            Exception: what else the framework raises: the route that called counts it and
                shows it in the status.
        """
        if self._closed:
            text = f"bridge {self.endpoint.bridge!r}: {self.endpoint} is closed"
            raise BridgeError(text, FailureReason.CLOSED)
        if self._watchdog is None:
            self._send(message)
        else:
            self._watchdog.send(message, age)

    @final
    def guard(self, report_stop: Callable[[str], None], exit_stops: ExitStops) -> None:
        """Keep to the endpoint's command policy from now on; called once, by the core.

        Args:
            report_stop: called with why a stop message was not taken, and without when one was.
            exit_stops: what its bridge stops where the program ends without closing.
        """
        if self.endpoint.command is not None:
            name = f"{self.endpoint.component}.{self.endpoint.port}"
            self._watchdog = Watchdog(
                self.endpoint.command,
                self._send,
                name,
                parallel=self.parallel,
                report_stop=report_stop,
                report_first=lambda: self.stop_at_exit(exit_stops),
            )

    @final
    def stop_at_exit(self, exit_stops: ExitStops) -> None:
        """Have it stopped where the program ends without closing; for the core."""
        self._exit_stops = exit_stops
        exit_stops.add(self.begin_close, self._before_close)

    def hold(self, timeout: float) -> CommandStatus | None:
        """Send the stop message and refuse every command until `release`; for the core.

        Waits `timeout` seconds at most for the stop to be taken. Returns what came of it; None
        for an input that moves nothing.
        """
        return None if self._watchdog is None else self._watchdog.hold(timeout)

    def halt(self, timeout: float) -> CommandStatus | None:
        """Send the stop message where a command lives still; for the core.

        Waits `timeout` seconds at most for it to be taken. Commands that are sent afterwards pass.
        Returns what came of it; None for an input that moves nothing.
        """
        return None if self._watchdog is None else self._watchdog.halt(timeout)

    def begin_close(self) -> None:
        """Let no command through any more, and have what moves stopped; for the core.

        Waits for nothing: where several are closed, no stop waits for a component that hangs.
        """
        if self._watchdog is not None:
            self._watchdog.begin_close()

    def release(self) -> None:
        """Let commands through again; for the core."""
        if self._watchdog is not None:
            self._watchdog.release()

    def command_status(self) -> CommandStatus | None:
        """Return the last command of an input that moves something; None for any other."""
        return None if self._watchdog is None else self._watchdog.status()

    def watch(self, report: Outcomes) -> bool:
        """Have what becomes of messages reported after `send` has returned; say whether it will be.

        May be overridden, by a sink that hands messages to another thread or process. A component
        that raises is blamed for it: without this, by what `send` raises.
        """
        del report
        return False

    def _before_close(self) -> None:
        if self._exit_stops is not None:
            self._exit_stops.discard(self._before_close)
        if self._watchdog is not None and self._watchdog.close():
            self.drain(_LAST_SECONDS)  # the stop may be in a buffer, which would go with the link

    def _send(self, message: Message) -> None:
        """Hand one message to the component.

        Must be overridden where no function `send` was given. Must raise when the message was not
        taken: MessageError when it does not fit, BridgeError else. Must return at once where
        `blocking` is False, and in bounded time everywhere. Must not keep the message to change
        it. May be called while `_close` runs.
        """
        assert self._send_given is not None, "the constructor saw to that"
        self._send_given(message)


def put_away(
    channel: Channel | None,
    on_late: Callable[[Channel], object] | None = None,
    gate: Gate | None = None,
) -> None:
    """Close a channel that is not waited for any more, then report it."""
    if not isinstance(channel, Channel):
        return
    if gate is not None:
        channel._gate = gate  # noqa: SLF001 - one of these
    try:
        channel.close()
    except BridgeError as error:
        text = "a channel that came too late could not be closed"
        LimitedLog(_log).write(logging.WARNING, text, error)
    if on_late is not None:
        on_late(channel)


T = TypeVar("T")


class ReceiveQueue(Generic[T]):
    """What came and was not taken yet, and the one thread that takes it.

    The thread of the framework only appends, so that a receiver that is stuck holds up no other
    one. When it is full, the oldest are dropped and counted. The thread ends when it is closed, or
    with the `take` under way.

    Args:
        name: of the thread.
        take: takes one thing; raises nothing.
        most: how many may wait.
        most_size: sum of the sizes of what waits; None: any. The newest is always kept.
        size: of a thing.
        dropped: is called with each that is dropped, in the thread that puts; returns at once.
        wake: is called after each thing, and when the time has come that it returned; returns when
            it is to be called again, in seconds of `time.monotonic`, or None for never.

    Attributes:
        dropped: how many were.
    """

    def __init__(
        self,
        name: str,
        take: Callable[[T], object],
        most: int,
        *,
        most_size: int | None = None,
        size: Callable[[T], int] = lambda _: 0,
        dropped: Callable[[T], object] = lambda _: None,
        wake: Callable[[], float | None] = lambda: None,
    ) -> None:
        self._take, self._wake, self._when_dropped = take, wake, dropped
        self._most, self._most_size, self._size = most, most_size, size
        self._waiting: deque[T] = deque()
        self._waiting_size = 0
        # Guards what waits, its size and the two marks: the framework's thread appends, the queue's
        # own takes, and any thread may close. It is not held during `take` and `wake`.
        self._changed = threading.Condition()
        self._is_closed = self._poked = False
        self.dropped = 0
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def closed(self) -> bool:
        """Whether nothing more is taken."""
        return self._is_closed

    def put(self, thing: T) -> None:
        """Append a thing; returns at once."""
        with self._changed:
            if self._is_closed:
                return
            self._waiting.append(thing)
            self._waiting_size += self._size(thing)
            while len(self._waiting) > 1 and self._is_full():
                oldest = self._waiting.popleft()
                self._waiting_size -= self._size(oldest)
                self.dropped += 1
                self._when_dropped(oldest)
            self._changed.notify()

    def poke(self) -> None:
        """Have `wake` called: what it returned does not hold any more."""
        with self._changed:
            self._poked = True
            self._changed.notify()

    def close(self) -> None:
        """Take nothing more; does not wait for what is being taken."""
        with self._changed:
            self._is_closed = True
            self._waiting.clear()
            self._changed.notify()

    def _is_full(self) -> bool:
        is_large = self._most_size is not None and self._waiting_size > self._most_size
        return len(self._waiting) > self._most or is_large

    def _run(self) -> None:
        while not self.closed:
            due = self._wake()
            with self._changed:
                left = None  # for ever, as after infinitely many seconds, which no wait takes
                if due is not None and due < math.inf:
                    left = max(0.0, due - time.monotonic())
                self._changed.wait_for(
                    lambda: self._is_closed or self._waiting or self._poked, left
                )
                self._poked = False
                if self._is_closed or not self._waiting:
                    continue
                thing = self._waiting.popleft()
                self._waiting_size -= self._size(thing)
            self._take(thing)
