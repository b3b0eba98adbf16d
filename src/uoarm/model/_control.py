"""Control messages: what applications and the manager say to each other, and their wire form."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from enum import Enum
from typing import Any

from attrs import field, frozen

from uoarm._spelling import did_you_mean
from uoarm.errors import ControlMessageError
from uoarm.model._message import Message, Options
from uoarm.model._wire import Budget, BudgetUse, scan_json


class Op(Enum):
    """The operation of a control message, spelt as on the wire."""

    REQUEST = "Request"
    KILL = "Kill"
    DATA = "Data"
    CALL = "Call"
    REPLY = "Reply"
    STATUS = "Status"
    ERROR = "Error"
    LIST = "List"
    RESOLVE = "Resolve"
    RESUME = "Resume"
    CONFIGURE = "Configure"
    STOP = "Stop"
    DISCOVER = "Discover"
    APPROVE = "Approve"
    RECORD = "Record"
    PLAY = "Play"


@frozen
class ControlMessage:
    """One control message `{op, type, jsonMessage, id}`.

    Attributes:
        op: the operation.
        type: the function (client to manager), or the strings that a bridge needs to reach a
            component (manager to bridge).
        jsonMessage: the data, to or from the component.
        id: chosen by the caller; the answer carries the same one.
        extensions: fields whose names begin with `x-`; kept, never interpreted.
    """

    op: Op
    type: str | tuple[str, ...] = ""
    jsonMessage: Message = field(default=None, hash=False)  # noqa: N815 - the wire's spelling
    id: str | None = None
    extensions: Options = field(factory=dict, hash=False)


_FIELDS = ("op", "type", "jsonMessage", "id")
_EXTENSION = "x-"
_BUDGET = Budget(octets=1_048_576, elements=1_000_000)
_MAX_DIGITS = 1000
_SHOWN = 60
_SURROGATE = re.compile(r"[\ud800-\udfff]")


def read_control(
    data: str | bytes | Mapping[str, Any], *, max_bytes: int = _BUDGET.octets
) -> ControlMessage:
    """Read a control message from JSON text, or from what JSON text was parsed into.

    Fields whose names begin with `x-` are kept in `extensions`; any other unknown field is
    refused.

    Args:
        data: JSON text, in UTF-8 where it is bytes; or a mapping.
        max_bytes: text that is longer is refused before it is looked at.

    Raises:
        ControlMessageError: it cannot be read; the text names the field.
    """
    parsed = data if isinstance(data, Mapping) else _parse(_text(data, max_bytes))
    if not isinstance(parsed, Mapping):
        raise ControlMessageError(f"expected an object, got {_show(parsed)}")
    _check_values(parsed)
    for name in parsed:
        if name not in _FIELDS and not name.startswith(_EXTENSION):
            raise ControlMessageError(f"unknown field {_show(name)}{did_you_mean(name, _FIELDS)}")
    return ControlMessage(
        op=_op(parsed),
        type=_type(parsed),
        jsonMessage=parsed.get("jsonMessage"),
        id=_id(parsed),
        extensions={name: value for name, value in parsed.items() if name.startswith(_EXTENSION)},
    )


def write_control(message: ControlMessage) -> dict[str, Any]:
    """Return a control message as it goes onto the wire; empty fields are left out.

    Raises:
        ControlMessageError: the name of an extension does not begin with `x-`.
    """
    wire: dict[str, Any] = {"op": message.op.value}
    if message.type != "":
        wire["type"] = message.type if isinstance(message.type, str) else list(message.type)
    if message.jsonMessage is not None:
        wire["jsonMessage"] = message.jsonMessage
    if message.id is not None:
        wire["id"] = message.id
    for name, value in message.extensions.items():
        if not name.startswith(_EXTENSION):
            raise ControlMessageError(
                f"extensions: expected names that begin with x-, got {_show(name)}"
            )
        wire[name] = value
    return wire


def _text(data: str | bytes, max_bytes: int) -> str:
    size = len(data) if isinstance(data, bytes) or data.isascii() else _octets(data)
    if size > max_bytes:
        raise ControlMessageError(f"it has {size:,} bytes; {max_bytes:,} are allowed")
    if isinstance(data, str):
        return data
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ControlMessageError(
            f"not UTF-8: byte {error.start + 1:,} cannot be decoded"
        ) from error


def _octets(text: str) -> int:
    return len(text.encode("utf-8", "surrogatepass"))


def _parse(text: str) -> Any:
    scan_json(text, BudgetUse(_BUDGET))
    try:
        return json.loads(
            text,
            object_pairs_hook=_unique,
            parse_constant=_refuse_constant,
            parse_int=_integer,
        )
    except json.JSONDecodeError as error:
        raise ControlMessageError(
            f"not JSON: {error.msg} in line {error.lineno}, column {error.colno}"
        ) from error


def _check_values(parsed: Mapping[str, Any]) -> None:
    """Refuse what JSON text cannot hold, wherever it stands in the message."""
    waiting: list[tuple[Any, int]] = [(parsed, 1)]
    left = _BUDGET.elements
    while waiting:
        value, depth = waiting.pop()
        left -= 1
        if left < 0:
            raise ControlMessageError(f"it holds more than {_BUDGET.elements:,} values")
        if isinstance(value, str) and _SURROGATE.search(value):
            raise ControlMessageError("half of a surrogate pair cannot be sent as text")
        if isinstance(value, float) and not math.isfinite(value):
            raise ControlMessageError(f"{value} is not a number of JSON")
        if not isinstance(value, Mapping | list | tuple):
            continue
        if depth > _BUDGET.depth:
            raise ControlMessageError(f"nested more than {_BUDGET.depth} levels deep")
        if isinstance(value, Mapping):
            for name in value:
                if not isinstance(name, str):
                    raise ControlMessageError(f"expected names to be strings, got {_show(name)}")
                waiting.append((name, depth))
            waiting.extend((item, depth + 1) for item in value.values())
        else:
            waiting.extend((item, depth + 1) for item in value)


def _op(data: Mapping[str, Any]) -> Op:
    known = [op.value for op in Op]
    if "op" not in data:
        raise ControlMessageError(f"op is missing; expected one of {', '.join(known)}")
    name = data["op"]
    if name not in known:
        raise ControlMessageError(
            f"op: expected one of {', '.join(known)}, got {_show(name)}{did_you_mean(name, known)}"
        )
    return Op(name)


def _type(data: Mapping[str, Any]) -> str | tuple[str, ...]:
    kind = data.get("type", "")
    if isinstance(kind, list | tuple) and all(isinstance(item, str) for item in kind):
        return tuple(kind)
    if not isinstance(kind, str):
        raise ControlMessageError(
            f"type: expected a string or a list of strings, got {_show(kind)}"
        )
    return kind


def _id(data: Mapping[str, Any]) -> str | None:
    identity = data.get("id")
    if identity is not None and not isinstance(identity, str):
        raise ControlMessageError(f"id: expected a string, got {_show(identity)}")
    return identity


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        for name, _ in pairs:
            if name in seen:
                raise ControlMessageError(f"the field {_show(name)} is given twice")
            seen.add(name)
    return found


def _integer(text: str) -> int:
    if len(text) > _MAX_DIGITS:
        raise ControlMessageError(f"a number of {len(text):,} digits; {_MAX_DIGITS:,} are allowed")
    return int(text)


def _refuse_constant(name: str) -> Any:
    raise ControlMessageError(f"{name} is not a number of JSON")


def _show(value: object) -> str:
    if isinstance(value, str | int | float) or value is None:
        text = repr(value)
        return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    if isinstance(value, Mapping):
        return "an object"
    return "a list" if isinstance(value, list | tuple) else type(value).__name__
