"""The native protocol: one answer for every message, in order where order matters."""

from __future__ import annotations

import asyncio
import functools
import logging
import time
from collections.abc import Callable, Collection, Coroutine, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from uoarm._control import Connection
from uoarm._raised import LimitedLog, on_failure
from uoarm._resolve import NoPlanError
from uoarm._version import __version__
from uoarm._wire import Form, check_asked, reply_around, reply_to, salvage_id, write_or_error
from uoarm.bridge import asking, boot_seconds, refuse_loop
from uoarm.config import completed_schema
from uoarm.errors import ConnectionClosedError, ControlMessageError, UoarmError, UsageError
from uoarm.model import (
    BudgetUse,
    ConfigurationChange,
    ControlMessage,
    LeaseHolder,
    Message,
    Op,
    Plan,
    StopReport,
    message_octets,
    to_json,
)
from uoarm.server._failures import LimitError, UnknownError, code_of, error_code_of, without_frames
from uoarm.server.access import Operation, RoleView
from uoarm.server.session._calls import ClientCalls
from uoarm.server.session._client import ConnectedClient
from uoarm.server.session._discoveries import Discoveries
from uoarm.server.session._recordings import RecordingAnswer, RecordingRequests
from uoarm.server.session._session_store import ReplyCache, SessionStore
from uoarm.server.session._views import (
    FunctionLists,
    ListQuestion,
    StatusQuestion,
    StatusViews,
    show_approval,
    show_changes,
    show_plan,
    show_stop,
)
from uoarm.server.streams import (
    ChangeNotice,
    Charge,
    ClientStreams,
    CommandAges,
    FeedRegistry,
    MemoryUse,
    feed_key,
)

_log = logging.getLogger("uoarm.server")
_FAILED = "the server failed; its log says more"
_KINDS = {Op.REQUEST: "", Op.LIST: "questions", Op.STATUS: "questions"}
"""What counts together against the limit of calls, where it is no call; `""`: nothing."""


class Shared:
    """What the sessions of all clients of the native protocol are answered from.

    Attributes:
        lists: of functions.
        status: the status map.
        recordings: that are written, and that are played.
        sessions: that are open; changed in the loop's thread only.
        records: of what was not foreseen.
    """

    def __init__(self, registry: FeedRegistry, folder: Path) -> None:
        robot, views = registry.robot, registry.role_views
        self.lists = FunctionLists(lambda: robot.config, views)
        self.sessions: dict[NativeSession, None] = {}
        # Of a copy, which the interpreter makes in one go: sessions come and go meanwhile.
        self.status = StatusViews(
            robot.status,
            registry.past,
            views,
            lambda: [session.who() for session in tuple(self.sessions)],
        )
        self.recordings = RecordingRequests(registry, folder)
        self.records = LimitedLog(_log)


class NativeSession:
    """One client that speaks the native protocol.

    Messages are begun in the order in which they come. Data to one connection stays in order, and
    a Kill waits for the Data before it; everything else runs side by side, so that a slow call
    holds up nothing.
    """

    def __init__(
        self,
        client: ConnectedClient,
        registry: FeedRegistry,
        form: Form,
        store: SessionStore,
        shared: Shared,
    ) -> None:
        self.form = form.name
        self._client = client
        self._store = store
        self._replies: ReplyCache | None = None
        self._registry = registry
        self._form = form
        self._holder = LeaseHolder(f"session {client.identity}", client.role.name)
        self._streams = ClientStreams(
            registry,
            client,
            form,
            self._holder,
            lambda connection, error: self._fail(None, connection, error),
            lambda text: self._view.text(text),  # noqa: PLW0108 - of the revision at that time
        )
        self._discoveries = Discoveries(registry)
        self._shared = shared
        self._ages = CommandAges()
        self._calls = ClientCalls(
            client, registry, form, self._written, self._emit_frame, self._failed
        )
        self._stops: set[asyncio.Task[None]] = set()
        self._tasks: dict[asyncio.Task[None], Op] = {}
        self._quick: Mapping[Op, Callable[[ControlMessage], None]] = {
            Op.CALL: self._call,
            Op.DATA: self._send,
            Op.KILL: self._kill,
            Op.RESUME: self._resume,
            Op.STOP: self._stop,
        }
        self._slow: Mapping[Op, Callable[[ControlMessage], Coroutine[Any, Any, None]]] = {
            Op.LIST: self._list,
            Op.STATUS: self._status,
            Op.REQUEST: self._request,
            Op.RESOLVE: self._resolve,
            Op.CONFIGURE: self._configure,
            Op.DISCOVER: self._discover,
            Op.APPROVE: self._approve,
            Op.RECORD: functools.partial(self._ask_desk, shared.recordings.record),
            Op.PLAY: functools.partial(self._ask_desk, shared.recordings.playback),
        }
        shared.sessions[self] = None
        self._emit({"op": "Status", "type": "hello", "jsonMessage": self._hello()})

    @property
    def is_in_use(self) -> bool:
        """Whether it has open functions, or something under way."""
        return bool(self._tasks or self._calls or self._streams.connections())

    def who(self) -> dict[str, Any]:
        """Return whose session it is, and which connections it has. From any thread."""
        return {
            "session": self._client.identity,
            "principal": self._client.principal,
            "role": self._client.role.name,
            "address": self._client.address,
            "connections": self._streams.connections(),
        }

    def octets(self, frame: str | bytes) -> int:
        """Return how much there is to decode."""
        return self._form.decoding_octets(frame)

    def decode(self, frame: str | bytes, spending: BudgetUse) -> tuple[Callable[[], None], int]:
        """Return what answers one frame, now or later, and how much memory its message holds."""
        fields: Mapping[str, Any] = {}
        try:
            fields = self._form.read(frame, spending)
            asked = check_asked(fields)
        except Exception as error:  # noqa: BLE001 - every message gets its answer
            if not isinstance(error, ControlMessageError):
                text = f"a message of client {self._client.identity}"
                self._shared.records.write(logging.ERROR, text, error)
            # Of what is too much to be read, as of too many values, who asked waits for an answer.
            identity = salvage_id(fields or {"id": self._form.last_id(frame)})
            return functools.partial(self._fail, identity, "", without_frames(error)), 0
        return functools.partial(self._handle, asked), message_octets(asked.jsonMessage)

    def _handle(self, asked: ControlMessage) -> None:
        if self._replies is not None and asked.id is not None:
            self._replies.begin(asked.id)
        try:
            with asking(self._asking(asked)):
                if asked.op in self._quick:
                    self._quick[asked.op](asked)
                else:
                    self._begin(asked, self._slow[asked.op](asked))
        except Exception as error:  # noqa: BLE001 - every message gets its answer
            self._failed(asked, error)

    def _asking(self, asked: ControlMessage) -> tuple[str, ...]:
        """Return the managers through which a question came; refuse what comes back to this one."""
        importer = self._client.credentials.importer
        if not importer:
            return ()
        shown = asked.extensions.get("x-managers", (importer,))
        assert isinstance(shown, list | tuple), "the schema says so"
        managers = tuple(map(str, shown))
        refuse_loop(str(asked.type or asked.op.value), (*managers, self._registry.robot.identity))
        return managers

    def go_on(self, asked: ControlMessage) -> None:
        """Answer the Resume that took this session up, and what its client may not have received.

        What it asked and was not kept or never came gets an error. Ends are sent again: a client
        that missed one would wait for messages for ever.
        """
        self._ages = CommandAges()  # of the connection that this came by
        self._age(asked)
        self._reply(asked, {"session": self._client.identity, "own": self._streams.counters()})
        assert self._replies is not None, "only a session that is kept can go on"
        for identity in dict.fromkeys((asked.jsonMessage or {}).get("waiting", ())):
            frame = self._replies.get(identity)
            if frame is None and not self._replies.is_under_way(identity):
                text = "it did not arrive before the connection dropped, or its answer is lost"
                self._fail(identity, "", ConnectionClosedError(text))
            elif frame is not None and not self._client.outbox.holds(frame):
                self._client.outbox.reply(frame, text=self._form.text)
        self._streams.repeat_ends()

    def close(self) -> None:
        """Give back everything that only this client used."""
        self._shared.sessions.pop(self, None)
        self._registry.unwatch(self._changed)
        for task in self._tasks:
            task.cancel()
        self._calls.close()
        self._streams.close()

    def _begin(self, asked: ControlMessage, work: Coroutine[Any, Any, None]) -> None:
        with on_failure(work.close):
            charge = self._admit(asked.op)
        task = asyncio.ensure_future(self._answer(asked, work))
        self._tasks[task] = asked.op
        task.add_done_callback(self._tasks.pop)
        task.add_done_callback(lambda _: charge.release())

    def _admit(self, op: Op) -> Charge:
        """Charge what is asked.

        Functions that are being opened count as streams, not as calls. What is asked of the whole
        robot counts by itself: it is answered also where all calls hang.
        """
        kind = _KINDS.get(op, "calls")
        if kind:  # a thousand functions may be opened at once: not looked at for each of them
            most = self._client.limits.calls
            under_way = sum(_KINDS.get(task, "calls") == kind for task in self._tasks.values())
            if under_way + (len(self._calls) if kind == "calls" else 0) >= most:
                raise LimitError(f"{most} {kind} are under way; wait for an answer first")
        return self._client.account.charge(MemoryUse.ASKED, self._client.in_hand)

    async def _answer(self, asked: ControlMessage, work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except Exception as error:  # noqa: BLE001 - every message gets its answer
            self._failed(asked, error)

    def _age(self, asked: ControlMessage) -> float:
        """Return how old a message is, as far as its client says when it was sent."""
        return self._ages.age(asked.extensions.get("x-sent"), boot_seconds())

    async def _request(self, asked: ControlMessage) -> None:
        self._age(asked)  # by which those of its commands are known
        options = asked.jsonMessage or {}
        wanted = feed_key(str(asked.type), options)
        self._client.require(
            Operation.REQUEST if wanted.receive else Operation.SEND, wanted.function
        )
        on_absent = functools.partial(self._waits, asked)
        stream = await self._streams.open(wanted, options, on_absent)
        plan = stream.connection.plan
        opened = {
            "connection": stream.connection.id,
            "function": plan.function,
            "components": [
                step.component.name
                for step in plan.steps
                if self._view.has_component(step.component.name)
            ],
            "inputs": [port.name for port in plan.provider.component.inputs if port.source is None],
            "warnings": self._view.data(plan.warnings, plan.function),
            "output": stream.connection.output if wanted.receive else None,
            "lifetimes": dict(stream.connection.lifetimes()),
            "latched": stream.feed.is_latched,
            "managers": self._managers(plan),
            "number": stream.feed.before_newcomer,
        }
        self._reply(asked, opened)
        stream.begin()

    def _managers(self, plan: Plan) -> list[str]:
        return [self._registry.robot.identity, *plan.managers]

    def _waits(self, asked: ControlMessage, cause: str) -> None:
        message = {"function": asked.type, "cause": self._view.text(cause, str(asked.type))}
        notice = {"op": "Status", "type": "waiting", "id": asked.id, "jsonMessage": message}
        self._emit_frame(None, write_or_error(self._form, notice))

    def _call(self, asked: ControlMessage) -> None:
        self._calls.begin(asked, self._admit(asked.op))

    async def _resolve(self, asked: ControlMessage) -> None:
        name = str(asked.type)
        self._client.require(Operation.SEE, name.partition(".")[0])

        view = self._view

        def act(plan: Plan) -> bytes:
            shown = {**show_plan(plan, self._form, view), "managers": self._managers(plan)}
            return self._written(asked, shown)

        self._emit_frame(asked.id, await self._registry.resolve_and(act, name))

    async def _configure(self, asked: ControlMessage) -> None:
        self._client.require_all(Operation.CONFIGURE)
        robot, wanted = self._registry.robot, asked.jsonMessage
        changes: list[ConfigurationChange] = []
        if wanted is not None and "schema" not in wanted:
            if wanted.get("keep"):
                self._client.require_all(Operation.KEEP)
            changes.append(await self._registry.configure(wanted))

        def write() -> bytes:
            if changes:
                return self._written(asked, show_changes(changes)[0])
            if wanted is not None:
                return self._written(asked, {"schema": completed_schema(robot.registry.types)})
            revisions, text = show_changes(robot.history()), robot.config.text
            return self._written(asked, {"revisions": revisions, "configuration": text})

        self._emit_frame(asked.id, await self._registry.in_worker(write))

    async def _discover(self, asked: ControlMessage) -> None:
        take = (asked.jsonMessage or {}).get("take")
        if take is None:
            self._client.require_all(Operation.SEE)  # what no function has is of no pattern
            found = await self._discoveries.look()
            write = functools.partial(self._written, asked, {"bridges": found})
            self._emit_frame(asked.id, await self._registry.in_worker(write))
            return
        self._client.require_all(Operation.CONFIGURE)
        self._reply(asked, await self._discoveries.take(take["bridge"], take["component"]))

    async def _approve(self, asked: ControlMessage) -> None:
        approvals, role = self._registry.approvals, self._client.role
        if not asked.type:
            shown = [
                show_approval(approvals, approval, self._view)
                for approval in approvals.visible(role)
            ]
            self._reply(asked, {"approvals": shown})
            return
        if asked.jsonMessage is None:
            raise UsageError("say whether to approve: {'approve': true} or {'approve': false}")
        approval = approvals.decide(
            str(asked.type),
            self._client.principal,
            role,
            approve=asked.jsonMessage["approve"],
            digest=asked.jsonMessage.get("digest", ""),
            cause=asked.jsonMessage.get("cause", ""),
        )
        self._reply(asked, show_approval(approvals, approval, self._view))

    async def _ask_desk(self, answer: RecordingAnswer, asked: ControlMessage) -> None:
        self._reply(asked, await answer(self._client, self._view, asked))

    def _stop(self, asked: ControlMessage) -> None:
        """Stop beside whatever else is under way; it counts for no limit of calls."""
        release = bool((asked.jsonMessage or {}).get("release"))
        if asked.type:
            self._stop_input(asked, release=release)
            return
        self._client.require_all(Operation.RELEASE if release else Operation.STOP)
        work = self._release(asked) if release else self._stop_all(asked)
        task = asyncio.ensure_future(self._answer(asked, work))
        self._stops.add(task)
        task.add_done_callback(self._stops.discard)

    def _stop_input(self, asked: ControlMessage, *, release: bool) -> None:
        """Stop one input, which needs the right to send to it: it is a command like others."""
        if release:
            raise UsageError("one input that was stopped needs no release: the next command moves")
        identity, _, port = str(asked.type).partition(".")
        stream = self._streams.own(identity)
        self._client.require(Operation.SEND, stream.connection.plan.function)
        self._streams.sender(stream).stop(port or None, lambda error: self._done(asked, error))

    async def _stop_all(self, asked: ControlMessage) -> None:
        view, form = self._view, self._form
        key = view.role, form.name

        def write(report: StopReport) -> bytes:
            return form.write(show_stop(report, view))

        report, written = await self._registry.stop_all(key, write)
        self._client.note_stop(report)
        self._emit_frame(asked.id, reply_around(self._form, asked, written), first=True)

    async def _release(self, asked: ControlMessage) -> None:
        try:
            await self._registry.release()
        except UoarmError as error:
            self._client.note_release(str(error))
            raise
        self._client.note_release()
        self._reply(asked, None)

    async def _list(self, asked: ControlMessage) -> None:
        lists, role, form = self._shared.lists, self._client.role, self._form
        written = await self._registry.views.get(lists.make, ListQuestion(role, form))
        await self._emit_view(asked, written)

    async def _status(self, asked: ControlMessage) -> None:
        watches = asked.type == "watch"
        if asked.type == "unwatch":
            self._registry.unwatch(self._changed)
        options, role = asked.jsonMessage or {}, self._client.role
        since, wants_clients = options.get("since"), bool(options.get("clients"))
        # Names and addresses of others are for whom may see everything.
        wants_others = wants_clients and role.allows_all(Operation.SEE)
        question = StatusQuestion(role, self._form, since, past=watches, clients=wants_others)
        views = self._registry.views
        answer, own = await asyncio.gather(
            views.get(self._shared.status.make, question),
            views.get(self._write_own, wants_clients and not wants_others),
        )
        await self._emit_view(asked, self._form.map_of({**answer.fields, **own}))
        if watches and not self._registry.is_watched_by(self._changed):
            self._registry.watch(self._changed)
            for event in self._registry.after(answer.number):
                self._changed(event)

    def _write_own(self, questions: Collection[bool]) -> dict[bool, dict[str, bytes]]:
        """Return what a Status has for this client alone, in the thread of the views.

        Each question is whether it wants to know itself as a client.
        """
        write = self._form.write
        own = {"own": write(self._streams.counters()), "time": write(time.time())}
        return {
            shows: {**own, "clients": write([self.who()])} if shows else own for shows in questions
        }

    async def _emit_view(self, asked: ControlMessage, written: bytes) -> None:
        """Send an answer that may be long, when there is room: the client did not choose that."""
        frame = reply_around(self._form, asked, written)
        await self._client.outbox.room(len(frame))
        self._emit_frame(asked.id, frame)

    def _resume(self, asked: ControlMessage) -> None:
        options = asked.jsonMessage
        limits = self._client.limits
        if options is None:
            self._age(asked)
            key = self._store.keep(self._client, self)
            account = self._client.account
            self._replies = ReplyCache(limits.control_messages, limits.queue_bytes, account)
            self._reply(asked, {"key": key, "seconds": limits.resume_seconds})
        elif self.is_in_use or self._replies is not None:
            raise UsageError("Resume with a key must be the first message of a connection")
        else:
            self._store.claim(options["key"], self._client, self.form, asked)

    def _send(self, asked: ControlMessage) -> None:
        identity, _, port = str(asked.type).partition(".")
        stream = self._streams.own(identity)
        self._client.require(Operation.SEND, stream.connection.plan.function)
        self._streams.sender(stream).send(
            asked.jsonMessage,
            port or None,
            lambda error: self._done(asked, error),
            self._client.in_hand,
            take_over=bool(asked.extensions.get("x-take-over")),
            age=self._age(asked),
        )

    def _kill(self, asked: ControlMessage) -> None:
        options = asked.jsonMessage or {}
        if options.get("everyone"):
            self._kill_for_everyone(asked)
        elif options.get("call"):
            self._begin(asked, self._cancel(asked))
        else:
            stream = self._streams.own(str(asked.type))
            self._streams.kill(stream, lambda: self._reply(asked, None))

    async def _cancel(self, asked: ControlMessage) -> None:
        cancel = self._calls.cancel(str(asked.type))
        if cancel is not None:
            await self._registry.in_worker(cancel)
        self._reply(asked, None)

    def _kill_for_everyone(self, asked: ControlMessage) -> None:
        connection = self._registry.connection(str(asked.type))
        seen = connection is not None and self._client.role.allows(
            Operation.SEE, connection.plan.function
        )
        if connection is None or not seen:
            raise UnknownError(f"there is no connection {asked.type!r:.100}")
        self._client.require(Operation.KILL, connection.plan.function)
        self._begin(asked, self._ended_by(asked, connection))

    async def _ended_by(self, asked: ControlMessage, connection: Connection) -> None:
        await asyncio.shield(self._registry.kill(connection, f"killed by {self._holder}"))
        self._reply(asked, None)

    def _changed(self, change: ChangeNotice) -> None:
        frame = change.written(self._client.role, self._form)
        if frame is not None:
            self._emit_frame(None, frame)

    @property
    def _view(self) -> RoleView:
        return self._registry.role_views.of(self._client.role)

    def _hello(self) -> Message:
        return {
            "protocol": 1,
            "server": f"uoarm {__version__}",
            "session": self._client.identity,
            "role": self._client.role.name,
            "rights": self._client.role.rights(),
            "message_bytes": self._client.limits.message_bytes,
            "elements": self._client.limits.elements,
            "depth": self._client.limits.depth,
            "manager": self._registry.robot.identity,
            "time": time.time(),
        }

    def _done(self, asked: ControlMessage, error: BaseException | None) -> None:
        if error is None:
            self._reply(asked, None)
        else:
            self._failed(asked, error)

    def _failed(self, asked: ControlMessage, error: BaseException) -> None:
        if not isinstance(error, UoarmError):
            text = f"{asked.op.value} of client {self._client.identity} failed"
            self._shared.records.write(logging.ERROR, text, error)
        more: dict[str, Any] = {}
        if asked.op is Op.RESOLVE and isinstance(error, NoPlanError):
            more["rejected"] = self._view.data(to_json(error.rejections), str(asked.type))
        self._fail(asked.id, str(asked.type), error, more)

    def _reply(self, asked: ControlMessage, message: Message) -> None:
        self._emit(reply_to(asked, message))

    def _written(self, asked: ControlMessage, message: Message) -> bytes:
        """Write a reply in a worker, which waits where that takes long."""
        write = functools.partial(write_or_error, self._form, reply_to(asked, message))
        return self._registry.encoder.wait(message, write)

    def _fail(
        self,
        identity: str | None,
        kind: str,
        error: BaseException,
        more: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        code = code_of(error)
        text = _FAILED if code == "internal" else self._view.text(str(error), kind)
        notice: dict[str, Any] = {
            "op": "Error",
            "jsonMessage": {
                "code": code,
                "error_code": error_code_of(error),
                "text": text,
                **more,
            },
        }
        if kind:
            notice["type"] = kind
        if identity is not None:
            notice["id"] = identity
        self._emit(notice)

    def _emit(self, message: Mapping[str, Any]) -> None:
        self._emit_frame(message.get("id"), write_or_error(self._form, message))

    def _emit_frame(self, identity: str | None, frame: bytes, *, first: bool = False) -> None:
        if self._replies is not None and identity is not None:
            self._replies.add(identity, frame)
        self._client.outbox.reply(frame, text=self._form.text, first=first)
