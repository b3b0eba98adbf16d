"""rosbridge messages on the wire: read and checked, and written as its clients expect them.

Numbers follow rosbridge, not the native protocol: 64-bit integers are JSON numbers, and NaN and
the infinities are null. Octets are base64 in both.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import orjson

from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Message, Spending, show_value
from uoarm.server.front_end import dump_parts, read_text, write_binary

__all__ = [
    "check_fields",
    "clock_now",
    "identity_of",
    "read_operation",
    "write_publish",
    "write_publish_cbor",
    "write_ros",
]

_TEXTS = (
    "op", "topic", "type", "service", "action", "action_type", "level", "compression",
)  # fmt: skip
_COUNTS = ("throttle_rate", "queue_length", "fragment_size", "queue_size", "num", "total")
_MOST = 2**31 - 1
_MAX_TEXT = 1024
_MAX_NUMBER = 2**63
_NANOSECONDS = 1_000_000_000


def read_operation(frame: str | bytes, spending: Spending) -> dict[str, Any]:
    """Return the fields of a message.

    Raises:
        ControlMessageError: it is no JSON object in a text frame, or costs more than its budget.
    """
    if isinstance(frame, bytes):
        raise ControlMessageError("a binary frame: expected JSON text")
    fields = read_text(frame, spending)
    if not isinstance(fields, dict):
        raise ControlMessageError(f"expected an object, got {type(fields).__name__}")
    return fields


def check_fields(fields: Mapping[str, Any], needed: tuple[str, ...]) -> None:
    """Refuse a message that lacks a field or has one of another type.

    Raises:
        ControlMessageError: the text names the operation, the field and what was expected.
    """
    op = fields.get("op")
    for name in needed:
        if fields.get(name) is None:
            raise ControlMessageError(f"{op}: the field {name!r} is missing")
    if fields.get("id") is not None and identity_of(fields) is None:
        raise ControlMessageError(
            f"{op}: id: expected a number or a text of at most {_MAX_TEXT}, "
            f"got {show_value(fields['id'])}"
        )
    for name in _TEXTS:
        value = fields.get(name)
        if value is not None and not (isinstance(value, str) and len(value) <= _MAX_TEXT):
            raise ControlMessageError(f"{op}: {name}: expected a text of at most {_MAX_TEXT}")
    for name in _COUNTS:
        value = fields.get(name)
        if value is not None and not (type(value) in {int, float} and 0 <= value <= _MOST):
            raise ControlMessageError(
                f"{op}: {name}: expected a number from 0 on, got {show_value(value)}"
            )


def identity_of(fields: Mapping[str, Any]) -> str | float | None:
    """Return the id of a message, with which its answer goes back; None: it has none of use."""
    identity = fields.get("id")
    if isinstance(identity, str):
        return identity if len(identity) <= _MAX_TEXT else None
    if isinstance(identity, int | float):  # a truth value, too
        return identity if abs(identity) < _MAX_NUMBER else None
    return None


def clock_now() -> tuple[int, int]:
    """Return the seconds since the epoch and the nanoseconds beside them."""
    return divmod(time.time_ns(), _NANOSECONDS)


def write_ros(message: Message) -> bytes:
    """Return a message as rosbridge writes JSON.

    Raises:
        MessageError: a value in it has no form.
    """
    return b"".join(_write_parts(message))


def write_publish(topic: str, message: Message) -> bytes:
    """Return a publish message, the same bytes for every client; raises as `write_ros`."""
    head = b'{"op":"publish","topic":' + orjson.dumps(topic) + b',"msg":'
    return b"".join((head, *_write_parts(message), b"}"))


def write_publish_cbor(topic: str, message: Message) -> bytes:
    """Return a publish message in CBOR with typed arrays, as `compression: cbor` asks for."""
    return write_binary({"op": "publish", "topic": topic, "msg": message})


def _write_parts(message: Message) -> list[bytes]:
    try:
        return dump_parts(message, _write_other)[1]
    except (TypeError, ValueError):
        pass
    try:  # perhaps for a whole number beyond 64 bits, which orjson refuses
        return dump_parts(_with_digits(message), _write_other)[1]
    except (TypeError, ValueError, RecursionError) as error:
        raise MessageError(f"the message has no form as JSON text: {error}") from error


def _with_digits(value: Any) -> Any:
    """Return a copy in which each whole number beyond 64 bits is written already."""
    if isinstance(value, int) and not -_MAX_NUMBER <= value < 2 * _MAX_NUMBER:
        return orjson.Fragment(str(value).encode())
    if isinstance(value, Mapping):
        return {key: _with_digits(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_with_digits(item) for item in value]
    return value


def _write_other(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a value of type {type(value).__name__}")
