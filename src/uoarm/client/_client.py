"""The client: one WebSocket, answers by id, messages by connection."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from typing import Any, TypeAlias, final, overload

from attrs import fields_dict, frozen
from typing_extensions import Self

from uoarm import errors
from uoarm._arguments import arguments
from uoarm._hints.applications import MessageType, T, as_message
from uoarm._support.aio_deadlines import result_within
from uoarm._wire import Form
from uoarm.bridge import boot_seconds
from uoarm.client._link import CONNECTING_ERRORS, Link, Open
from uoarm.client._requests import (
    NOTICES,
    ServerQuestions,
    ThreadAnswer,
    checked,
    checked_answer,
    error_of,
    merged_status,
)
from uoarm.client._stream import RemoteStream
from uoarm.model import Message, QueuePolicy, StatusEvent, ValidationMode, find_trouble

_HELD = 1024
_DIAGNOSIS_SECONDS = 1.0
_EVENT = fields_dict(StatusEvent)
# What may be asked once more where a drop took the question or its answer.
_REPEATABLE = frozenset({"Kill", "List", "Resolve"})
_FIRST = "Stop"  # it waits for nothing that was sent before
_Changes: TypeAlias = "asyncio.Queue[StatusEvent | None]"


@frozen(eq=False)
class _PendingRequest:
    """What waits for an answer; `renewed` is the stream that a Request opens again, if it does."""

    fields: Mapping[str, Any]
    answer: asyncio.Future[Any] | ThreadAnswer
    renewed: RemoteStream[Any] | None = None


@final
class RemoteRobot(ServerQuestions):
    """A robot elsewhere. Made by `connect`; methods are for the loop in which it was made."""

    def __init__(
        self,
        opening: Open,
        form: Form,
        reconnect: float = 0.0,
        on_link: Callable[[str], object] = str,
        answer: float = 120.0,
        place: str = "the server",
    ) -> None:
        self._opening = opening
        self._answer_seconds = answer
        self.hello: Mapping[str, Any] = {}
        self._form = form
        self._link = Link(
            opening,
            form,
            self._take,
            reconnect,
            self._lose,
            self._open_again,
            self._settle,
            on_link,
        )
        self._link.place = place
        self._ended = asyncio.Event()
        self._ids = itertools.count(1)
        self._asked: dict[str, _PendingRequest] = {}
        self._streams: dict[str, RemoteStream[Any]] = {}
        self._watchers: set[_Changes] = set()
        self._status: Mapping[str, Any] = {}
        # Streams of a session that is gone, until this one has opened them again.
        self._away: set[RemoteStream[Any]] = set()
        self._renewing: set[asyncio.Task[None]] = set()
        # What threads asked and the loop has to send, since the socket did not take it at once.
        self._sending: dict[str, asyncio.Task[None]] = {}
        # Requests that were given up before their answer: what they open is given back.
        self._abandoned: set[str] = set()

    @property
    def restarts(self) -> int:
        """How often the session was gone and a new one was begun, as `reconnect` says."""
        return self._link.session

    @property
    def resumed(self) -> int:
        """How often the connection dropped and the session went on over another."""
        return self._link.resumed

    @overload
    async def request(
        self,
        name: str,
        *,
        as_type: type[T],
        validate: ValidationMode | str = ...,
        queue: QueuePolicy | None = None,
        every: float = 0.0,
        receive: bool = True,
        wait: float = 0.0,
    ) -> RemoteStream[T]: ...

    @overload
    async def request(
        self,
        name: str,
        *,
        as_type: object = None,
        validate: ValidationMode | str = ...,
        queue: QueuePolicy | None = None,
        every: float = 0.0,
        receive: bool = True,
        wait: float = 0.0,
    ) -> RemoteStream: ...

    @arguments()
    async def request(
        self,
        name: str,
        *,
        as_type: Any = None,
        validate: ValidationMode | str = ValidationMode.SAMPLED,
        queue: QueuePolicy | None = None,
        every: float = 0.0,
        receive: bool = True,
        wait: float = 0.0,
    ) -> RemoteStream[Any]:
        """Open a function.

        Args:
            name: function, or function.output.
            as_type: the type in which messages are wanted, as with `RobotManager.request`; the
                server is asked for the plan first, to prove that every message is one.
            validate: how many messages of outputs the server checks.
            queue: for messages that are read too slowly, of this client and of the server; None:
                the newest 1,024 here, up to 64 MiB.
            every: least seconds between two messages.
            receive: False to send only.
            wait: seconds to wait, at the server, for a function that is unavailable, such as a
                topic without a publisher; 0: that is an error.

        Raises:
            ResolutionError: nothing fits.
            BridgeTimeoutError: it stayed unavailable for `wait` seconds.
            BridgeError: a bridge failed while opening.
            UsageError: this client has it open already, or a message may be no `as_type`.
            ServerError: the role does not allow it, or a limit is reached.
        """
        options: dict[str, Any] = {"validate": ValidationMode(validate).value, "receive": receive}
        if queue is not None:
            options["queue"] = {"length": queue.length, "policy": queue.policy.value}
        if every:
            options["every"] = every
        if wait:
            options["wait"] = wait
        wanted = await self._typed(as_type, name, f"function {name!r}", "output.")
        stream: RemoteStream[Any] = await self.ask("Request", name, jsonMessage=options)
        stream.give_as(wanted, queue)
        return stream

    @overload
    async def call(
        self, name: str, message: Message, *, as_type: type[T], timeout: float = 10.0
    ) -> T: ...

    @overload
    async def call(
        self, name: str, message: Message, *, as_type: object = None, timeout: float = 10.0
    ) -> Message: ...

    @arguments()
    async def call(
        self, name: str, message: Message, *, as_type: Any = None, timeout: float = 10.0
    ) -> Message:
        """Call a service; raises as `RobotManager.call`, and ServerError.

        Where this is cancelled, the call is cancelled at the robot, too.
        """
        wanted = await self._typed(as_type, name, f"the reply of {name!r}", "reply")
        sent = as_message(message, f"request to {name!r}")
        limit: dict[str, Any] = {"x-timeout": timeout}
        reply = await self.ask("Call", name, jsonMessage=sent, **limit)
        return reply if wanted is None else wanted.read(reply)

    async def status(self) -> Mapping[str, Any]:
        """Return the status map, and `own`: what this client received and lost.

        Only what has changed since the last time comes over the connection.
        """
        known = self._status
        version = known.get("version")
        since: dict[str, Any] = {} if version is None else {"jsonMessage": {"since": version}}
        self._status = merged_status(known, await self._answer("Status", **since))
        return self._status

    async def _diagnose(self, connection: str) -> tuple[str, ...]:
        """Say what keeps messages from coming, as far as the server says so at once."""
        with suppress(errors.UoarmError, asyncio.TimeoutError):
            return find_trouble(await result_within(_DIAGNOSIS_SECONDS, self.status()), connection)
        return ()

    async def watch(self) -> AsyncIterator[StatusEvent]:
        """Yield changes of the robot until the connection ends for good; see `connect`.

        Of those that wait to be taken the newest are kept; a gap in `number` is what was lost.
        """
        events: _Changes = asyncio.Queue(_HELD)
        self._watchers.add(events)
        try:
            await self.ask("Status", "watch")
            while (event := await events.get()) is not None:
                yield event
        finally:
            self._watchers.discard(events)

    @asynccontextmanager
    async def running(self, *, resume: bool) -> AsyncIterator[Self]:
        """Connect for the length of a block; `connect` does it."""
        self._loop = asyncio.get_running_loop()
        await self._link.start(resume=resume)
        reading = asyncio.ensure_future(self._read())
        try:
            yield self
        finally:
            reading.cancel()
            with suppress(asyncio.CancelledError):
                await reading
            await self._link.close()

    async def _read(self) -> None:
        """Read until the connection ends for good; what waits then fails."""
        try:
            await self._link.run()
        finally:
            for renewing in self._renewing:
                renewing.cancel()
            self._fail(self._link.closed)
            for stream in {*self._streams.values(), *self._away}:
                stream.finish("failed", self._link.closed)
            self._notify_watchers(None)
            self._ended.set()

    def _fail(self, cause: str) -> None:
        """Fail everything that waits for an answer, which will not come."""
        for asked in tuple(self._asked.values()):  # threads ask meanwhile
            if not asked.answer.done():
                asked.answer.set_exception(errors.ConnectionClosedError(cause))

    def _lose(self, cause: str) -> None:
        """Fail what waits, and let nothing be sent to connections of a session that is gone."""
        self._fail(cause)
        self._abandoned.clear()
        for stream in self._streams.values():
            stream.suspend()
            self._away.add(stream)
        self._streams.clear()

    def _settle(self, own: Sequence[Mapping[str, Any]]) -> None:
        """Count what a drop took, of what the server says of this client's connections."""
        for counters in own:
            stream = self._streams.get(counters["connection"])
            if stream is not None and counters["number"] is not None:
                stream.settle(counters["number"])

    def _open_again(self) -> None:
        """Have a new session report what changes, and open what the one before had."""
        if self._watchers:
            self._begin(self._try_to_ask("Status", "watch"))
        self._away = {stream for stream in self._away if not stream.ended}
        for stream in self._away:
            self._begin(self._renew(stream))

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        renewing = asyncio.ensure_future(work)
        self._renewing.add(renewing)
        renewing.add_done_callback(self._renewing.discard)

    async def _renew(self, stream: RemoteStream[Any]) -> None:
        session = self._link.session
        try:
            asked = {name: value for name, value in stream.request.items() if name != "op"}
            await self.ask("Request", asked.pop("type"), renewed=stream, **asked)
            if stream.ended:  # it was given back meanwhile
                await self.ask("Kill", stream.connection)
        except errors.UoarmError as error:
            if session == self._link.session:  # otherwise it is tried again already
                self._away.discard(stream)
                stream.finish("failed", f"after a restart of the server: {error}")

    def _give_up(self, op: str, identity: str) -> None:
        """Have the server end what was asked for, and is not waited for any more."""
        if op == "Request":
            self._abandoned.add(identity)
        elif op == "Call":
            self._begin(self._try_to_ask("Kill", identity, jsonMessage={"call": True}))

    async def _try_to_ask(self, op: str, kind: str, **more: Any) -> None:
        with suppress(errors.UoarmError):  # what it is about has ended meanwhile
            await self.ask(op, kind, **more)

    async def _typed(self, hint: Any, name: str, place: str, port: str) -> MessageType[Any] | None:
        """Return the type that is wanted, proven to be what the server's plan gives."""
        if hint is None:
            return None
        wanted: MessageType[Any] = MessageType(hint, place, self._form)
        steps = (await self.resolve(name))["plan"]["steps"]
        structures: Mapping[str, Any] = steps[-1]["structures"] if steps else {}
        output = name.partition(".")[2]
        names = [structure for structure in structures if structure.startswith(port)]
        only = names[0] if len(names) == 1 and not output else f"{port}{output or 'default'}"
        if only not in structures:
            raise errors.UsageError(f"{place} gives no messages, so that `as_type` says nothing")
        wanted.require(structures[only]["schema"])
        return wanted

    async def ended(self) -> str:
        """Wait until the connection has ended for good; returns why."""
        await self._ended.wait()
        return self._link.closed

    def drop(self) -> None:
        """Break the connection and go on over another: what was not sent yet is never sent.

        What waits for an answer gets that of the server, or fails where it did not arrive.
        """
        self._link.drop()

    async def ask(
        self, op: str, kind: str = "", *, renewed: RemoteStream[Any] | None = None, **more: Any
    ) -> Any:
        """Ask what this class has no method for, as the protocol says; returns `jsonMessage`.

        As it came: only the reply to a `Request` is checked here.

        Args:
            op: of the control message.
            kind: its `type`.
            renewed: the stream that a `Request` opens again; for this class.
            more: further fields, such as `jsonMessage` and `x-managers`.

        Raises:
            UoarmError: the server refused, as the other methods raise it.
            BridgeTimeoutError: nothing was answered in time, though the server is there.
            ConnectionClosedError: the connection has ended for good; so does one over which
                something comes that the protocol does not have.
        """
        if op == _FIRST and not kind and self._link.holds_up:
            return await self._ask_apart(op, more)
        while True:
            before = self.resumed, self.restarts
            try:
                return await self._ask(op, kind, renewed, more)
            except errors.ConnectionClosedError:
                was_dropped = before[0] < self.resumed and before[1] == self.restarts
                if op not in _REPEATABLE or not was_dropped or self._link.closed:
                    raise

    async def _ask_apart(self, op: str, more: Mapping[str, Any]) -> Any:
        """Ask over a connection of its own, as this one waits until the server has read."""
        other = RemoteRobot(
            self._opening, self._form, answer=self._answer_seconds, place=self._link.place
        )
        async with AsyncExitStack() as stack:
            try:
                await stack.enter_async_context(other.running(resume=False))
            except CONNECTING_ERRORS:
                return await self._ask(op, "", None, more)
            return await other.ask(op, **more)

    async def _ask(
        self, op: str, kind: str, renewed: RemoteStream[Any] | None, more: Mapping[str, Any]
    ) -> Any:
        if self._link.closed:
            raise errors.ConnectionClosedError(self._link.closed)
        identity = str(next(self._ids))
        fields = {"op": op, **more} | ({"type": kind} if kind else {})
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[Any] = loop.create_future()
        self._asked[identity] = _PendingRequest(fields, answer, renewed)
        seconds = self._answer_seconds + _given_seconds(fields)
        what = f"{op} {kind}".rstrip()
        timer = loop.call_later(seconds, self._fail_late, answer, what, seconds)
        try:
            # Of a request always, so that it is known of commands by how much they are later.
            timed = {"x-sent": boot_seconds()} if op == "Request" else {}
            sending = self._link.send({**fields, **timed, "id": identity})
            await (result_within(seconds, sending) if self._link.holds_up else sending)
            return await answer
        except asyncio.TimeoutError as error:
            if isinstance(error, errors.UoarmError):
                raise
            raise self._late(what, seconds) from error
        except asyncio.CancelledError:
            # The answer came before, in the same turn of the loop: what it opened has no user.
            is_answered = answer.done() and not answer.cancelled()
            if op == "Request" and renewed is None and is_answered and not answer.exception():
                self._begin(self._try_to_ask("Kill", answer.result().connection))
            raise
        finally:
            timer.cancel()
            self._asked.pop(identity, None)
            if self._link.is_unanswered(identity) and not self._link.closed:
                self._give_up(op, identity)
            if answer.done() and not answer.cancelled():
                answer.exception()  # it is seen, also where sending failed before

    def ask_in_thread(
        self,
        op: str,
        kind: str,
        timeout: float,
        session: int,
        began: Callable[[ThreadAnswer], object],
        **more: Any,
    ) -> Any:
        """Ask in a thread that is not the loop's, and wait there: what opens no stream.

        Without a turn of the loop before the question is sent, where the socket takes it at once.

        Args:
            op: of the control message.
            kind: its `type`.
            timeout: seconds that the answer may take.
            session: `restarts`, from before `kind` was found out: in no other session is it sent.
            began: called with the answer to come, which any thread may fail.
            more: further fields.

        Raises:
            TimeoutError: no answer in time.
            UoarmError: as `ask`; and as the answer was failed with.
        """
        identity, answer = str(next(self._ids)), ThreadAnswer()
        asked = self._asked[identity] = _PendingRequest({"op": op, "type": kind, **more}, answer)
        is_with_loop = False
        try:
            if self._link.closed:  # looked at after it was listed: all that is listed then fails
                raise errors.ConnectionClosedError(self._link.closed)
            began(answer)
            if not self._link.send_at_once({**asked.fields, "id": identity}, session):
                is_with_loop = True
                self._in_loop(self._send_for, asked, identity, session)
            return answer.wait(timeout)
        finally:
            if is_with_loop or self._link.is_unanswered(identity):
                self._in_loop(self._leave, op, identity)
            else:
                self._asked.pop(identity, None)

    def _in_loop(self, action: Callable[..., object], *arguments: Any) -> None:
        with suppress(RuntimeError):  # it is closed, and what waits has failed
            self._loop.call_soon_threadsafe(action, *arguments)

    def _send_for(self, asked: _PendingRequest, identity: str, session: int) -> None:
        async def send() -> None:
            try:
                await self._link.send({**asked.fields, "id": identity}, session)
            except errors.UoarmError as error:
                asked.answer.set_exception(error)
            finally:
                self._sending.pop(identity, None)

        if identity in self._asked:
            self._sending[identity] = asyncio.ensure_future(send())

    def _leave(self, op: str, identity: str) -> None:
        """Let go of what a thread asked and waits for no more; what was not sent never is."""
        self._asked.pop(identity, None)
        if identity in self._sending:
            self._sending[identity].cancel()
        if self._link.is_unanswered(identity) and not self._link.closed:
            self._give_up(op, identity)

    def _take(self, received: Mapping[str, Any]) -> None:
        op, message = received["op"], received.get("jsonMessage")
        if op == "Data":
            stream = self._streams.get(received["type"])
            if stream is not None:
                is_standing = received.get("x-standing") is True
                number = None if is_standing else checked(received["x-number"], "integer", "Data")
                stream.take(number, message)
        elif op == "Status":
            self._take_status(received["type"], message)
        else:
            self._take_answer(received, message)

    def _take_status(self, kind: str, message: Message) -> None:
        checked(message, NOTICES.get(kind, "any"), f"Status {kind}")
        if kind == "hello":
            self.hello, self._link.most = message, message.get("message_bytes")
        elif kind == "connection":
            stream = self._streams.pop(message["connection"], None)
            if stream is not None:
                stream.finish(message["state"], message["cause"], message["number"])
        elif kind == "change":
            known = {name: value for name, value in message.items() if name in _EVENT}
            self._notify_watchers(StatusEvent(**known))

    def _notify_watchers(self, change: StatusEvent | None) -> None:
        for watcher in self._watchers:
            if watcher.full():
                watcher.get_nowait()
            watcher.put_nowait(change)

    def _take_answer(self, received: Mapping[str, Any], message: Message) -> None:
        asked = self._asked.get(received.get("id", ""))
        stream = self._streams.get(received.get("type", ""))
        if received["op"] == "Error" and "id" not in received and stream is not None:
            stream.refuse(str(error_of(message)))  # one of its messages could not be written
        if asked is None or asked.answer.done():
            # Of a request that was given up, or is cancelled and has had no turn since.
            is_request = asked is not None and asked.fields["op"] == "Request"
            if received.get("id") in self._abandoned or is_request:
                self._abandoned.discard(received["id"])
                if received["op"] == "Reply":
                    self._begin(self._try_to_ask("Kill", message["connection"]))
            return
        if received["op"] == "Error":
            asked.answer.set_exception(error_of(message))
            return
        if received["op"] != "Reply":
            text = f"op: expected Reply or Error, got {received['op']!r:.60}"
            raise errors.ControlMessageError(text)
        if asked.fields["op"] == "Request":
            checked_answer(asked.fields, message)
            # Made here, since the first message may follow before the caller has woken.
            stream = asked.renewed
            if stream is None:
                queue = QueuePolicy(_HELD)
                stream = RemoteStream(message, asked.fields, self.ask, self._diagnose, queue)
            else:
                stream.renew(message)
            self._away.discard(stream)
            self._streams[stream.connection] = stream
            asked.answer.set_result(stream)
        else:
            if asked.fields["op"] == "Kill":
                self._streams.pop(received["type"], None)
            asked.answer.set_result(message)

    def _fail_late(self, answer: asyncio.Future[Any], what: str, seconds: float) -> None:
        if not answer.done():
            answer.set_exception(self._late(what, seconds))

    def _late(self, what: str, seconds: float) -> errors.BridgeTimeoutError:
        trouble = f"; {self._link.trouble}" if self._link.trouble else ""
        text = f"{self._link.place} has not answered {what} within {seconds:g} s{trouble}"
        return errors.BridgeTimeoutError(text)


def _given_seconds(fields: Mapping[str, Any]) -> float:
    """Return how long the server may take since the question says so."""
    options = fields.get("jsonMessage") if fields["op"] == "Request" else None
    given = options.get("wait") if isinstance(options, Mapping) else fields.get("x-timeout")
    return given if isinstance(given, int | float) else 0.0
