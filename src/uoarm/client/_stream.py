"""One open function of a robot elsewhere: its messages, and the way to send to it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, suppress
from functools import partial
from typing import Any, Generic, cast, final

from typing_extensions import Self

from uoarm._arguments import arguments
from uoarm._dataplane import BoundedQueue
from uoarm._hints.applications import MessageType, T, as_message
from uoarm._renewal import HeldCommand, renewal_period, renewed_in_task
from uoarm._support.aio_deadlines import event_by
from uoarm.bridge import boot_seconds
from uoarm.errors import ConnectionClosedError, UsageError
from uoarm.model import Message, QueuePolicy

Ask = Callable[..., Awaitable[Any]]


@final
class RemoteStream(Generic[T]):
    """What `Client.request` returns: `async for`, `await get()`, `send`, `kill`, `async with`.

    Attributes:
        connection: its name at the server, shared with other clients of the same function.
        inputs: inputs that `send` can feed.
        output: what `get` reads; None where there is nothing to read.
        lifetimes: seconds for which a command lives, by input; of those that have one.
        latched: whether who comes gets first what its output gave last.
        lost: messages that did not get here, as gaps in their numbers, or were not read in time.
        gaps: how often the server began anew meanwhile, so that it is not known what was lost.
        state: `open`; or how it ended: `closed`, `finished` or `failed`.
        cause: why it ended; empty while it is open, and where this client gave it back.
        trouble: what kept messages from coming when `get` last ran out of time, as its
            TimeoutError says it; empty from the next message on.
        request: what opened it, and opens it again.
    """

    def __init__(
        self,
        opened: Mapping[str, Any],
        request: Mapping[str, Any],
        ask: Ask,
        diagnosis: Callable[[str], Awaitable[tuple[str, ...]]],
        queue: QueuePolicy,
    ) -> None:
        self.request = request
        self._diagnose = diagnosis
        self.lost = 0
        self.gaps = 0
        self.state = "open"
        self.cause = ""
        self.trouble: tuple[str, ...] = ()
        self._is_away = False
        self._refusal = ""
        self._describe(opened)
        self._ask = ask
        self._waiting = self._queue(queue)
        self._changed = asyncio.Event()
        self._type: MessageType[T] | None = None
        self._take: Callable[[Message], object] | None = None
        self._on_end: Callable[[], object] | None = None
        self._on_renewal: Callable[[], object] = bool

    def _describe(self, opened: Mapping[str, Any]) -> None:
        self.connection: str = opened["connection"]
        self.inputs: tuple[str, ...] = tuple(opened["inputs"])
        self.output: str | None = opened.get("output", "")  # "": the server is older, and says none
        self.warnings: tuple[str, ...] = tuple(opened["warnings"])
        self.lifetimes: Mapping[str, float] = opened.get("lifetimes", {})
        self.latched: bool = opened.get("latched", False)
        # The number of the last message that came or is lost; None: the next one says it.
        self._last: int | None = opened.get("number")

    @property
    def ended(self) -> bool:
        """Whether no more messages come."""
        return self.state != "open"

    @property
    def is_away(self) -> bool:
        """Whether its server has begun anew and has not opened it again yet."""
        return self._is_away

    def renew(self, opened: Mapping[str, Any]) -> None:
        """Go on as another connection, of a server that has begun anew; `RemoteRobot` does it."""
        self._describe(opened)
        self._is_away = False
        self.gaps += 1
        self._on_renewal()

    def suspend(self) -> None:
        """Send nothing until `renew`: its name may be another connection's by then."""
        self._is_away = True

    def give_as(self, wanted: MessageType[T] | None, queue: QueuePolicy | None) -> None:
        """Give messages as a type, of another queue, from now on; `RemoteRobot.request` does it."""
        self._type = wanted
        if queue is not None:
            waiting, self._waiting = self._waiting, self._queue(queue)
            while waiting:
                self._waiting.put(waiting.get(0))

    def _queue(self, policy: QueuePolicy) -> BoundedQueue[Message]:
        return BoundedQueue(policy, self._count_lost)

    def _count_lost(self, reason: str) -> None:
        del reason
        self.lost += 1

    @arguments()
    async def get(self, timeout: float | None = None) -> T:
        """Return the next message, waiting `timeout` seconds at most (None: until it ends).

        Raises:
            TimeoutError: nothing came in time; the text says which component is not well, and
                why the last message was refused, where the server says so within a second.
            ConnectionClosedError: the function has ended and every message was read.
            MessageError: a component gave something else than it had declared, so that no value
                of `as_type` could be made. The next call goes on with the next message.
            UsageError: the function has no output, or it was asked for to send only.
        """
        if self.output is None:
            raise UsageError(f"function {self.request['type']!r} has no output to read")
        loop = asyncio.get_running_loop()
        deadline = None if timeout is None else loop.time() + timeout
        while not self._waiting:
            if self.ended:
                text = f"connection {self.connection} is {self.state}: {self.cause}"
                raise ConnectionClosedError(text)
            if deadline is not None and loop.time() >= deadline:
                trouble = () if not timeout else await self._diagnose(self.connection)
                if self._refusal:
                    text = f"the server could not send the last message: {self._refusal}"
                    trouble = (*trouble, text)
                if self._waiting or self.ended:  # meanwhile
                    continue
                self.trouble = trouble
                raise TimeoutError("; ".join((f"no message within {timeout:g} s", *trouble)))
            self._changed.clear()
            await event_by(self._changed, deadline)
        self.trouble = ()
        message = self._waiting.get(0)
        return cast("T", message) if self._type is None else self._type.read(message)

    def settle(self, number: int) -> None:
        """Count what is missing up to a message, of which none will come any more."""
        if self._last is not None and number > self._last:
            self.lost += number - self._last
            self._refusal = ""  # it was of one of these
        self._last = number

    def hand_over(
        self,
        take: Callable[[Message], object],
        ended: Callable[[], object],
        renewed: Callable[[], object] = bool,
    ) -> None:
        """Have each message taken as it comes, in the loop, in place of `get`; plain values.

        Args:
            take: gets first what waits. Returns at once, and raises nothing.
            ended: called once when no more will come.
            renewed: called when a server that began anew has opened it again, before its messages.
        """
        while self._waiting:
            take(self._waiting.get(0))
        self._take, self._on_end, self._on_renewal = take, ended, renewed
        if self.ended:
            ended()

    @arguments()
    async def send(
        self, message: Message, port: str | None = None, *, take_over: bool = False
    ) -> None:
        """Hand one message to an input; returns when the server has taken it.

        Args:
            message: plain values or objects, as `Connection.send` takes them.
            port: name of the input; None where there is one only.
            take_over: whether to take the lease from a holder of the same priority.

        Raises:
            CommandRefusedError: the emergency stop holds the input, or another client its lease.
            MessageError: it does not match the input's structure.
            UsageError: there is no such input.
            ConnectionClosedError: the function has ended.
        """
        kind, fields = self.question(message, port)
        more: dict[str, Any] = {"x-take-over": True} if take_over else {}
        await self._ask("Data", kind, **fields, **more)

    def question(self, message: Message, port: str | None = None) -> tuple[str, dict[str, Any]]:
        """Return what `send` asks the server, its `type` and further fields; in any thread.

        Raises:
            MessageError: an object in the message holds something else than its own hints say.
            ConnectionClosedError: the server has begun anew, and has not opened it again yet.
        """
        kind = self._there(port)
        fields: dict[str, Any] = {"jsonMessage": as_message(message, kind)}
        if self.lifetimes:  # one that comes too late is refused there
            fields["x-sent"] = boot_seconds()
        return kind, fields

    @arguments()
    async def stop(self, port: str | None = None) -> None:
        """Have the stop message of an input sent, and give its lease back.

        What was sent before and waits is discarded; the next command moves it again.

        Raises:
            BridgeError: the framework has not taken the stop message, which goes on being sent.
            UsageError: there is no such input, or it has no stop message.
            ConnectionClosedError: the function has ended, and was stopped with that.
        """
        await self._ask("Stop", self._there(port))

    @arguments()
    def hold(
        self,
        message: Message,
        port: str | None = None,
        *,
        period: float | None = None,
        take_over: bool = False,
    ) -> AbstractAsyncContextManager[HeldCommand]:
        """Renew a command for the length of an `async with` block, and stop at its end.

        Gives a `HeldCommand`, whose `message` may be replaced meanwhile and whose `error` says why
        it is not renewed any more; that is raised at the end of the block. While the link is down,
        that end waits until the server has the stop, or the client gives it up: half a minute, and
        `reconnect` seconds. By then the lifetime has long stopped what moves.

        Args:
            message: the command.
            port: name of the input; None where there is one only.
            period: seconds between two renewals; None: a quarter of the lifetime. One that is no
                shorter than the lifetime is warned of.
            take_over: whether to take the lease from a holder of the same priority at first.

        Raises:
            UoarmError: as `send`, from the first command on, and as `stop`.
        """
        taking = [take_over]

        async def send(command: Message) -> None:
            await self.send(command, port, take_over=taking[0])
            taking[0] = False  # who was taken over from does not take it back by itself

        name = port or (self.inputs[0] if len(self.inputs) == 1 else "default")
        seconds = renewal_period(self.lifetimes.get(name), period, self._kind(port))
        return renewed_in_task(message, send, partial(self.stop, port), seconds)

    async def kill(self) -> None:
        """Give the function back. Once is enough."""
        if not self.ended:
            self.finish("closed", "")
            if self._is_away:
                return
            with suppress(ConnectionClosedError):  # then it has ended at the server, too
                await self._ask("Kill", self.connection)

    def _there(self, port: str | None) -> str:
        if self._is_away:
            text = f"the server of {self.connection} has gone, and has not opened it again yet"
            raise ConnectionClosedError(f"{text}: nothing was sent")
        return self._kind(port)

    def _kind(self, port: str | None) -> str:
        return self.connection if port is None else f"{self.connection}.{port}"

    def take(self, number: int | None, message: Message) -> None:
        """Take one message from the client's reader; without a number, one that stood already."""
        if number is not None:
            self.settle(number - 1)
            self._last = number
        if self._take is not None:
            self._take(message)
            return
        self._waiting.put(message)
        self._changed.set()

    def refuse(self, why: str) -> None:
        """Take in that the server had a message that it could not write."""
        self._refusal = why

    def finish(self, state: str, cause: str, number: int | None = None) -> None:
        """Take in that no more will come, and the number of the last message, where it is known."""
        if not self.ended:
            if number is not None:
                self.settle(number)
            self.state, self.cause = state, cause
            if self._on_end is not None:
                self._on_end()
        self._changed.set()

    async def __aiter__(self) -> AsyncIterator[T]:
        """Yield messages until the function is killed or its source finishes; see `cause`.

        Raises:
            ConnectionClosedError: it failed; the text says why.
        """
        while True:
            try:
                message = await self.get()
            except ConnectionClosedError:
                if self.state == "failed":
                    raise
                return
            yield message

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.kill()
