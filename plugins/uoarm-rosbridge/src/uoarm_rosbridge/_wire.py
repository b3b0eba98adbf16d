"""rosbridge messages on the wire: read and checked, and written as its clients expect them.

Numbers follow rosbridge, not the native protocol: 64-bit integers are JSON numbers, and NaN and
the infinities are null. Octets are base64 in both.
"""

from __future__ import annotations

import json
import math
import re
import struct
import threading
import time
import zlib
from collections.abc import Mapping
from sys import getsizeof
from typing import Any

import orjson
from attrs import define, field
from pybase64 import b64encode

from uoarm.bridge import foreign, text_of
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import BudgetUse, Message, items_of, plain_copy, show_value
from uoarm.server.front_end import dump_parts, read_text, write_binary

_TEXTS = (
    "op", "topic", "type", "service", "action", "action_type", "level", "compression",
)  # fmt: skip
_COUNTS = ("throttle_rate", "queue_length", "fragment_size", "queue_size", "num", "total")
_MOST = 2**31 - 1
_MAX_TEXT = 1024
_MAX_NUMBER = 2**63
_NANOSECONDS = 1_000_000_000
_FIRST = 16  # fields that are looked at in what cannot be read
_HEAD = 16_384  # characters in which these are
_FIELD = re.compile(
    r'\s*[{,]\s*"(\w{1,40})"\s*:\s*("[^"\\\x00-\x1f]{0,1024}"|0|[1-9]\d{0,14})(?=\s*[,}])'
)


def read_operation(frame: str | bytes, spending: BudgetUse) -> dict[str, Any]:
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


def first_fields(frame: str | bytes) -> dict[str, Any]:
    """Return the fields with which a message begins that cannot be read: texts and numbers.

    Clients write `op`, `id` and the name of the service before the arguments.
    """
    fields: dict[str, Any] = {}
    place = 0
    for _ in range(_FIRST):
        found = _FIELD.match(frame, place) if isinstance(frame, str) else None
        if found is None:
            break
        fields[found[1]] = orjson.loads(found[2])
        place = found.end()
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
    timeout, result = fields.get("timeout"), fields.get("result")
    if timeout is not None and type(timeout) not in {int, float}:
        raise ControlMessageError(f"{op}: timeout: expected a number, got {show_value(timeout)}")
    if result is not None and type(result) is not bool:
        raise ControlMessageError(f"{op}: result: expected true or false, got {show_value(result)}")


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


def write_publish(topic: str, number: int, message: Message) -> bytes:
    """Return a publish message, which has no number; raises as `write_ros`."""
    del number
    head = b'{"op":"publish","topic":' + orjson.dumps(topic) + b',"msg":'
    return b"".join((head, *_write_parts(message), b"}"))


def write_publish_cbor(topic: str, number: int, message: Message) -> bytes:
    """Return a publish message in CBOR with typed arrays, as `compression: cbor` asks for."""
    del number
    return write_binary({"op": "publish", "topic": topic, "msg": message})


def _write_parts(message: Message) -> list[bytes]:
    try:
        return foreign(_written, message)
    except Exception as error:  # of a value's own methods, say
        raise MessageError(f"the message has no form as JSON text: {text_of(error)}") from error


def _written(message: Message) -> list[bytes]:
    try:
        return dump_parts(message, _write_other)[1]
    except (TypeError, ValueError):  # perhaps for a whole number beyond 64 bits, refused by orjson
        return dump_parts(plain_copy(message, _with_digits), _write_other)[1]


def _with_digits(value: Any) -> Any:
    """Return a whole number beyond 64 bits as it is written, anything else as it is."""
    if isinstance(value, int) and not -_MAX_NUMBER <= value < 2 * _MAX_NUMBER:
        return orjson.Fragment(str(value).encode())
    return value


def _write_other(value: Any) -> Any:
    if isinstance(value, Mapping):
        return items_of(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a value of type {type(value).__name__}")


_UNFINISHED = 8
_PIECES = 100_000
_SMALLEST = 64
_PLACE = 100  # what one piece takes in a dictionary, and its number


@define
class _Message:
    total: int
    begun: float
    pieces: dict[int, str] = field(factory=dict)
    octets: int = 0


class Fragments:
    """The unfinished messages of one client.

    Args:
        most: octets of memory that all of them may take together.
        seconds: in which a message is finished.

    Attributes:
        octets: that they take.
        last: the first fields of the message that `add` completed or forgot.
    """

    def __init__(self, most: int, seconds: float) -> None:
        self.octets = 0
        self.last: Mapping[str, Any] = {}
        self._most = most
        self._seconds = seconds
        self._messages: dict[str, _Message] = {}
        # Pieces come in the thread that decodes long frames; what is late is let go in the loop.
        self._lock = threading.Lock()

    def forget_late(self) -> dict[str, Mapping[str, Any]]:
        """Forget what was not finished in time; returns the first fields of each message."""
        with self._lock:
            due = time.monotonic() - self._seconds
            late = [name for name, message in self._messages.items() if message.begun <= due]
            return {name: self._forget(name) for name in late}

    def clear(self) -> list[Mapping[str, Any]]:
        """Forget all; returns the first fields of each."""
        with self._lock:
            return [self._forget(name) for name in tuple(self._messages)]

    def add(self, fields: Mapping[str, Any]) -> str | None:
        """Take one piece; returns the whole text with the last one.

        Raises:
            ControlMessageError: it fits no message, or too much is unfinished; what its message
                had until then is forgotten.
        """
        self.last = {}
        identity, data = str(fields["id"]), fields["data"]
        number, total = fields["num"], fields["total"]
        if not isinstance(data, str):
            raise ControlMessageError("fragment: data: expected text")
        if not (type(number) is int and type(total) is int and 0 <= number < total <= _PIECES):
            raise ControlMessageError("fragment: expected whole numbers num < total")
        with self._lock:
            return self._add(identity, data, number, total)

    def _add(self, identity: str, data: str, number: int, total: int) -> str | None:
        message = self._messages.get(identity)
        if message is None:
            if len(self._messages) >= _UNFINISHED:
                self.last = self._forget(next(iter(self._messages)))
                raise ControlMessageError(f"fragment: {_UNFINISHED} messages are unfinished")
            message = self._messages[identity] = _Message(total, time.monotonic())
        if message.total != total or number in message.pieces:
            self.last = self._forget(identity)
            raise ControlMessageError(f"fragment: piece {number} of {total} fits no message")
        message.pieces[number] = data
        octets = getsizeof(data) + _PLACE
        message.octets += octets
        self.octets += octets
        if self.octets > self._most:
            self.last = self._forget(identity)
            raise ControlMessageError(f"fragment: more than {self._most:,} octets wait")
        if len(message.pieces) < total:
            return None
        self.last = self._forget(identity)
        return "".join(message.pieces[place] for place in range(total))

    def _forget(self, identity: str) -> dict[str, Any]:
        message = self._messages.pop(identity)
        self.octets -= message.octets
        head, place = "", 0
        while len(head) < _HEAD and place in message.pieces:
            head, place = head + message.pieces[place], place + 1
        return first_fields(head)


def fragment_size(fields: Mapping[str, Any]) -> int:
    """Return the longest text of one frame that a client asks for; 0: any length."""
    size = int(fields.get("fragment_size") or 0)
    return max(size, _SMALLEST) if size else 0


def split(frame: bytes, size: int, identity: str) -> list[bytes]:
    """Return a frame as it is, or as fragments with at most `size` characters of it each."""
    if not size or len(frame) <= size:
        return [frame]
    text = frame.decode()
    pieces = [text[at : at + size] for at in range(0, len(text), size)]
    return [
        orjson.dumps(
            {"op": "fragment", "id": identity, "data": piece, "num": place, "total": len(pieces)}
        )
        for place, piece in enumerate(pieces)
    ]


_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_EIGHT_BITS, _RGB = 8, 2
_PIXEL = 3
_FASTEST = 1


def write_publish_png(topic: str, number: int, message: Message) -> bytes:
    """Return a png message that holds a publish message; raises as `write_publish`.

    Its text is ASCII: roslibjs makes a character of each octet.
    """
    text = write_publish(topic, number, message)
    if not text.isascii():
        text = json.dumps(json.loads(text)).encode()
    picture = _picture(text)
    return b'{"op":"png","data":"' + b64encode(picture) + b'"}'


def _picture(text: bytes) -> bytes:
    pixels = math.ceil(len(text) / _PIXEL)
    width = math.isqrt(pixels)
    height = math.ceil(pixels / width)
    stride = width * _PIXEL
    text = text.ljust(height * stride, b"\n")
    rows = b"".join(b"\0" + text[at : at + stride] for at in range(0, len(text), stride))
    head = struct.pack(">IIBBBBB", width, height, _EIGHT_BITS, _RGB, 0, 0, 0)
    parts = (b"IHDR", head), (b"IDAT", zlib.compress(rows, _FASTEST)), (b"IEND", b"")
    return _SIGNATURE + b"".join(_chunk(kind, data) for kind, data in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    check = zlib.crc32(data, zlib.crc32(kind))
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)
