"""The two forms of a control message on the wire: JSON text, and CBOR in binary frames."""

from __future__ import annotations

import json
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from itertools import islice
from typing import TYPE_CHECKING, Any, final

from uoarm._spelling import did_you_mean
from uoarm._wire._binary import (
    WRITTEN,
    decoding_octets,
    join_list,
    join_map,
    last_id,
    read_binary,
    write_binary,
)
from uoarm._wire._text import last_id as last_text_id
from uoarm._wire._text import read_text, write_text, write_text_parts
from uoarm._wire._text_schema import make_reader, text_schema
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import BudgetUse, ControlMessage, Message, Op, Schema, message_octets

if TYPE_CHECKING:
    from jsonschema.protocols import Validator

ASKED = tuple(
    op.value
    for op in (
        Op.REQUEST, Op.KILL, Op.DATA, Op.CALL, Op.LIST, Op.RESOLVE, Op.STATUS, Op.RESUME,
        Op.CONFIGURE, Op.STOP, Op.DISCOVER, Op.APPROVE, Op.RECORD, Op.PLAY,
    )
)  # fmt: skip
_OF_ROSBRIDGE = {
    "advertise", "advertise_action", "advertise_service", "call_service", "publish",
    "send_action_goal", "subscribe",
}  # fmt: skip
_QUICK = {"op", "type", "id", "jsonMessage"}
_MAX_ID = 128
_MOST_MANAGERS = 64
_IDENTITY = re.compile("[0-9a-f]{32}")
_MAX_NAME = 256
_SHOWN = 200
_MOST_REPORTED = 5
# Of a control message without the message in it: the schema check takes its time, and quotes.
_MAX_FIELDS = 64
_MAX_OCTETS = 1_048_576


class Form(ABC):
    """How messages are written and read; stateless, so one of each serves all clients.

    Attributes:
        name: `json` or `cbor`.
        subprotocol: the WebSocket subprotocol that asks for it.
        text: whether it goes into text frames.
    """

    name: str
    subprotocol: str
    text: bool

    @abstractmethod
    def write(self, message: Message) -> bytes:
        """Return a control message or any value as it goes onto the wire.

        Raises:
            MessageError: it has no form.
        """

    @abstractmethod
    def write_data(
        self, connection: str, number: int, message: Message, *, standing: bool = False
    ) -> bytes:
        """Return one Data message, the same bytes for every client; raises as `write`.

        One that is `standing` came before the client did.
        """

    @abstractmethod
    def list_of(self, parts: Sequence[bytes]) -> bytes:
        """Return a list of values that are written already."""

    @abstractmethod
    def map_of(self, parts: Mapping[str, bytes]) -> bytes:
        """Return a mapping whose values are written already."""

    @abstractmethod
    def read(
        self, frame: str | bytes | bytearray, spending: BudgetUse, *, with_numpy: bool = False
    ) -> Mapping[str, Any]:
        """Return the fields of a control message, in any thread; `with_numpy` as `read_binary`.

        Raises:
            ControlMessageError: it cannot be read, or costs more than its budget.
        """

    @abstractmethod
    def last_id(self, frame: str | bytes) -> str | None:
        """Return the id with which a frame ends that cannot be read; None: it ends otherwise."""

    @abstractmethod
    def decoding_octets(self, frame: str | bytes) -> int:
        """Return how many octets of a frame take time to read; quick to say."""

    @abstractmethod
    def reader(self, schema: Schema) -> Callable[[Message], Message] | None:
        """Return what turns a message as it was read into its logical value; None: nothing."""

    @abstractmethod
    def schema(self, schema: Schema) -> Schema:
        """Return the schema of messages in this form."""


@final
class _TextForm(Form):
    name, subprotocol, text = "json", "uoarm.v1.json", True

    def write(self, message: Message) -> bytes:
        return b"".join(write_text_parts(message, WRITTEN))

    def write_data(
        self, connection: str, number: int, message: Message, *, standing: bool = False
    ) -> bytes:
        head = f'{{"op":"Data","type":"{connection}","x-number":{number},'
        head += '"x-standing":true,"jsonMessage":' if standing else '"jsonMessage":'
        return b"".join((head.encode(), *write_text_parts(message, WRITTEN), b"}"))

    def list_of(self, parts: Sequence[bytes]) -> bytes:
        return b"[" + b",".join(parts) + b"]"

    def map_of(self, parts: Mapping[str, bytes]) -> bytes:
        pieces = [b"{"]
        for name, part in parts.items():
            pieces += (b"" if len(pieces) == 1 else b",", write_text(name), b":", part)
        return b"".join((*pieces, b"}"))

    def read(
        self, frame: str | bytes | bytearray, spending: BudgetUse, *, with_numpy: bool = False
    ) -> Mapping[str, Any]:
        del with_numpy  # lists are all that JSON has
        if not isinstance(frame, str):
            raise ControlMessageError(
                f"a binary frame: expected JSON text; offer {BINARY_FORM.subprotocol} for CBOR"
            )
        return _fields(read_text(frame, spending))

    def last_id(self, frame: str | bytes) -> str | None:
        return last_text_id(frame) if isinstance(frame, str) else None

    def decoding_octets(self, frame: str | bytes) -> int:
        return len(frame)

    def reader(self, schema: Schema) -> Callable[[Message], Message] | None:
        return make_reader(schema)

    def schema(self, schema: Schema) -> Schema:
        return text_schema(schema)


@final
class _BinaryForm(Form):
    name, subprotocol, text = "cbor", "uoarm.v1.cbor", False

    def write(self, message: Message) -> bytes:
        return write_binary(message)

    def write_data(
        self, connection: str, number: int, message: Message, *, standing: bool = False
    ) -> bytes:
        head = {"op": "Data", "type": connection, "x-number": number}
        head |= {"x-standing": True} if standing else {}
        return write_binary({**head, "jsonMessage": message})

    def list_of(self, parts: Sequence[bytes]) -> bytes:
        return join_list(parts)

    def map_of(self, parts: Mapping[str, bytes]) -> bytes:
        return join_map(parts)

    def read(
        self, frame: str | bytes | bytearray, spending: BudgetUse, *, with_numpy: bool = False
    ) -> Mapping[str, Any]:
        if isinstance(frame, str):
            raise ControlMessageError(
                f"a text frame: expected CBOR; offer {TEXT_FORM.subprotocol} for JSON"
            )
        return _fields(read_binary(frame, spending, with_numpy=with_numpy))

    def last_id(self, frame: str | bytes) -> str | None:
        return None if isinstance(frame, str) else last_id(frame)

    def decoding_octets(self, frame: str | bytes) -> int:
        return 0 if isinstance(frame, str) else decoding_octets(frame)

    def reader(self, schema: Schema) -> None:
        del schema

    def schema(self, schema: Schema) -> Schema:
        return schema


def _fields(value: Any) -> Mapping[str, Any]:
    if isinstance(value, dict):
        return value
    raise ControlMessageError(f"expected an object, got {type(value).__name__}")


def reply_to(asked: ControlMessage, message: Message) -> dict[str, Any]:
    """Return the fields of a Reply."""
    reply: dict[str, Any] = {"op": "Reply", "type": asked.type, "id": asked.id}
    if message is not None:
        reply["jsonMessage"] = message
    return reply


def reply_around(form: Form, asked: ControlMessage, written: bytes) -> bytes:
    """Return a Reply on the wire whose message is written already."""
    parts = {name: form.write(value) for name, value in reply_to(asked, None).items()}
    return form.map_of({**parts, "jsonMessage": written})


def write_or_error(form: Form, reply: Mapping[str, Any]) -> bytes:
    """Return an answer on the wire; where its message has no form, an Error that says so."""
    try:
        return form.write(reply)
    except MessageError as error:
        reports = {"code": "message", "text": str(error)}
        return form.write({**reply, "op": "Error", "jsonMessage": reports})


TEXT_FORM: Form = _TextForm()
BINARY_FORM: Form = _BinaryForm()
FORMS: Mapping[str, Form] = {form.subprotocol: form for form in (TEXT_FORM, BINARY_FORM)}


@cache
def protocol_schema() -> Mapping[str, Any]:
    """Return the JSON Schema of every message, `$defs` named `client.Op` and `server.Op`."""
    text = (files("uoarm._wire") / "protocol.schema.json").read_text(encoding="utf-8")
    schema: Mapping[str, Any] = json.loads(text)
    return schema


def check_asked(fields: Mapping[str, Any]) -> ControlMessage:
    """Return what was asked.

    Raises:
        ControlMessageError: it is not what the schema of its `op` describes; the text names the
            field.
    """
    op = fields.get("op")
    if op not in ASKED:
        raise ControlMessageError(_wrong_op(fields))
    if not _is_plain(op, fields):
        envelope = dict(fields)
        if op in {"Data", "Call"} and "jsonMessage" in envelope:
            envelope["jsonMessage"] = None  # any message is allowed: spare the walk through it
        if len(envelope) > _MAX_FIELDS or message_octets(envelope, most=_MAX_OCTETS) > _MAX_OCTETS:
            allowed = f"{_MAX_FIELDS} fields and {_MAX_OCTETS:,} octets are allowed"
            raise ControlMessageError(f"{op}: too much beside a message: {allowed}")
        reports = [
            ": ".join(
                filter(None, (".".join(map(str, error.absolute_path)), error.message[:_SHOWN]))
            )
            for error in islice(_validator(op).iter_errors(envelope), _MOST_REPORTED)
        ]
        if reports:
            raise ControlMessageError(f"{op}: {'; '.join(reports)}")
    return ControlMessage(
        op=Op(op),
        type=fields.get("type", ""),
        jsonMessage=fields.get("jsonMessage"),
        id=fields["id"],
        extensions={name: field for name, field in fields.items() if name.startswith("x-")},
    )


def salvage_id(fields: Mapping[str, Any]) -> str | None:
    """Return the id of a message that is wrong elsewhere, so that its error finds the asker."""
    identity = fields.get("id")
    return identity if isinstance(identity, str) and 0 < len(identity) <= _MAX_ID else None


def _is_plain(op: object, fields: Mapping[str, Any]) -> bool:
    """Say quickly whether a Data or Call message is right: they come by the thousand."""
    kind, further = fields.get("type"), fields.keys() - _QUICK
    return (
        len(fields) == len(_QUICK) + len(further)
        and isinstance(kind, str)
        and 0 < len(kind) <= _MAX_NAME
        and salvage_id(fields) is not None
        and all((check := _PLAIN.get((op, name))) and check(fields[name]) for name in further)
        and op in {"Data", "Call"}
    )


def _is_time(value: object) -> bool:
    return type(value) in {float, int}


def _is_limit(value: object) -> bool:
    return isinstance(value, int | float) and type(value) is not bool and value > 0


def _is_way(value: object) -> bool:
    return (
        isinstance(value, list)
        and 0 < len(value) <= _MOST_MANAGERS
        and all(isinstance(item, str) and _IDENTITY.fullmatch(item) for item in value)
    )


_PLAIN: Mapping[tuple[object, str], Callable[[object], bool]] = {
    ("Data", "x-sent"): _is_time,
    ("Call", "x-timeout"): _is_limit,
    ("Call", "x-managers"): _is_way,
}
"""Further fields of messages that are looked at quickly."""


def _wrong_op(fields: Mapping[str, Any]) -> str:
    expected = f"expected one of {', '.join(ASKED)}"
    if "op" not in fields:
        return f"op is missing; {expected}"
    op = fields["op"]
    if isinstance(op, str) and op in _OF_ROSBRIDGE:
        return f"op: {op!r} is of rosbridge, whose clients connect at /rosbridge; here {expected}"
    shown = repr(op[:60]) if isinstance(op, str) else type(op).__name__
    return f"op: {expected}, got {shown}{did_you_mean(op, ASKED)}"


@cache
def _validator(op: str) -> Validator:
    from jsonschema import Draft202012Validator  # noqa: PLC0415 - slow import
    from jsonschema.validators import extend  # noqa: PLC0415

    is_type = Draft202012Validator.TYPE_CHECKER.is_type

    def is_number(_: object, value: object) -> bool:
        # CBOR has NaN, which is within any bounds.
        is_nan = isinstance(value, float) and math.isnan(value)
        return is_type(value, "number") and not is_nan

    types = Draft202012Validator.TYPE_CHECKER.redefine("number", is_number)
    checking = extend(Draft202012Validator, type_checker=types)  # type: ignore[no-untyped-call]
    made: Validator = checking({**protocol_schema(), "$ref": f"#/$defs/client.{op}"})
    return made
