"""Connections: the handle that an application holds on a running plan."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import final

from uoarm.errors import ConnectionClosedError, UsageError
from uoarm.flow import Inbox, QueueClosed, Route
from uoarm.manager._live import LiveComponent
from uoarm.manager._opening import OpenPlan
from uoarm.manager._sender import Sender
from uoarm.model import (
    ConnectionState,
    ConnectionStatus,
    Deliver,
    Gap,
    Message,
    Plan,
    QueuePolicy,
    RouteStatus,
)

__all__ = ["Connection"]

_ENDING = frozenset({ConnectionState.CLOSING, ConnectionState.CLOSED, ConnectionState.FAILED})


@final
class Connection:
    """A running plan. Iterate over it, `send` to it, and `kill` it; also a context manager.

    Made by `RobotManager.request`. All methods may be called from any thread.
    """

    def __init__(
        self,
        identity: str,
        opened: OpenPlan,
        queue: QueuePolicy,
        *,
        output: str | None = None,
        receive: Callable[[Plan, Deliver], Route] | None = None,
    ) -> None:
        self.id = identity
        self._opened = self._heard = opened
        self._output = output
        self._make_route = receive
        self._receive = self._route_from(opened)
        self._arrived = 0
        self._gaps: tuple[Gap, ...] = ()
        self._succession = threading.Lock()
        self._inbox = Inbox(queue, self._count_drop)
        self._tell: Callable[[Connection], None] | None = None
        self._state = ConnectionState.OPENING
        self._cause = ""
        self._open = threading.Event()
        self._lock = threading.Lock()

    @property
    def plan(self) -> Plan:
        """The plan that runs."""
        return self._opened.plan

    @property
    def state(self) -> ConnectionState:
        """Where in its life the connection is."""
        return self._state

    @property
    def cause(self) -> str:
        """Why the connection ended; empty while it runs and after `kill`."""
        return self._cause

    @property
    def output(self) -> str | None:
        """The output that the application receives, None where it receives none."""
        return self._output

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """The changes of providers so far, oldest first."""
        return self._gaps

    @property
    def ended(self) -> bool:
        """Whether the connection is closed, for whatever reason."""
        return self._state in {ConnectionState.CLOSED, ConnectionState.FAILED}

    def get(self, timeout: float | None = None) -> Message:
        """Return the next message, waiting `timeout` seconds at most (None: until it ends).

        Raises:
            TimeoutError: nothing came in time.
            ConnectionClosedError: the connection has ended and every message was read.
            UsageError: the function has no output, or callbacks receive its messages.
        """
        if self._receive is None:
            raise UsageError(f"function {self.plan.function!r} has no output to read")
        try:
            return self._inbox.get(timeout)
        except QueueClosed:
            text = f"connection {self.id} to {self.plan.function!r} has ended"
            raise ConnectionClosedError(f"{text}: {self._cause}" if self._cause else text) from None

    def __iter__(self) -> Iterator[Message]:
        """Yield messages until the connection is killed or its source finishes.

        Raises:
            ConnectionClosedError: a component died; the text says which and why.
        """
        while True:
            try:
                message = self.get()
            except ConnectionClosedError:
                if self._state is ConnectionState.FAILED:
                    raise
                return
            yield message

    def send(self, message: Message, port: str | None = None) -> None:
        """Hand one message to an input that the application feeds.

        It is taken over at once; a component that is slower has a queue before it, whose losses
        are counted in the status.

        Args:
            message: checked against the input's structure unless the connection was requested
                with validation off.
            port: name of the input; None where there is one only.

        Raises:
            MessageError: the message does not match the input's structure.
            UsageError: there is no such input for the application.
            ConnectionClosedError: the connection has ended.
        """
        if self._state is not ConnectionState.RUNNING:
            raise ConnectionClosedError(f"connection {self.id} has ended: {self._cause or 'kill'}")
        self._sender(port).send(message)

    def flush(self, timeout: float) -> bool:
        """Wait until the component has taken what was sent; False when time ran out.

        `kill` discards what a slower component has not taken yet; call this before it.
        """
        return all(sender.flush(timeout) for sender in tuple(self._opened.senders.values()))

    def subscribe(self, callback: Deliver) -> Callable[[], None]:
        """Give messages to a callback from now on, first those that wait; returns what ends it.

        The callback runs in the thread in which a message arrives. It may call `kill`.
        """
        if self._receive is None:
            raise UsageError(f"function {self.plan.function!r} has no output to read")
        return self._inbox.subscribe(callback)

    def kill(self) -> None:
        """End the connection and close what only it used. Once is enough; bounded in time."""
        self.end(ConnectionState.CLOSED, "")

    def open(self) -> None:
        """Open the plan; the manager's own step, called once.

        Raises:
            UoarmError: something could not be opened. Everything is closed again.
        """
        self._changed()
        try:
            self._opened.open(self._output, self._receive)
        except BaseException:
            self._opened.close()
            raise
        with self._lock:
            given_up = self._state is not ConnectionState.OPENING
            if not given_up:
                self._state = ConnectionState.RUNNING
        if given_up:
            self._opened.close()
            text = f"connection {self.id} ended while it was being opened"
            raise ConnectionClosedError(f"{text}: {self._cause or 'kill'}")
        self._open.set()
        self._changed()

    def successor(self, plan: Plan) -> OpenPlan:
        """Make what `succeed` takes: a plan to be opened as the application wished the first."""
        first = self._opened
        user = f"{self.id}#{len(self._gaps) + 2}"
        return OpenPlan(plan, user, first.pool, first.validate, first.clock)

    def succeed(self, opened: OpenPlan, gap: Callable[[int], Gap], *, is_dead: bool) -> None:
        """Go on with another plan behind the same handle; the manager's own step.

        Args:
            opened: the plan, not open yet.
            gap: makes the mark of the change, from the number of messages before it.
            is_dead: whether the plan so far is dead: the application then hears the new one
                from its first message on, and else from when it is wholly open.

        Raises:
            UoarmError: something could not be opened, or the connection has ended. What was
                opened is closed again; the plan so far still stands.
        """
        with self._succession:
            if is_dead:
                self._heard = opened
            route = self._route_from(opened)
            try:
                opened.open(self._output, route)
            except BaseException:
                opened.close()
                raise
            with self._lock:
                given_up = self._state is not ConnectionState.RUNNING
                if not given_up:
                    before, self._opened, self._receive = self._opened, opened, route
                    self._gaps = (*self._gaps, gap(self._arrived))
                    self._heard = opened
            if given_up:
                opened.close()
                raise ConnectionClosedError(f"connection {self.id} has ended: {self._cause}")
            before.close()

    def end(self, state: ConnectionState, cause: str) -> None:
        """End with a state and a cause; the manager's own way to do it."""
        with self._lock:
            if self._state in _ENDING:
                return
            self._state = ConnectionState.CLOSING
            self._cause = cause
        self._open.set()
        try:
            self._opened.close()
        finally:
            self._state = state
            self._changed()  # before the reader hears of the end, so that its status agrees
            self._inbox.close(discard=state is ConnectionState.CLOSED and not cause)

    def on_change(self, tell: Callable[[Connection], None]) -> None:
        """Have the manager told of every change of state."""
        self._tell = tell

    def on_wake(self, wake: Callable[[], None] | None) -> None:
        """Have `wake` called when a message or the end can be read; for event loops."""
        self._inbox.on_wake(wake)

    def uses(self, live: LiveComponent) -> bool:
        """Say whether the connection depends on an open component."""
        return self._opened.uses(live)

    def drain(self, timeout: float) -> None:
        """Wait until what is under way has reached the application.

        Waits `timeout` seconds at most for the opening, and as long for each queue.
        """
        self._open.wait(timeout)
        order = {step.component.name: n for n, step in enumerate(self.plan.steps)}
        for joined in sorted(self._opened.edges, key=lambda one: order[one.edge.producer]):
            if joined.route is not None:
                joined.route.drain(timeout)
                self._opened.component(joined.edge.consumer).drain(timeout)

    def status(self) -> ConnectionStatus:
        """Return what the status map shows."""
        return ConnectionStatus(
            id=self.id,
            function=self.plan.function,
            state=self._state,
            components=tuple(step.component.name for step in self.plan.steps),
            cause=self._cause,
        )

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of the routes that belong to this connection alone."""
        received = () if self._receive is None else (self._receive.status(),)
        return (*received, *(sender.status() for sender in self._opened.senders.values()))

    def __enter__(self) -> Connection:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.kill()

    def _route_from(self, opened: OpenPlan) -> Route | None:
        """Make the route of the messages of a plan; those of a plan not heard are dropped."""
        if self._make_route is None:
            return None

        def arrive(message: Message) -> None:
            if opened is self._heard:
                self._arrived += 1
                self._inbox.put(message)
            else:
                route.take_back("replaced")

        route = self._make_route(opened.plan, arrive)
        return route

    def _count_drop(self, reason: str) -> None:
        if self._receive is not None:
            self._receive.take_back(reason)

    def _changed(self) -> None:
        if self._tell is not None:
            self._tell(self)

    def _sender(self, port: str | None) -> Sender:
        senders = self._opened.senders
        if port is None and len(senders) == 1:
            return next(iter(senders.values()))
        sender = senders.get(port or "default")
        if sender is None:
            has = f"it has {', '.join(senders)}" if senders else "it has none"
            raise UsageError(
                f"function {self.plan.function!r} has no input {port or 'default'!r} for the "
                f"application: {has}"
            )
        return sender
