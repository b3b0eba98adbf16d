"""Messages to octets and back: the part that a vendor's documents would replace."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any, Protocol

from uoarm_rocos._catalogue import (
    NAME,
    CallMessage,
    CatalogueMessage,
    CloseMessage,
    DataMessage,
    DescribeMessage,
    Direction,
    ErrorCode,
    ErrorMessage,
    HeartbeatMessage,
    OpenMessage,
    ResultMessage,
    WireMessage,
)
from uoarm_rocos._catalogue_xml import allowed, read_catalogue, write_catalogue
from uoarm_rocos._framing import MessageLimits, WireError, parse
from uoarm_rocos._values import (
    attribute,
    octets,
    read_real,
    read_values,
    read_whole,
    real,
    text,
    truth,
    write_values,
)

_ATTRIBUTES = 3
_ATTRIBUTE_OCTETS = 64  # of a name; times and counts are shorter
_REAL = r"[0-9.eE+\-]{1,30}|-?INF|NaN"
_HEAD = re.compile(
    rf'<(data|call|result) id="([0-9]{{1,10}})" seq="([0-9]{{1,10}})"'
    rf'(?: time="({_REAL})"| api="({NAME.pattern})")?>',
    re.ASCII,
)
_HEARTBEAT = re.compile(r'<heartbeat seq="([0-9]{1,10})"/>', re.ASCII)
# Text without what XML escapes, forbids or changes, such as line ends.
_VALUE = re.compile(
    rf'<(integer|number|string|boolean|octets)(?: name="({NAME.pattern})")?>'
    "([^<>&\x00-\x08\x0b-\x1f\ufffe\uffff]*)</\\1>"
    rf'|<(struct|list)(?: name="({NAME.pattern})")?>'
    "|</(struct|list)>"
)
_NUMBER, _NUMBER_END = "<number>", "</number>"
_READ: dict[str, Callable[[str], Any]] = {
    "integer": read_whole,
    "number": read_real,
    "string": str,
    "boolean": truth,
    "octets": octets,
}


class WrittenForm:
    """Reads messages that stand as the codec writes them. Any thread.

    Args:
        limits: what is, or may be, beyond them is not read here.
    """

    def __init__(self, limits: MessageLimits) -> None:
        self._limits = limits
        self._serves = (
            limits.attributes >= _ATTRIBUTES
            and limits.attribute_octets >= _ATTRIBUTE_OCTETS
            and min(limits.depth, limits.elements) > 1
        )

    def read(self, data: bytes) -> WireMessage | None:
        """Return the message of these octets, or None: another reader is to look at them."""
        if not self._serves or len(data) > self._limits.octets:
            return None
        try:
            text = data.decode("utf-8")
            head = _HEAD.match(text)
            if head is None:
                return _heartbeat(text)
            return self._message(text, head)
        except (WireError, UnicodeDecodeError):
            return None

    def _message(self, text: str, head: re.Match[str]) -> WireMessage | None:
        tag, identity, seq, time, api = head.groups()
        number, count = int(identity), int(seq)
        if not 0 < number <= _LARGEST or count > _LARGEST:
            return None
        values = self._values(text, head.end(), f"</{tag}>")
        if values is None:
            return None
        if tag == "data":
            if api is None:
                return DataMessage(count, number, values, None if time is None else read_real(time))
        elif time is None:
            if tag == "result" and api is None:
                return ResultMessage(count, number, values)
            if tag == "call" and api is not None:
                return CallMessage(count, number, api, values)
        return None

    def _values(self, text: str, start: int, end: str) -> dict[str, Any] | None:
        """Return the named values from a place to the end of the message."""
        match, read, left = _VALUE.match, _READ, self._limits.elements - 1
        values: dict[str, Any] = {}
        inside: dict[str, Any] | list[Any] = values
        outer: list[tuple[str, dict[str, Any] | list[Any]]] = []
        stop = len(text) - len(end)
        while start < stop:
            found = match(text, start, stop)
            if found is None:
                return None
            start = found.end()
            tag, name, written, opened, opened_name, closed = found.groups()
            if closed is not None:
                if not outer or outer[-1][0] != closed:
                    return None
                inside = outer.pop()[1]
                continue
            left -= 1
            value: Any
            if tag is not None:
                value = read[tag](written)
            elif opened == "struct":
                value, name = {}, opened_name
            else:
                value, name = [], opened_name
                end_of_list = text.find("</list>", start, stop)
                numbers = _numbers(text, start, end_of_list)
                if numbers:  # often many: read at once
                    value, start, left = numbers, end_of_list, left - len(numbers)
            if left < 0:
                return None
            if name is None:
                if not isinstance(inside, list):
                    return None
                inside.append(value)
            elif isinstance(inside, list) or name in inside:
                return None
            else:
                inside[name] = value
            if tag is None:
                outer.append((opened, inside))
                inside = value
                if len(outer) + 2 > self._limits.depth:
                    return None
        return values if not outer and start == stop and text.endswith(end) else None


def _numbers(text: str, start: int, end: int) -> list[float]:
    """Return the numbers from a place to the end of a list; nothing where others are in it."""
    if not text.startswith(_NUMBER, start) or not text.endswith(_NUMBER_END, start, end):
        return []
    parts = text[start + len(_NUMBER) : end - len(_NUMBER_END)].split(_NUMBER_END + _NUMBER)
    if text.count("<", start, end) != 2 * len(parts):
        return []
    return [read_real(written) for written in parts]


def _heartbeat(text: str) -> HeartbeatMessage | None:
    found = _HEARTBEAT.fullmatch(text)
    if found is None or int(found[1]) > _LARGEST:
        return None
    return HeartbeatMessage(int(found[1]))


_LARGEST = 2**32 - 1


class MessageCodec(Protocol):
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

    def __init__(self, limits: MessageLimits | None = None) -> None:
        self._limits = limits or MessageLimits()
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
        if len(root) and root.tag not in _HOLDING_ELEMENTS:
            inner = root[0].tag[:40]
            raise WireError(f"<{root.tag}> holds an element <{inner}>, expected none")
        return read(root, _count(root, "seq", 0))


def _write(message: WireMessage) -> str:
    seq = f'seq="{message.seq}"'
    if isinstance(message, HeartbeatMessage):
        return f"<heartbeat {seq}/>"
    head = f'id="{message.id}" {seq}'
    if isinstance(message, DataMessage):
        time = "" if message.time is None else f' time="{real(message.time)}"'
        return f"<data {head}{time}>{write_values(message.values)}</data>"
    if isinstance(message, CallMessage):
        return f'<call {head} api="{attribute(message.api)}">{write_values(message.values)}</call>'
    if isinstance(message, ResultMessage):
        return f"<result {head}>{write_values(message.values)}</result>"
    if isinstance(message, OpenMessage):
        way = message.direction.value
        return f'<open {head} api="{attribute(message.api)}" direction="{way}"/>'
    if isinstance(message, CloseMessage):
        return f"<close {head}/>"
    if isinstance(message, ErrorMessage):
        return f'<error {head} code="{message.code.value}">{text(message.text)}</error>'
    if isinstance(message, DescribeMessage):
        return f'<describe {head} profile="{message.profile}"/>'
    return write_catalogue(message.catalogue, f" {head}")


def _read_error(root: ET.Element, seq: int) -> ErrorMessage:
    codes = {code.value: code for code in ErrorCode}
    code = codes.get(root.get("code", ""))
    if code is None:
        raise WireError(f"<error>: unknown code {root.get('code', '')[:40]!r}")
    return ErrorMessage(seq, _count(root, "id", 0), code, root.text or "")


def _read_open(root: ET.Element, seq: int) -> OpenMessage:
    directions = {way.value: way for way in Direction}
    direction = directions.get(root.get("direction", ""))
    if direction is None:
        text = root.get("direction", "")[:40]
        raise WireError(f"<open>: direction must be input or output, got {text!r}")
    return OpenMessage(seq, _id(root), _api(root), direction)


def _read_data(root: ET.Element, seq: int) -> DataMessage:
    time = root.get("time")
    return DataMessage(seq, _id(root), read_values(root), None if time is None else read_real(time))


def _read_heartbeat(root: ET.Element, seq: int) -> HeartbeatMessage:
    allowed(root, {"seq"}, "message")
    return HeartbeatMessage(seq)


_HOLDING_ELEMENTS = {"data", "result", "call", "catalogue"}
_READERS: dict[str, tuple[set[str], Callable[[ET.Element, int], WireMessage]]] = {
    "data": ({"time"}, _read_data),
    "result": (set(), lambda root, seq: ResultMessage(seq, _id(root), read_values(root))),
    "call": ({"api"}, lambda root, seq: CallMessage(seq, _id(root), _api(root), read_values(root))),
    "open": ({"api", "direction"}, _read_open),
    "close": (set(), lambda root, seq: CloseMessage(seq, _id(root))),
    "error": ({"code"}, _read_error),
    "heartbeat": (set(), _read_heartbeat),
    "describe": (
        {"profile"},
        lambda root, seq: DescribeMessage(seq, _id(root), _count(root, "profile", 0)),
    ),
    "catalogue": (
        {"profile", "device", "revision", "heartbeat"},
        lambda root, seq: CatalogueMessage(seq, _id(root), read_catalogue(root)),
    ),
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
