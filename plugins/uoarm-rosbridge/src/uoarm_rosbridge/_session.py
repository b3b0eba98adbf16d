"""One rosbridge client: each operation, and a status message where something is wrong."""

from __future__ import annotations

import asyncio
import functools
import itertools
import logging
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import orjson
from attrs import define, field, frozen

from uoarm.bridge import LimitedLog, on_failure
from uoarm.errors import BridgeError, ControlMessageError, UsageError
from uoarm.model import BudgetUse, Message, Op, Role, message_octets, show_value
from uoarm.server.front_end import (
    Backend,
    BusyError,
    Charge,
    Client,
    GoalStatus,
    LimitError,
    MemoryUse,
    Operation,
    UnknownError,
    code_of,
    coded_text,
    without_frames,
)
from uoarm_rosbridge._actions import Actions
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import Addresses, NamedPort, find_place
from uoarm_rosbridge._rosapi import Rosapi, RosapiCatalogue
from uoarm_rosbridge._rosapi_answers import PREFIX
from uoarm_rosbridge._topics import Topics
from uoarm_rosbridge._types import reader_of
from uoarm_rosbridge._wire import (
    Fragments,
    check_fields,
    first_fields,
    fragment_size,
    identity_of,
    read_operation,
    split,
    write_ros,
)

Fields = Mapping[str, Any]
_CANCEL = "/_action/cancel_goal"
_log = logging.getLogger("uoarm.rosbridge")
_LEVELS = ("info", "warning", "error", "none")
_WARNING, _ERROR = _LEVELS.index("warning"), _LEVELS.index("error")
_REFUSED = {
    "png": "png is not taken from clients: send JSON text",
    "auth": "auth is not served: show a token in the handshake, as Authorization: Bearer TOKEN, as "
    "the subprotocol uoarm.token.TOKEN or as ?token=TOKEN",
}
_OF_NATIVE = {item.value for item in Op}
_NAMED = ("topic", "service", "action", "type", "node", "name")
_LONGEST_NAME = 200
_ANSWERED = {
    "call_service": ("service_response", "service"),
    "send_action_goal": ("action_result", "action"),
}


@define(eq=False)
class ClientServices:
    """Calls and answers of one client, in the loop's thread.

    Args:
        addresses: of functions, which clients may call by them.
        send: sends one message to the client, in fragments of a size, 0 for none.
        ask: sends another client's request; raises BusyError where it leaves too much unread.
        cancel_goals: asks for the end of all the client's goals to an action.
    """

    _client: Client
    _backend: Backend
    _hub: Hub
    _rosapi: Rosapi
    _addresses: Addresses
    _send: Callable[[Fields, int], None]
    _ask: Callable[[Fields], None]
    _cancel_goals: Callable[[NamedPort], None]
    _provided: dict[str, str] = field(factory=dict, init=False)  # names as the client has them

    async def call(self, fields: Fields) -> None:
        """Call a service and send its response."""
        arguments = fields.get("args")
        limit, most = fields.get("timeout"), self._client.limits.call_seconds
        timeout = min(float(limit), most) if limit is not None and limit > 0 else most
        stated = str(fields.get("type") or "")
        values = await self._answer(str(fields["service"]), stated, arguments, timeout)
        response = {
            "op": "service_response",
            "service": fields["service"],
            "values": values,
            "result": True,
        }
        if fields.get("id") is not None:
            response["id"] = fields["id"]
        self._send(response, fragment_size(fields))

    def advertise(self, fields: Fields) -> None:
        """Provide a service to other clients."""
        place = find_place(fields["service"])
        self._client.require(Operation.SEND, place.right)
        if place.function or place.name.startswith(PREFIX):
            raise UsageError(f"{place.name!r} belongs to the server")
        if len(self._provided) >= self._client.limits.streams:
            raise LimitError(
                f"{self._client.limits.streams} services are provided; withdraw one first"
            )
        self._hub.provide(place.name, fields["type"], self)
        self._provided[place.name] = fields["service"]

    def unadvertise(self, fields: Fields) -> None:
        """Provide a service no more."""
        name = find_place(fields["service"]).name
        if name not in self._provided:
            raise UsageError(f"this client does not provide {name!r}")
        del self._provided[name]
        self._hub.withdraw(name, self)

    def respond(self, fields: Fields) -> None:
        """Pass on the client's answer to a request."""
        values = fields.get("values")

        def conclude(future: Any) -> None:
            if fields["result"] is True:
                future.set_result({} if values is None else values)
            else:
                future.set_exception(BridgeError(f"the service said no: {show_value(values, 500)}"))

        self._hub.answer(str(fields["id"]), self, conclude)

    def refused(self, fields: Fields, why: str) -> None:
        """Have who waits for an answer of this client know why it was refused."""
        self._hub.refused(fields.get("id"), self, why)

    def ask(self, identity: str, service: str, message: Message) -> None:
        """Send another client's request to this one, which provides the service."""
        name = self._provided[service]
        self._ask({"op": "call_service", "id": identity, "service": name, "args": message})

    def close(self) -> None:
        """Withdraw everything."""
        self._hub.forget(self)

    async def _answer(
        self, service: str, stated: str, arguments: Message, timeout: float
    ) -> Message:
        place = find_place(service)
        if place.name.startswith(PREFIX):
            return await self._rosapi.call(place.name.removeprefix(PREFIX), arguments)
        if place.name.endswith(_CANCEL):
            self._cancel_goals(find_place(place.name.removesuffix(_CANCEL)))
            return {"return_code": 0, "goals_canceling": []}
        self._client.require(Operation.CALL, place.right)
        if not place.function:
            if not self._hub.provides(place.name):
                hint = self._addresses.hint(place.name, Role.SERVICE, self._client)
                if hint:
                    raise UnknownError(hint)
            given = {} if arguments is None else arguments
            return await self._hub.call(place.name, stated, given, timeout)
        read = reader_of(f"service {place.name!r}", stated)
        return await self._backend.call(place.wanted, arguments, read, timeout)


@frozen
class _Operation:
    needed: tuple[str, ...]
    act: Callable[[Mapping[str, Any]], Coroutine[Any, Any, None] | None]


class RosbridgeSession:
    """One client that speaks rosbridge v2.

    Operations are begun in the order in which they come; service calls run side by side. What
    rosbridge answers with silence is answered here with a `status` message of level `error`.
    """

    def __init__(
        self,
        client: Client,
        backend: Backend,
        hub: Hub,
        catalogue: RosapiCatalogue,
        addresses: Addresses,
    ) -> None:
        self._client = client
        self._backend = backend
        self._level = _WARNING
        self._records = LimitedLog(_log)
        self._numbers = itertools.count(1)
        seconds = client.limits.message_seconds
        self._fragments = Fragments(2 * client.limits.message_bytes, seconds)
        self._looking: asyncio.TimerHandle | None = None
        self._fragments_held = client.account.hold(MemoryUse.FRAGMENTS)
        self._tasks: set[asyncio.Task[None]] = set()
        self._topics = Topics(
            client, backend, hub, addresses, self._fail, self._warn, self._written_failure
        )
        self._actions = Actions(client, backend, hub.actions, self._fail, self.ask)
        cancel = self._actions.cancel_all
        rosapi = Rosapi(catalogue, hub, client)
        self._services = ClientServices(
            client, backend, hub, rosapi, addresses, self.send, self.ask, cancel
        )
        topics, services, actions = self._topics, self._services, self._actions
        self._operations = {
            "advertise": _Operation(("topic", "type"), topics.advertise),
            "unadvertise": _Operation(("topic",), topics.unadvertise),
            "publish": _Operation(("topic", "msg"), topics.publish),
            "subscribe": _Operation(("topic",), topics.subscribe),
            "unsubscribe": _Operation(("topic",), topics.unsubscribe),
            "call_service": _Operation(("service",), services.call),
            "advertise_service": _Operation(("service", "type"), services.advertise),
            "unadvertise_service": _Operation(("service",), services.unadvertise),
            "service_response": _Operation(("id", "result"), services.respond),
            "send_action_goal": _Operation(("action",), actions.send_goal),
            "cancel_action_goal": _Operation(("id", "action"), actions.cancel_goal),
            "advertise_action": _Operation(("action", "type"), actions.advertise),
            "unadvertise_action": _Operation(("action",), actions.unadvertise),
            "action_feedback": _Operation(("id", "action", "values"), actions.take_feedback),
            "action_result": _Operation(("id", "action", "status", "result"), actions.take_result),
            "set_level": _Operation(("level",), self._set_level),
            "status": _Operation((), _ignore),
        }

    def octets(self, frame: str | bytes) -> int:
        """Return how much there may be to decode, with the fragments that this one may complete."""
        return len(frame) + self._fragments.octets

    def decode(self, frame: str | bytes, spending: BudgetUse) -> tuple[Callable[[], None], int]:
        """Return what acts on one frame, now or later, and how much memory its message holds."""
        fields: dict[str, Any] = {}
        try:
            fields = read_operation(frame, spending)
            whole = self._collect(fields, spending) if fields.get("op") == "fragment" else fields
        except Exception as error:  # noqa: BLE001 - every message that is wrong is reported
            if not isinstance(error, ControlMessageError):
                text = f"a message of client {self._client.identity}"
                self._records.write(logging.ERROR, text, error)
            # Of what is too much to be read, as of too many values, who calls waits for an answer.
            if fields.get("op") == "fragment":
                fields |= self._fragments.last
            fields = fields or first_fields(frame)
            return functools.partial(self._fail, fields, without_frames(error)), 0
        return functools.partial(self._handle, whole), message_octets(whole)

    def close(self) -> None:
        """Give back everything that only this client used."""
        for task in self._tasks:
            task.cancel()
        if self._looking is not None:
            self._looking.cancel()
        self._topics.close()
        self._services.close()
        self._actions.close()

    def send(self, message: Mapping[str, Any], size: int = 0) -> None:
        """Send one message, in fragments of a size; raises MessageError when it has no form."""
        identity = f"uoarm:{message['op']}:{next(self._numbers)}"
        for frame in split(write_ros(message), size, identity):
            self._client.outbox.reply(frame, text=True)

    def ask(self, message: Mapping[str, Any]) -> None:
        """Send what another client asks of this one.

        Raises:
            BusyError: this client leaves too much unread; it must not be cut off for that.
            MessageError: the message has no form.
        """
        frame = write_ros(message)
        if not self._client.outbox.has_room(len(frame)):
            raise BusyError("the client that provides it leaves too much unread")
        self._client.outbox.reply(frame, text=True)

    def _handle(self, fields: Mapping[str, Any] | None) -> None:
        """Act on a message; None: on a fragment that completes none."""
        try:
            self._count_fragments()
            if fields is not None:
                self._act(fields)
        except Exception as error:  # noqa: BLE001 - every message that is wrong is reported
            self._fail(fields or {}, error)

    def _count_fragments(self) -> None:
        """Charge what is unfinished; let it go where there is no room for it, or no end of it."""
        octets = self._fragments.octets
        grows = octets > self._fragments_held.octets
        self._fragments_held.resize(octets)
        if grows and not self._client.account.has_share:
            error = BusyError("fragment: the server holds as much as it may for all clients")
            for fields in self._fragments.clear():
                self._fail(fields, error)
            octets = 0
            self._fragments_held.resize(0)
        if octets and self._looking is None:
            seconds = self._client.limits.message_seconds
            self._looking = asyncio.get_running_loop().call_later(seconds, self._forget_late)

    def _forget_late(self) -> None:
        self._looking = None
        seconds = self._client.limits.message_seconds
        for name, fields in self._fragments.forget_late().items():
            text = f"fragment: message {name!r:.200} was not finished within {seconds:g} s"
            self._fail(fields, ControlMessageError(text))
        self._count_fragments()

    def _act(self, fields: Mapping[str, Any]) -> None:
        op = fields.get("op")
        if not isinstance(op, str):
            raise ControlMessageError("the field 'op' is missing or no text")
        if op in _REFUSED:
            raise ControlMessageError(_REFUSED[op])
        operation = self._operations.get(op)
        if operation is None:
            if op in _OF_NATIVE:
                raise ControlMessageError(
                    f"the op {op!r} is of the native protocol, whose clients connect at /"
                )
            known = ", ".join((*self._operations, "fragment"))
            raise ControlMessageError(f"unknown op {op[:60]!r}; expected one of {known}")
        check_fields(fields, operation.needed)
        later = operation.act(fields)
        if later is not None:
            self._begin(fields, later)

    def _begin(self, fields: Mapping[str, Any], work: Coroutine[Any, Any, None]) -> None:
        with on_failure(work.close):
            charge = self._admit()
        task = asyncio.ensure_future(self._finish(fields, work))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(lambda _: charge.release())

    def _admit(self) -> Charge:
        most = self._client.limits.calls
        if len(self._tasks) >= most:
            raise LimitError(f"{most} calls are under way; wait for an answer")
        return self._client.account.charge(MemoryUse.ASKED, self._client.in_hand)

    async def _finish(self, fields: Mapping[str, Any], work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except Exception as error:  # noqa: BLE001 - every message that is wrong is reported
            self._fail(fields, error)

    def _collect(self, fields: Mapping[str, Any], spending: BudgetUse) -> Mapping[str, Any] | None:
        """Return the message that this fragment completes."""
        check_fields(fields, ("id", "data", "num", "total"))
        text = self._fragments.add(fields)
        if text is None:
            return None
        inner = read_operation(text, spending)
        if inner.get("op") == "fragment":
            raise ControlMessageError("fragment: a fragment of fragments")
        return inner

    def _set_level(self, fields: Mapping[str, Any]) -> None:
        if fields["level"] not in _LEVELS:
            raise ControlMessageError(f"set_level: level: expected one of {', '.join(_LEVELS)}")
        self._level = _LEVELS.index(fields["level"])

    def _fail(self, fields: Mapping[str, Any], error: BaseException) -> None:
        op = fields.get("op")
        if op == "service_response" or not isinstance(op, str):  # it may have been an answer
            self._services.refused(fields, self._failure_text(fields, error))
        if isinstance(op, str) and op in _ANSWERED:
            answer = _failed(fields, *_ANSWERED[op], self._failure_text(fields, error))
            self._client.outbox.reply(answer, text=True)
        else:
            self._report(self._written_failure(fields, error))

    def _failure_text(self, fields: Mapping[str, Any], error: BaseException) -> str:
        return self._shown(coded_text(error), fields)

    def _written_failure(self, fields: Mapping[str, Any], error: BaseException) -> bytes | None:
        text = f"{code_of(error)}: {self._failure_text(fields, error)}"
        return self._written_status(_ERROR, fields, text)

    def _warn(self, fields: Mapping[str, Any], text: str) -> None:
        self._report(self._written_status(_WARNING, fields, self._shown(text, fields)))

    def _shown(self, text: str, fields: Mapping[str, Any]) -> str:
        """Return a text with no name that the client may not see, but for those it used."""
        given = fields.get("args")
        named = [fields, given] if isinstance(given, dict) else [fields]
        used = [mapping.get(kind) for mapping in named for kind in _NAMED]
        words = " ".join(item[:_LONGEST_NAME] for item in used if isinstance(item, str))
        return self._backend.role_views.of(self._client.role).text(text, words)

    def _report(self, report: bytes | None) -> None:
        if report is not None:
            self._client.outbox.reply(report, text=True)

    def _written_status(self, level: int, fields: Mapping[str, Any], text: str) -> bytes | None:
        """Return a report; None where the client wants none of this level."""
        if self._level > level:
            return None
        status: dict[str, Any] = {"op": "status", "level": _LEVELS[level], "msg": text}
        identity = identity_of(fields)
        if identity is not None:
            status["id"] = identity
        return write_ros(status)


def _failed(fields: Mapping[str, Any], op: str, kind: str, text: str) -> bytes:
    """Return the answer to a call or a goal that was not even begun."""
    name, identity = fields.get(kind), identity_of(fields)
    answer: dict[str, Message] = {
        "op": op,
        kind: name if isinstance(name, str) else "",
        "values": text,
        "result": False,
    }
    if op == "action_result":
        answer["status"] = int(GoalStatus.UNKNOWN)
    if identity is not None:
        answer["id"] = identity
    return orjson.dumps(answer)


def _ignore(fields: Mapping[str, Any]) -> None:
    """Take what clients say about themselves."""
    del fields
