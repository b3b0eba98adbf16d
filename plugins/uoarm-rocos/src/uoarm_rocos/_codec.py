"""Messages to octets and back: the part that a vendor's documents would replace."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Protocol

from uoarm_rocos._catalogue_xml import read_catalogue, write_catalogue
from uoarm_rocos._errors import WireError
from uoarm_rocos._field_xml import allowed
from uoarm_rocos._fields import NAME
from uoarm_rocos._limits import Limits
from uoarm_rocos._messages import (
    Call,
    CatalogueMessage,
    Close,
    Data,
    Describe,
    Direction,
    ErrorCode,
    ErrorMessage,
    Heartbeat,
    Open,
    Result,
    WireMessage,
)
from uoarm_rocos._parse import parse
from uoarm_rocos._values import (
    attribute,
    read_real,
    read_values,
    read_whole,
    real,
    text,
    write_values,
)
from uoarm_rocos._written_form import WrittenForm

__all__ = ["Codec", "XmlCodec"]

_LARGEST = 2**32 - 1


class Codec(Protocol):
    """Turns messages into octets and back. Does no I/O; may be used from any thread."""

    def write(self, message: WireMessage) -> bytes:
        """Return the octets of a message.

        Raises:
            WireError: the protocol cannot hold it.
        """

    def read(self, data: bytes) -> WireMessage:
        """Return the message of these octets.

        Raises:
            WireError: it is none.
        """


class XmlCodec:
    """The codec of the plain-XML profile."""

    def __init__(self, limits: Limits | None = None) -> None:
        self._limits = limits or Limits()
        self._written_form = WrittenForm(self._limits)

    def write(self, message: WireMessage) -> bytes:
        """Return the octets of a message.

        Raises:
            WireError: a value is none of the profile, or the message is beyond the limits.
        """
        data = _write(message).encode("utf-8")
        if len(data) > self._limits.octets:
            raise WireError(
                f"a {type(message).__name__} has {len(data):,} octets, "
                f"{self._limits.octets:,} are allowed on this line"
            )
        return data

    def read(self, data: bytes) -> WireMessage:
        """Return the message of these octets.

        Raises:
            WireError: it is no message of the profile, or beyond the limits.
        """
        return self._written_form.read(data) or self._read_any(data)

    def _read_any(self, data: bytes) -> WireMessage:
        """Read a message in any form that XML allows, or say what is wrong with it."""
        root = parse(data, self._limits)
        reader = _READERS.get(root.tag)
        if reader is None:
            raise WireError(f"<{root.tag[:40]}> is no message of the profile")
        names, read = reader
        allowed(root, names | {"seq", "id"}, "message")
        return read(root, _count(root, "seq", 0))


def _write(message: WireMessage) -> str:
    seq = f'seq="{message.seq}"'
    if isinstance(message, Heartbeat):
        return f"<heartbeat {seq}/>"
    head = f'id="{message.id}" {seq}'
    if isinstance(message, Data):
        time = "" if message.time is None else f' time="{real(message.time)}"'
        return f"<data {head}{time}>{write_values(message.values)}</data>"
    if isinstance(message, Call):
        return f'<call {head} api="{attribute(message.api)}">{write_values(message.values)}</call>'
    if isinstance(message, Result):
        return f"<result {head}>{write_values(message.values)}</result>"
    if isinstance(message, Open):
        way = message.direction.value
        return f'<open {head} api="{attribute(message.api)}" direction="{way}"/>'
    if isinstance(message, Close):
        return f"<close {head}/>"
    if isinstance(message, ErrorMessage):
        return f'<error {head} code="{message.code.value}">{text(message.text)}</error>'
    if isinstance(message, Describe):
        return f'<describe {head} profile="{message.profile}"/>'
    return write_catalogue(message.catalogue, f" {head}")


def _read_error(root: ET.Element, seq: int) -> ErrorMessage:
    codes = {code.value: code for code in ErrorCode}
    code = codes.get(root.get("code", ""))
    if code is None:
        raise WireError(f"<error>: unknown code {root.get('code', '')[:40]!r}")
    _empty(root)
    return ErrorMessage(seq, _count(root, "id", 0), code, root.text or "")


def _read_open(root: ET.Element, seq: int) -> Open:
    directions = {way.value: way for way in Direction}
    direction = directions.get(root.get("direction", ""))
    if direction is None:
        text = root.get("direction", "")[:40]
        raise WireError(f"<open>: direction must be input or output, got {text!r}")
    _empty(root)
    return Open(seq, _id(root), _api(root), direction)


def _read_data(root: ET.Element, seq: int) -> Data:
    time = root.get("time")
    return Data(seq, _id(root), read_values(root), None if time is None else read_real(time))


def _read_catalogue(root: ET.Element, seq: int) -> CatalogueMessage:
    return CatalogueMessage(seq, _id(root), read_catalogue(root))


def _read_describe(root: ET.Element, seq: int) -> Describe:
    _empty(root)
    return Describe(seq, _id(root), _count(root, "profile", 0))


def _read_heartbeat(root: ET.Element, seq: int) -> Heartbeat:
    allowed(root, {"seq"}, "message")
    _empty(root)
    return Heartbeat(seq)


def _read_close(root: ET.Element, seq: int) -> Close:
    _empty(root)
    return Close(seq, _id(root))


_READERS: dict[str, tuple[set[str], Callable[[ET.Element, int], WireMessage]]] = {
    "data": ({"time"}, _read_data),
    "result": (set(), lambda root, seq: Result(seq, _id(root), read_values(root))),
    "call": ({"api"}, lambda root, seq: Call(seq, _id(root), _api(root), read_values(root))),
    "open": ({"api", "direction"}, _read_open),
    "close": (set(), _read_close),
    "error": ({"code"}, _read_error),
    "heartbeat": (set(), _read_heartbeat),
    "describe": ({"profile"}, _read_describe),
    "catalogue": ({"profile", "device", "revision", "heartbeat"}, _read_catalogue),
}


def _id(root: ET.Element) -> int:
    return _count(root, "id", 1)


def _count(root: ET.Element, name: str, least: int) -> int:
    written = root.get(name)
    if written is None or not written.isdecimal():
        raise WireError(f"<{root.tag}>: expected {name} to be a count, got {str(written)[:40]!r}")
    number = read_whole(written)
    if not least <= number <= _LARGEST:
        raise WireError(f"<{root.tag}>: {name} must be {least} to {_LARGEST}, got {number}")
    return number


def _api(root: ET.Element) -> str:
    name = root.get("api", "")
    if not NAME.fullmatch(name):
        raise WireError(f"<{root.tag}>: {name[:40]!r} is no name of an API")
    return name


def _empty(root: ET.Element) -> None:
    if len(root):
        raise WireError(f"<{root.tag}> holds an element <{root[0].tag[:40]}>, expected none")
