"""Messages in the very form in which the codec writes them, read without an XML parser.

Most messages come in that form. What is read here is what the whole reader reads from the same
octets; any other form, and whatever is wrong, is left to it, so that it alone judges and says why.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from uoarm_rocos._errors import WireError
from uoarm_rocos._fields import NAME
from uoarm_rocos._limits import Limits
from uoarm_rocos._messages import Call, Data, Heartbeat, Result, WireMessage
from uoarm_rocos._values import octets, read_real, read_whole, truth

__all__ = ["WrittenForm"]

_LARGEST = 2**32 - 1
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

    def __init__(self, limits: Limits) -> None:
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
                return Data(count, number, values, None if time is None else read_real(time))
        elif time is None:
            if tag == "result" and api is None:
                return Result(count, number, values)
            if tag == "call" and api is not None:
                return Call(count, number, api, values)
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
            else:
                value, name = ({} if opened == "struct" else []), opened_name
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


def _heartbeat(text: str) -> Heartbeat | None:
    found = _HEARTBEAT.fullmatch(text)
    if found is None or int(found[1]) > _LARGEST:
        return None
    return Heartbeat(int(found[1]))
