"""Connections: the handle that an application holds on a running plan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import Generic, cast, final

from attrs import asdict
from typing_extensions import Self

from uoarm._arguments import arguments
from uoarm._control.engine.state import ConnectionRecord
from uoarm._control.live.connection_runtime import ConnectionRuntime
from uoarm._control.live.driver import Driver
from uoarm._dataplane import QueueClosed
from uoarm._hints.applications import MessageType, T, as_message
from uoarm._interrupts import put_off
from uoarm._parts import ApplicationPorts
from uoarm._renewal import HeldCommand, renewal_period, renewed
from uoarm._spans import span
from uoarm.errors import ConnectionClosedError, UsageError
from uoarm.model import (
    ConnectionState,
    ConnectionStatus,
    Gap,
    LeaseHolder,
    Message,
    Plan,
    RouteStatus,
    StatusMap,
    find_trouble,
)


@final
class Connection(Generic[T]):
    """A running plan. Iterate over it, `send` to it, and `kill` it; also a context manager.

    Made by `RobotManager.request`. All methods may be called from any thread. `Connection[Scan]`
    gives its messages as `Scan`, which `request` was given as `as_type`.
    """

    def __init__(
        self, runtime: ConnectionRuntime, driver: Driver, as_type: MessageType[T] | None = None
    ) -> None:
        self.id = runtime.id
        self._runtime = runtime
        self._receiver = runtime.receiver  # the server looks at its outlet for each message
        self._driver = driver
        self._type = as_type
        runtime.handle = self

    @property
    def plan(self) -> Plan:
        """The plan that runs."""
        return self._record.placement.plan

    @property
    def state(self) -> ConnectionState:
        """Where in its life the connection is."""
        return self._record.state

    @property
    def cause(self) -> str:
        """Why the connection ended, or for what it waits; empty while it runs and after `kill`."""
        return self._record.cause

    @property
    def output(self) -> str | None:
        """The output that the application receives, None where it receives none."""
        return self._record.output

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """The changes of plan so far, oldest first, the newest thousand of them."""
        return self._runtime.losses.gaps

    @property
    def ended(self) -> bool:
        """Whether the connection is closed, for whatever reason."""
        return self._record.state.is_over

    @arguments(timeout="connection.get(timeout=5.0) waits five seconds")
    def get(self, timeout: float | None = None) -> T:
        """Return the next message, waiting `timeout` seconds at most (None: until it ends).

        Raises:
            TimeoutError: nothing came in time; the text says which component is not well, and
                why the last message was refused.
            MessageError: a component gave something else than it had declared, so that no value
                of `as_type` could be made. The next call goes on with the next message.
            ConnectionClosedError: the connection has ended and every message was read.
            UsageError: the function has no output, or callbacks receive its messages.
        """
        if self.output is None:
            raise UsageError(f"function {self.plan.function!r} has no output to read")
        self._require_own()
        try:
            message = self._receiver.inbox.get(timeout)
        except TimeoutError as error:
            if not timeout:  # a look whether there is one
                raise
            raise TimeoutError(f"{error}{self._trouble()}") from None
        except QueueClosed:
            text = f"connection {self.id} to {self.plan.function!r} has ended"
            raise ConnectionClosedError(f"{text}: {self.cause}" if self.cause else text) from None
        return cast("T", message) if self._type is None else self._type.read(message)

    def __iter__(self) -> Iterator[T]:
        """Yield messages until the connection is killed or its source finishes.

        Raises:
            MessageError: as from `get`; iterate again to go on.
            ConnectionClosedError: a component died; the text says which and why.
        """
        while True:
            try:
                message = self.get()
            except ConnectionClosedError:
                self._require_own()
                if self.state is ConnectionState.FAILED:
                    raise
                return
            yield message

    @arguments()
    def send(
        self,
        message: Message,
        port: str | None = None,
        *,
        sender: LeaseHolder | None = None,
        take_over: bool = False,
    ) -> None:
        """Hand one message to an input that the application feeds.

        It is taken over at once; a component that is slower has a queue before it, whose losses
        are counted in the status.

        Args:
            message: plain values, or objects of dataclasses, attrs classes, pydantic models and
                the like, also within lists and dicts; checked against the input's structure
                unless the connection was requested with validation off.
            port: name of the input; None where there is one only.
            sender: who sends it, where the input has a lease; None: this connection.
            take_over: whether to take the lease from a holder of the same priority.

        Raises:
            CommandRefusedError: the emergency stop holds the input, until it is released, or
                another client its lease. What else the last hop refuses is counted in the status.
            MessageError: the message does not match the input's structure, or has no form in the
                framework.
            BridgeError: the component took it at once and failed, or the framework takes none.
                Where a queue or a host is between, what becomes of it is in the status.
            UsageError: there is no such input for the application.
            ConnectionClosedError: the connection has ended.
        """
        self._send(message, port, self._as(sender), take_over=take_over)

    def _send(
        self,
        message: Message,
        port: str | None,
        sender: LeaseHolder,
        *,
        take_over: bool,
        sent: float | None = None,
    ) -> None:
        """As `send`; where it left its sender before, `sent` says when, by `boot_seconds`."""
        way = self._ports().sender(port)
        way.send(as_message(message, way.place), sender, take_over=take_over, sent=sent)

    @arguments()
    def stop(
        self,
        port: str | None = None,
        *,
        sender: LeaseHolder | None = None,
        timeout: float = 2.0,
    ) -> None:
        """Send the stop message of an input that moves something, and give its lease back.

        Commands that were sent before and wait in a queue are discarded; those after it pass. Does
        nothing where another client holds the lease, or nothing was sent. Blocks for `timeout`
        seconds at most.

        Args:
            port: name of the input; None where there is one only.
            sender: who stops; None: this connection.
            timeout: seconds in which the framework is waited for.

        Raises:
            BridgeError: the framework has not taken the stop message, which goes on being sent.
            UsageError: there is no such input, or it has no stop message.
            ConnectionClosedError: the connection has ended, and was stopped with that.
        """
        way = self._ports().sender(port)
        if not way.can_stop:
            raise UsageError(f"{way.place} has no stop message in the configuration")
        way.stop(self._as(sender), timeout)

    @arguments()
    def hold(
        self,
        message: Message,
        port: str | None = None,
        *,
        period: float | None = None,
        sender: LeaseHolder | None = None,
        take_over: bool = False,
    ) -> AbstractContextManager[HeldCommand]:
        """Renew a command for the length of a `with` block, and stop at its end.

        Gives a `HeldCommand`, whose `message` may be replaced meanwhile and whose `error` says why
        it is not renewed any more; that is raised at the end of the block.

        Args:
            message: as `send` takes it.
            port: name of the input; None where there is one only.
            period: seconds between two renewals; None: a quarter of the lifetime. One that is no
                shorter than the lifetime is warned of.
            sender: who sends it, where the input has a lease; None: this connection.
            take_over: whether to take the lease from a holder of the same priority at first.

        Raises:
            UoarmError: as `send`, from the first command on, and as `stop`.
        """
        way = self._ports().sender(port)
        seconds = renewal_period(way.lifetime, period, way.place)
        taking = [take_over]

        def send(command: Message) -> None:
            self.send(command, port, sender=sender, take_over=taking[0])
            taking[0] = False  # who was taken over from does not take it back by itself

        return renewed(message, send, partial(self.stop, port, sender=sender), seconds)

    @arguments()
    def leave(self, sender: LeaseHolder) -> None:
        """Give back what leases a sender holds, and stop what it moves with them. Never raises."""
        ports = self._runtime.ports
        if ports is not None:
            ports.leave(sender)

    def lifetimes(self) -> Mapping[str, float]:
        """Return for how many seconds a command lives, by input; those without one are left out."""
        ports = self._runtime.ports
        return {} if ports is None else ports.lifetimes()

    @arguments()
    def flush(self, timeout: float) -> bool:
        """Wait until the component has taken what was sent, `timeout` seconds at most an input.

        `kill` discards what a slower component has not taken yet; call this before it.

        Returns:
            False when time ran out, or when a message since the last flush was refused or
            raised something, whose text `status` has. What a queue dropped for newer messages
            does not matter; for a component in a host it is the link that has taken it.
        """
        self._require_own()
        ports = self._runtime.ports
        return ports is None or ports.flush(timeout)

    @arguments()
    def subscribe(self, callback: Callable[[T], None]) -> Callable[[], None]:
        """Give messages to a callback from now on, first those that wait; returns what ends it.

        The callback runs in the thread in which a message arrives. It may call `kill`. A message
        that is under way may still come after the end. One of which no value of `as_type` can be
        made is logged and counted as failed.
        """
        if self.output is None:
            raise UsageError(f"function {self.plan.function!r} has no output to read")
        self._require_own()
        take = callback if self._type is None else self._type.callback(callback)
        return self._receiver.inbox.subscribe(take)

    def kill(self) -> None:
        """End the connection and close what only it used. Once is enough; bounded in time.

        In a child that was forked it does nothing: the connection is the parent's. In a finalizer
        that the garbage collector runs it only begins.
        """
        self._kill()

    def _kill(self, cause: str = "") -> None:
        """As `kill`; the cause says who did it, where that is not the application."""
        if put_off(partial(self._kill, cause)):
            return
        with span("kill", self._runtime.context, connection=self.id, cause=cause):
            self._driver.kill(self.id, cause)

    @property
    def _is_killed(self) -> bool:
        return self._record.is_killed

    def close(self) -> None:
        """End the connection: another name for `kill`, the word of the paper."""
        self.kill()

    def _trouble(self) -> str:
        """Say what keeps messages from coming, as far as it is known; for the end of a sentence."""
        live = self._driver.live
        status = StatusMap(
            components=live.statuses(),
            connections=(self.status(),),
            routes=(*live.routes(), *self.routes()),
        )
        return "".join(f"; {cause}" for cause in find_trouble(asdict(status), self.id))

    def _on_wake(self, wake: Callable[[], None] | None) -> None:
        """Have `wake` called when a message or the end can be read; for event loops."""
        self._receiver.inbox.on_wake(wake)

    def status(self) -> ConnectionStatus:
        """Return what the status map shows."""
        record = self._record
        return ConnectionStatus(
            id=self.id,
            function=record.placement.plan.function,
            state=record.state,
            components=record.components,
            cause=record.cause,
            lost=self._runtime.losses.lost,
            ended=self._runtime.losses.ended,
        )

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of the routes that belong to this connection alone."""
        return self._runtime.routes()

    def _require_own(self) -> None:
        self._driver.require_own(f"connection {self.id}")

    def _ports(self) -> ApplicationPorts:
        self._require_own()
        ports = self._runtime.ports
        if not self._record.is_active or ports is None:
            raise ConnectionClosedError(f"connection {self.id} has ended: {self.cause or 'kill'}")
        return ports

    def _as(self, sender: LeaseHolder | None) -> LeaseHolder:
        return sender or LeaseHolder(f"connection {self.id}")

    @property
    def _record(self) -> ConnectionRecord:
        record = self._runtime.record
        assert record is not None, "a handle is given once there is a plan"
        return record

    def __repr__(self) -> str:
        components = " -> ".join(self.plan.names)
        return f"<Connection {self.id} to {self.plan.function!r}: {self.state.value}, {components}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
