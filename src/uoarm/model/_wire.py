"""Model values to and from JSON-ready data, and control messages to and from the wire."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Mapping
from enum import Enum
from functools import cache
from typing import Any, TypeVar

import attrs
import cattrs

from uoarm.errors import ControlMessageError
from uoarm.model._control import ControlMessage, Op
from uoarm.model._structure import MessageStructure

__all__ = ["from_json", "read_control", "to_json", "write_control"]

T = TypeVar("T")

_FIELDS = ("op", "type", "jsonMessage", "id")
_MAX_BYTES = 1_048_576
_MAX_DEPTH = 64


def to_json(value: Any) -> Any:
    """Return a model value as dicts, lists, strings, numbers, booleans and None."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, MessageStructure):
        return {"schema": to_json(value.schema), "native_type": value.native_type}
    if attrs.has(type(value)):
        return {one.name: to_json(getattr(value, one.name)) for one in attrs.fields(type(value))}
    if isinstance(value, Mapping):
        return {str(key): to_json(one) for key, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_json(one) for one in value]
    return value


def from_json(data: Any, kind: type[T]) -> T:
    """Return the model value that `to_json` made data of.

    Raises:
        cattrs.BaseValidationError: the data is of another shape.
    """
    return _converter().structure(data, kind)


def read_control(text: str | bytes, *, max_bytes: int = _MAX_BYTES) -> ControlMessage:
    """Read a control message from JSON text.

    Fields whose names begin with `x-` are kept in `extensions`; any other unknown field is
    refused.

    Args:
        text: JSON, UTF-8 where it is bytes.
        max_bytes: refused when longer.

    Raises:
        ControlMessageError: it cannot be read; the text names the field.
    """
    if len(text) > max_bytes:
        raise ControlMessageError(f"{len(text):,} bytes; {max_bytes:,} are allowed")
    data = _parse(text)
    if not isinstance(data, dict):
        raise ControlMessageError(f"expected an object, got {type(data).__name__}")
    extensions = {name: one for name, one in data.items() if name.startswith("x-")}
    for name in data:
        if name not in _FIELDS and name not in extensions:
            close = difflib.get_close_matches(name, _FIELDS, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise ControlMessageError(f"unknown field {name!r}{hint}")
    identity = data.get("id")
    if identity is not None and not isinstance(identity, str):
        raise ControlMessageError(f"id: expected a string, got {identity!r}")
    return ControlMessage(
        op=_op(data), type=_type(data), jsonMessage=data.get("jsonMessage"), id=identity,
        extensions=extensions,
    )  # fmt: skip


def write_control(message: ControlMessage) -> dict[str, Any]:
    """Return a control message as it goes onto the wire; empty fields are left out."""
    wire: dict[str, Any] = {"op": message.op.value}
    if message.type:
        wire["type"] = message.type if isinstance(message.type, str) else list(message.type)
    if message.jsonMessage is not None:
        wire["jsonMessage"] = message.jsonMessage
    if message.id is not None:
        wire["id"] = message.id
    return {**wire, **message.extensions}


def _op(data: dict[str, Any]) -> Op:
    known = [op.value for op in Op]
    name = data.get("op")
    if name not in known:
        close = difflib.get_close_matches(str(name), known, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise ControlMessageError(f"op: expected one of {', '.join(known)}, got {name!r}{hint}")
    return Op(name)


def _type(data: dict[str, Any]) -> str | tuple[str, ...]:
    kind = data.get("type", "")
    if isinstance(kind, list) and all(isinstance(one, str) for one in kind):
        return tuple(kind)
    if not isinstance(kind, str):
        raise ControlMessageError(f"type: expected a string or a list of strings, got {kind!r}")
    return kind


def _parse(text: str | bytes) -> Any:
    _refuse_depth(text.decode("utf-8", "replace") if isinstance(text, bytes) else text)
    try:
        return json.loads(text, object_pairs_hook=_unique, parse_constant=_refuse_constant)
    except ControlMessageError:
        raise
    except (ValueError, RecursionError) as error:
        raise ControlMessageError(f"not JSON: {error}") from error


def _refuse_depth(text: str) -> None:
    if text.count("[") + text.count("{") <= _MAX_DEPTH:
        return
    depth, quoted, escaped = 0, False, False
    for char in text:
        if quoted:
            quoted = escaped or char != '"'
            escaped = char == "\\" and not escaped
        elif char == '"':
            quoted = True
        elif char in "[{":
            depth += 1
            if depth > _MAX_DEPTH:
                raise ControlMessageError(f"nested more than {_MAX_DEPTH} levels deep")
        elif char in "]}":
            depth -= 1


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ControlMessageError(f"the field {name!r} is given twice")
        if isinstance(value, float) and math.isinf(value):
            raise ControlMessageError(f"{name}: the number is too large")
        found[name] = value
    return found


def _refuse_constant(name: str) -> Any:
    raise ControlMessageError(f"{name} is not JSON")


@cache
def _converter() -> cattrs.Converter:
    converter = cattrs.Converter(forbid_extra_keys=True)
    converter.register_structure_hook_func(
        lambda kind: kind is object or kind is Any, lambda data, _: data
    )
    converter.register_structure_hook(
        MessageStructure,
        lambda data, _: MessageStructure(data["schema"], native_type=data["native_type"]),
    )
    converter.register_structure_hook_func(
        lambda kind: (
            getattr(kind, "__origin__", None) is not None
            and getattr(kind, "__args__", ()) == (str, object)
        ),
        lambda data, _: dict(data),
    )
    return converter
