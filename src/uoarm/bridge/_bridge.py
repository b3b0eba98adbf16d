"""The bridge contract: public final methods around the raw steps of `_steps.py`."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import TypeVar, final

from uoarm._forks import forks
from uoarm._raised import foreign
from uoarm._support import deadlines
from uoarm._support.deadlines import BoundedStep
from uoarm.bridge._border import Delivery, Gate, translated
from uoarm.bridge._channel import Channel, NativeLink, Sink, Source, put_away
from uoarm.bridge._options import DeclaredOptions
from uoarm.bridge._services import CallsUnderWay, CallUnderWay
from uoarm.bridge._steps import (
    ANYTHING,
    BridgeSteps,
    Capabilities,
    Description,
    Discovered,
    Handler,
    HealthEvent,
    ServiceStructures,
)
from uoarm.bridge._watchdog import ExitStops
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import (
    Deliver,
    Endpoint,
    Health,
    Message,
    MessageStructure,
    Options,
    StatusMap,
    StopOutcome,
)

CONTRACT_VERSION = 2

T = TypeVar("T")
C = TypeVar("C", bound=Channel)
_GRACE_SECONDS = 0.25


class Bridge(BridgeSteps):
    """One framework, one version, one configuration.

    The public methods are final. They check the state, keep the time limit, translate foreign
    exceptions and remember what is open; a bridge supplies the steps that begin with `_`.
    Every public method may be called from any thread, several at a time, and so may every step:
    each runs in a thread of the core, or in that of the step which it is part of, or, where
    `_keeps_time` or `_is_quick` says so, in that of the caller.

    A step must end: one that takes longer than its limit is given up, and what it returns later
    is closed. It may raise anything, also what is no `Exception`; what is no UoarmError becomes a
    BridgeError with RAISED.

    Args:
        name: name of this instance in the configuration.
        options: what `BridgeType.bridge_options` makes of the configuration.

    Attributes:
        manager: identity of the manager that uses it, set before its first step; "": it has none.
        status: returns the status of that manager, from any thread; None where it has none, and in
            a host.
    """

    manager: str = ""
    status: Callable[[], StatusMap] | None = None

    capabilities: Capabilities = Capabilities()
    _is_last_hop = True
    """Whether the framework is talked to from this process, so that commands expire in it."""

    def __init__(self, name: str, options: Options | DeclaredOptions) -> None:
        self.name = name
        self.options = options
        # Guards the channels that are there and the ends of `close`, which it waits for.
        self._changing = threading.RLock()
        self._channels_changed = threading.Condition(self._changing)
        # Those that are being closed included: their stops need the framework.
        self._open: set[Channel] = set()
        self._is_closed = self._is_over = False
        self._closer: int | None = None  # the thread in which the framework is let go of
        self._process = forks.generation
        self._listener: Callable[[HealthEvent], None] | None = None
        # What was said last of the whole bridge before anything listened: a thread that it began
        # as it was made may have lost the framework by then. None after that.
        self._early: HealthEvent | None = None
        self._was_watched = False
        self._pending_calls = CallsUnderWay()
        self._exit_stops = ExitStops()

    @final
    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._is_closed

    @final
    @property
    def open_channels(self) -> int:
        """How many channels are open now."""
        return sum(not channel.closed for channel in tuple(self._open))

    @property
    def process_id(self) -> int | None:
        """The id of the process in which the framework's side runs; None on another machine."""
        return os.getpid()

    @final
    def is_quick(self, endpoint: Endpoint) -> bool:
        """Say whether an endpoint opens and closes in the thread that asks for it; for the core.

        One with a command policy does not: as it closes, its stop message may be sent.
        """
        if endpoint.command is not None or self._is_closed or forks.generation != self._process:
            return False
        try:
            return self._is_quick(endpoint)
        except BaseException:  # asked several times in each request: names itself when it fails
            with translated(BoundedStep(f"bridge {self.name!r}: looking at ", endpoint)):
                raise

    @final
    def describe(self, endpoint: Endpoint, *, timeout: float = 5.0) -> Description:
        """Return the message structures of an endpoint that is available now.

        Raises:
            BridgeError: it does not exist, is not available, or cannot be understood.
            BridgeTimeoutError: no answer within `timeout` seconds.
        """
        found = self._step(
            BoundedStep("describing ", endpoint), timeout, lambda: self._describe(endpoint)
        )
        self._require_structures("_describe", found)
        return found

    @final
    def discover(self, *, timeout: float = 5.0) -> tuple[Discovered, ...]:
        """Return the components that are visible now.

        Raises:
            BridgeError: the framework failed, or cannot list its components.
            BridgeTimeoutError: no answer within `timeout` seconds.
        """
        self._require(self.capabilities.discover, "discover components")
        return self._step("discovering components", timeout, self._discovered)

    @final
    def open_source(
        self,
        endpoint: Endpoint,
        structure: MessageStructure,
        deliver: Deliver | Delivery,
        *,
        timeout: float = 5.0,
        on_late: Callable[[Channel], object] | None = None,
    ) -> Source:
        """Open an output of a component; its messages go to `deliver`.

        `deliver` is called in the bridge's thread, for one channel one message at a time. None
        begins after `close` has returned, or after this has raised.

        Args:
            endpoint: of the output.
            structure: of its messages, as `describe` or the configuration gave it.
            deliver: takes the messages; where it is a `Delivery`, with whose they are, and what
                cannot be read.
            timeout: in seconds.
            on_late: called with a source that opened once this was given up, or the bridge had been
                closed: it is closed by then, and may have lost messages; for the core.

        Raises:
            BridgeError: the framework refused or failed; nothing stays open.
            BridgeTimeoutError: not open within `timeout` seconds; what opens later is closed.
        """
        gate = Gate(deliver)
        try:
            return self._opened(
                Source,
                BoundedStep("opening ", endpoint),
                timeout,
                partial(self._open_source, endpoint, structure, gate),
                gate,
                on_late,
                is_quick=self.is_quick(endpoint),
            )
        except BaseException:
            gate.shut()
            raise

    @final
    def open_sink(
        self, endpoint: Endpoint, structure: MessageStructure, *, timeout: float = 5.0
    ) -> Sink:
        """Open an input of a component; the endpoint's command policy is kept from then on.

        Raises:
            BridgeError: the framework refused or failed; nothing stays open.
            BridgeTimeoutError: not open within `timeout` seconds; what opens later is closed.
        """
        sink = self._opened(
            Sink,
            BoundedStep("opening ", endpoint),
            timeout,
            partial(self._open_sink, endpoint, structure),
            is_quick=self.is_quick(endpoint),
        )
        if endpoint.command is not None and not self._is_last_hop:
            sink.stop_at_exit(self._exit_stops)
        elif endpoint.command is not None:

            def report_stop(cause: str) -> None:
                health = Health.DEGRADED if cause else Health.OK
                self.report(health, cause or "its stop message was taken", channel=sink)

            sink.guard(report_stop, self._exit_stops)
        return sink

    @final
    def call(
        self,
        endpoint: Endpoint,
        message: Message,
        structures: ServiceStructures = ANYTHING,
        *,
        timeout: float = 10.0,
        number: int | None = None,
    ) -> Message:
        """Send one request to a service and return its reply.

        Args:
            endpoint: of the service.
            message: the request.
            structures: of request and reply, as `describe` or the configuration gave them.
            timeout: in seconds.
            number: by which `cancel_call` knows the call, of no other call of this bridge; for
                the core.

        Raises:
            BridgeError: the service failed or is gone, or the call was cancelled.
            BridgeTimeoutError: no reply within `timeout` seconds.
        """
        self._require(self.capabilities.call, "call services")

        call = CallUnderWay(number)

        def begin() -> Message:
            outer = self._pending_calls.begin(call)
            try:
                return self._call(endpoint, structures, message, timeout)
            finally:
                self._pending_calls.end(call, outer)

        try:
            return self._step(
                BoundedStep("calling ", endpoint),
                timeout,
                begin,
                on_give_up=lambda: self._pending_calls.cancel(call),
                keeps_time=lambda: self._keeps_time(endpoint),
                grace=_GRACE_SECONDS,  # a bridge that keeps the limit says what it waited for
            )
        except BridgeError as error:
            # What a framework says of a call that was cancelled is no failure of the service.
            if call.is_cancelled and error.reason is FailureReason.RAISED:
                raise BridgeError(str(error), FailureReason.REFUSED) from error
            raise

    @final
    def cancel_call(self, number: int) -> bool:
        """Cancel the call that was given this number, or is about to be; for the core.

        Does not wait for its end. One that has not begun never does. Returns whether the framework
        could be notified.
        """
        return self._pending_calls.cancel_number(number)

    @final
    def cancelling(self, cancel: Callable[[], object]) -> AbstractContextManager[None]:
        """Have `cancel` called when the call that runs in this thread is to end early.

        For `_call` of a bridge whose framework can cancel: for the length of a `with` block, while
        it waits for the reply. `cancel` is called when the call has timed out, an emergency stop
        ends it, or the bridge is closed, in another thread, or here at once; maybe twice. It must
        return in bounded time, and may return False where the framework could not be notified. The
        call then ends as the framework says.
        """
        return self._pending_calls.cancelling(cancel)

    @final
    def serve(
        self,
        endpoint: Endpoint,
        handler: Handler,
        structures: ServiceStructures = ANYTHING,
        *,
        timeout: float = 5.0,
    ) -> Channel:
        """Offer a service to the framework; requests go to `handler`, in the bridge's thread.

        The manager calls it for each service that the configuration offers in this framework.

        Raises:
            BridgeError: the framework refused or failed; nothing stays open.
            BridgeTimeoutError: not open within `timeout` seconds; what opens later is closed.
        """
        self._require(self.capabilities.serve, "serve")
        return self._opened(
            Channel,
            BoundedStep("serving ", endpoint),
            timeout,
            lambda: self._serve(endpoint, structures, lambda message: foreign(handler, message)),
        )

    @final
    def link(self, source: Endpoint, sink: Endpoint, *, timeout: float = 5.0) -> NativeLink | None:
        """Connect two endpoints of this bridge natively; None when these two cannot be.

        Raises:
            BridgeError: the framework refused or failed; nothing stays open.
            BridgeTimeoutError: not open within `timeout` seconds; what opens later is closed.
        """
        if not self.capabilities.link:
            return None
        step = f"linking {source} to {sink}"
        channel = self._step(step, timeout, lambda: self._link(source, sink), on_late=put_away)
        return None if channel is None else self._adopt(NativeLink, "_link", channel)

    @final
    def stop_all(self, *, release: bool = False, timeout: float = 2.0) -> tuple[StopOutcome, ...]:
        """Stop everything behind this bridge that moves, or let commands through again there.

        Args:
            release: whether to let through what was stopped.
            timeout: in seconds.

        Returns:
            What came of it at each input there; empty where this bridge may not.

        Raises:
            BridgeError: it could not be reached, or failed.
            BridgeTimeoutError: no answer within `timeout` seconds.
        """
        self._require(self.capabilities.stop, "stop what moves")
        what = "releasing" if release else "stopping everything"
        return tuple(self._step(what, timeout, lambda: self._stop_all(release, timeout)))

    @final
    def watch(self, listener: Callable[[HealthEvent], None] | None) -> None:
        """Have one listener called with health events; None ends it. It must not block.

        The first one is called at once where the bridge said before that it is not well.
        """
        self._listener, self._was_watched = listener, True
        early, self._early = self._early, None
        if listener is not None and early is not None and early.health is not Health.OK:
            listener(early)

    @final
    def close(self, *, timeout: float = 5.0) -> None:
        """Close every channel, then the bridge. Idempotent; does nothing in a forked child.

        Waits for what another thread is closing, no longer than that one does, nor `timeout`; from
        within what it closes it does not wait for that.

        Raises:
            BridgeError: something failed while closing; the rest was closed all the same.
        """
        if forks.generation != self._process:
            return  # in a child that was forked: it is its parent's
        with self._channels_changed:
            if self._is_closed:
                if self._closer != threading.get_ident() and self._closed_elsewhere() == self._open:
                    # The process may end after this: no stop must be on its way then.
                    self._wait_for(lambda: self._is_over, timeout)
                return
            self._is_closed = True
        try:
            self._close_all(timeout)
        finally:
            # What its framework does not end, such as a function of this process, goes on alone.
            self._pending_calls.abandon(_GRACE_SECONDS)
            self._exit_stops.close()
            with self._channels_changed:
                self._is_over = True
                self._channels_changed.notify_all()

    def _close_all(self, timeout: float) -> None:
        failures: list[BridgeError] = []
        channels = tuple(self._open)
        for channel in channels:
            if isinstance(channel, Sink):
                channel.begin_close()
        if self._pending_calls.close():
            step = f"bridge {self.name!r}: cancelling calls"
            try:
                with translated(step):
                    deadlines.run(step, timeout, self._pending_calls.cancel_all)
            except BridgeError as error:
                failures.append(error)
        for channel in channels:
            try:
                channel.close(timeout=timeout)
            except BridgeError as error:
                failures.append(error)
        with self._channels_changed:  # until the others that were being closed are
            others = self._closed_elsewhere()
            until = max((channel._closes_until for channel in others), default=0.0)  # noqa: SLF001 - its one owner
            limit = min(timeout, until - time.monotonic())
            self._wait_for(lambda: others.isdisjoint(self._open), limit)
        step = f"bridge {self.name!r}: closing"
        with translated(step):
            deadlines.run(step, timeout, self._close_native)
        if failures:
            raise failures[0]

    def _close_native(self) -> None:
        self._closer = threading.get_ident()
        self._close()

    def _closed_elsewhere(self) -> set[Channel]:
        """Return the channels that are not being closed by this thread."""
        this = threading.get_ident()
        return {channel for channel in self._open if channel._closer != this}  # noqa: SLF001 - its one owner

    @final
    def report_channel(
        self, channel: Channel, health: Health, cause: str, component: str | None = None
    ) -> None:
        """Report a change of a channel, as `report` does; for channels, which are given it."""
        self.report(health, cause, channel=channel, component=component)

    def report(
        self,
        health: Health,
        cause: str,
        *,
        channel: Channel | None = None,
        component: str | None = None,
        about: str = "",
    ) -> None:
        """Notify the manager of a change; for bridges, from any thread. Returns at once.

        What it is about: a `channel`, of a `NativeLink` its end at that `component`, or else its
        source; or a `component`, or what was judged of it, `about`; or the whole bridge. What is
        well covers up nothing else; of a link, only the component at the lost end is replaced.
        What the manager does:

        - DEGRADED: shows it with its cause. Connections go on. For a link that broke and is being
          made again, and for one that works badly.
        - OK: shows it. After DEGRADED, the end of it. Where nothing was open, the component is
          described again and may take over, or be returned to.
        - LOST: closes the channels of each component concerned, and replaces it in every
          connection, or ends the connection. It opens new channels when the component can be
          described again. When the whole bridge is lost, closes it; the next request makes
          a new instance.
        - FINISHED: lets what is under way arrive, drains, then ends connections. An orderly end.

        A service, of which nothing is open, is shown as reported until OK, or until one that was
        lost or finished answers: the next call describes it anew. A bridge that reconnects must
        report DEGRADED at once, and then OK when messages pass again, or LOST when it gives up. It
        must not report a lost channel as OK: that is closed. Where the last message of a source
        could not be read, the core adds why to what ails it.
        """
        refusal = channel.refusal if isinstance(channel, Source) else ""
        health = Health(health)
        if refusal and health in {Health.DEGRADED, Health.LOST} and refusal not in cause:
            cause = f"{cause}; the last message that came cannot be read: {refusal}"
        event = HealthEvent(self.name, health, cause, channel, component, about)
        if not self._was_watched and channel is None and component is None:
            self._early = event
        # After that: one that begins to listen just now finds it there, or is found here.
        listener = self._listener
        if listener is not None and not self._is_closed:
            listener(event)

    def facts(self) -> Mapping[str, object]:
        """Return what the bridge knows of its own work now, for the status.

        May be overridden. Must return at once, from any thread, after `close` too. Names are free,
        but `empty_turns` counts the turns of a loop of the bridge's own that ended before their
        time and found nothing to do, as `TurnCounter` does: many are processor time for nothing.
        """
        return {}

    def _step(
        self,
        what: str | BoundedStep,
        timeout: float,
        action: Callable[[], T],
        on_late: Callable[[T], None] | None = None,
        on_give_up: Callable[[], object] | None = None,
        *,
        keeps_time: Callable[[], bool] | None = None,
        grace: float = 0.0,
    ) -> T:
        if self._is_closed or forks.generation != self._process:
            why = "is closed" if self._is_closed else "belongs to the parent of this process"
            raise BridgeError(f"bridge {self.name!r} {why}: {what}", FailureReason.CLOSED)
        step = BoundedStep(f"bridge {self.name!r}: ", what)
        with translated(step):
            return deadlines.run(
                step,
                timeout,
                action,
                on_late=on_late,
                on_give_up=on_give_up,
                keeps_time=keeps_time is not None and keeps_time(),
                grace=grace,
            )

    def _opened(
        self,
        kind: type[C],
        what: str | BoundedStep,
        timeout: float,
        action: Callable[[], C],
        gate: Gate | None = None,
        on_late: Callable[[Channel], object] | None = None,
        *,
        is_quick: bool = False,
    ) -> C:
        if is_quick:  # which needs neither a limit nor a thread, and is never late
            try:
                channel = action()
            except BaseException:  # opened five times in a short request: named when it fails
                with translated(BoundedStep(f"bridge {self.name!r}: ", what)):
                    raise
        else:
            ends_late = partial(put_away, on_late=on_late, gate=gate)
            channel = self._step(what, timeout, action, on_late=ends_late)
        return self._adopt(kind, what, channel, on_late, gate, is_quick=is_quick)

    def _adopt(
        self,
        kind: type[C],
        what: str | BoundedStep,
        channel: C,
        on_late: Callable[[Channel], object] | None = None,
        gate: Gate | None = None,
        *,
        is_quick: bool = False,
    ) -> C:
        if not isinstance(channel, kind):
            raise self._broken(what, f"a {kind.__name__}", channel)
        channel._gate, channel._is_quick = gate, is_quick  # noqa: SLF001 - its one owner
        with self._changing:
            keep = not self._is_closed
            if keep:
                self._open.add(channel)
                channel._when_closed = self._forget  # noqa: SLF001 - a channel's one owner
        if not keep:
            put_away(channel, on_late)
            raise BridgeError(f"bridge {self.name!r} was closed: {what}", FailureReason.CLOSED)
        return channel

    def _wait_for(self, ready: Callable[[], bool], timeout: float) -> None:
        self._channels_changed.wait_for(ready, min(timeout, threading.TIMEOUT_MAX))

    def _forget(self, channel: Channel) -> None:
        with self._changing:
            self._open.discard(channel)
            if self._is_closed:  # only who closes the bridge waits
                self._channels_changed.notify_all()

    def _require(self, able: bool, what: str) -> None:  # noqa: FBT001
        if not able:
            text = f"bridge {self.name!r} cannot {what}"
            raise BridgeError(text, FailureReason.UNSUPPORTED)

    def _discovered(self) -> tuple[Discovered, ...]:
        found = tuple(self._discover())
        for component in found:
            if not isinstance(component, Discovered):
                raise self._broken("_discover", "each to be a Discovered", component)
            for _, description in component.endpoints:
                self._require_structures("_discover", description)
        return found

    def _require_structures(self, what: str, found: object) -> None:
        if not isinstance(found, Description):
            raise self._broken(what, "a Description", found)
        for part in (found.message, found.request, found.reply):
            if not isinstance(part, MessageStructure | None):
                raise self._broken(what, "a Description of MessageStructures", part)

    def _broken(self, what: str | BoundedStep, expected: str, got: object) -> BridgeError:
        text = (
            f"bridge {self.name!r} breaks the contract: {what} returned "
            f"{type(got).__name__}, expected {expected}"
        )
        return BridgeError(text, FailureReason.CONTRACT)
