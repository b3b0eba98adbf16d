"""Values to XML text and back: the tag of an element is the type of its value."""

from __future__ import annotations

import base64
import binascii
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from uoarm.bridge import foreign, text_of
from uoarm.model import elements_of, items_of
from uoarm_rocos._catalogue import NAME
from uoarm_rocos._framing import WireError

_WHOLE = re.compile(r"-?[0-9]{1,20}", re.ASCII)
_REAL = re.compile(r"-?[0-9]{1,400}(\.[0-9]{1,400})?([eE][+\-]?[0-9]{1,4})?", re.ASCII)
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_UNLIKE_ATTRIBUTE = re.compile('[&<"\x00-\x1f\ud800-\udfff\ufffe\uffff]')
_UNLIKE_XML = re.compile("[&<>\x00-\x08\x0b-\x1f\ud800-\udfff\ufffe\uffff]")
_SPECIAL = {"NaN": math.nan, "INF": math.inf, "-INF": -math.inf}
_TEXT = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", "\r": "&#13;"})
_ATTRIBUTE = str.maketrans(
    {"&": "&amp;", "<": "&lt;", '"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#9;"}
)
_SHOWN = 40
_LONGEST = 64  # name: what is longer is not kept, either
_DEPTH = 32
_TWENTY_DIGITS = 10**20


def text(value: str) -> str:
    """Escape text for the inside of an element.

    Raises:
        WireError: XML cannot hold one of its characters.
    """
    _check(value)
    return value.translate(_TEXT)


def attribute(value: str) -> str:
    """Escape text for an attribute in double quotes.

    Raises:
        WireError: XML cannot hold one of its characters.
    """
    if not _UNLIKE_ATTRIBUTE.search(value):
        return value
    _check(value)
    return value.translate(_ATTRIBUTE)


def real(value: float) -> str:
    """Write a float so that it is read back exactly."""
    if math.isfinite(value):
        return float.__repr__(value)
    return "NaN" if math.isnan(value) else ("INF" if value > 0 else "-INF")


def read_real(written: str) -> float:
    """Read what `real` writes.

    Raises:
        WireError: it is no number of the profile, or too large for a float.
    """
    if written in _SPECIAL:
        return _SPECIAL[written]
    if not _REAL.fullmatch(written):
        raise WireError(f"expected a decimal number, got {written[:_SHOWN]!r}")
    value = float(written)
    if math.isinf(value):
        raise WireError(f"{written[:_SHOWN]} is too large for a 64-bit float")
    return value


def read_whole(written: str) -> int:
    """Read an integer of at most 20 digits.

    Raises:
        WireError: it is none.
    """
    if not _WHOLE.fullmatch(written):
        raise WireError(f"expected a whole number of at most 20 digits, got {written[:_SHOWN]!r}")
    return int(written)


def truth(written: str) -> bool:
    """Read true or false.

    Raises:
        WireError: it is neither.
    """
    if written not in {"true", "false"}:
        raise WireError(f"<boolean>: expected true or false, got {written[:_SHOWN]!r}")
    return written == "true"


def octets(written: str) -> bytes:
    """Read octets from base64.

    Raises:
        WireError: it is none.
    """
    try:
        return base64.b64decode(written.encode("ascii"), validate=True)
    except (binascii.Error, UnicodeEncodeError) as error:
        raise WireError(f"not base64: {error}") from error


def write_values(values: Mapping[str, Any]) -> str:
    """Write named values.

    Raises:
        WireError: a name or value is none of the profile; the text names its path.
    """
    try:
        return foreign(_members, values, 1)
    except _UnwritableError as error:
        raise WireError(f"{error.path.lstrip('.') or 'message'}{error.text}") from error.__cause__
    except Exception as error:  # of a value that changes meanwhile, say
        raise WireError(f"message: {text_of(error)}") from error


def read_values(parent: ET.Element) -> dict[str, Any]:
    """Read the named values inside an element.

    Raises:
        WireError: one is missing its name, given twice, or not what its tag says.
    """
    _no_text(parent)
    found: dict[str, Any] = {}
    for element in parent:
        name = element.get("name")
        if name is None or not NAME.fullmatch(name):
            raise WireError(
                f"<{element.tag[:_SHOWN]}> in <{parent.tag}>: expected a name, got "
                f"{str(name)[:_SHOWN]!r}"
            )
        if len(element.attrib) > 1:
            _attributes(element, {"name"})
        if name in found:
            raise WireError(f"the value {name!r} is given twice in <{parent.tag}>")
        found[name] = _read(element)
    return found


def _check(value: str) -> None:
    wrong = _FORBIDDEN.search(value)
    if wrong:
        raise WireError(
            f"XML cannot hold the character U+{ord(wrong[0]):04X}, number {wrong.start()} of the "
            "text: leave it out, or use a field of octets"
        )


class _UnwritableError(Exception):
    """A value that is none of the profile; each container puts its step before the path."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text, self.path = text, ""


def _members(values: Mapping[Any, Any], depth: int) -> str:
    written = []
    for name, value in items_of(values).items():
        if not isinstance(name, str) or len(name) > _LONGEST or not (shown := _name(name)):
            raise _UnwritableError(f": {str(name)[:_SHOWN]!r} is no name of the profile")
        try:
            written.append(_write(shown, value, depth))
        except _UnwritableError as error:
            error.path = f".{name}{error.path}"
            raise
    return "".join(written)


@lru_cache(1024)
def _name(name: str) -> str:
    """Return the attribute of a name; nothing where it is none."""
    return f' name="{name}"' if NAME.fullmatch(name) else ""


def _write(name: str, value: Any, depth: int) -> str:
    if depth >= _DEPTH:
        raise _UnwritableError(f"...: values stand {_DEPTH} deep inside each other")
    if isinstance(value, str):
        value = str.__str__(value)  # without the methods of a subclass
        if not _UNLIKE_XML.search(value):
            return f"<string{name}>{value}</string>"
        return _odd_string(name, value)
    if isinstance(value, float):
        return f"<number{name}>{real(value)}</number>"
    if isinstance(value, bool):
        return f"<boolean{name}>{'true' if value else 'false'}</boolean>"
    if isinstance(value, int):
        value = int.__index__(value)
        if abs(value) >= _TWENTY_DIGITS:
            raise _UnwritableError(": an integer has more than 20 digits")
        return f"<integer{name}>{value}</integer>"
    if isinstance(value, list | tuple):
        value = elements_of(value)
        if value and depth + 1 < _DEPTH and all(type(item) is float for item in value):
            numbers = "</number><number>".join(map(real, value))
            return f"<list{name}><number>{numbers}</number></list>"
        items = list[str]()
        try:
            for item in value:
                items.append(_write("", item, depth + 1))
        except _UnwritableError as error:
            error.path = f"[{len(items)}]{error.path}"
            raise
        return f"<list{name}>{''.join(items)}</list>"
    if isinstance(value, bytes | bytearray | memoryview):
        return f"<octets{name}>{base64.b64encode(value).decode()}</octets>"
    if isinstance(value, Mapping):
        return f"<struct{name}>{_members(value, depth + 1)}</struct>"
    raise _UnwritableError(f": a {type(value).__name__} cannot be sent: {str(value)[:_SHOWN]}")


def _odd_string(name: str, value: str) -> str:
    """Write text escaped, or as base64 of its UTF-8 where XML cannot hold it."""
    if not _FORBIDDEN.search(value):
        return f"<string{name}>{value.translate(_TEXT)}</string>"
    try:
        octets = value.encode("utf-8")
    except UnicodeEncodeError as error:
        where = f"character {error.start} of the text"
        raise _UnwritableError(f": {where} is half of a surrogate pair") from error
    return f'<string{name} base64="true">{base64.b64encode(octets).decode()}</string>'


def _read(element: ET.Element) -> Any:
    tag = element.tag
    if tag == "struct":
        return read_values(element)
    if tag == "list":
        _no_text(element)
        for item in element:
            if item.attrib:
                _attributes(item, set())
        return [_read(item) for item in element]
    if len(element):
        raise WireError(f"<{tag[:_SHOWN]}> holds elements, expected text only")
    written = element.text or ""
    if tag == "integer":
        return read_whole(written)
    if tag == "number":
        return read_real(written)
    if tag == "string":
        return _unwrapped(written) if "base64" in element.attrib else written
    if tag == "boolean":
        return truth(written)
    if tag == "octets":
        return octets(written)
    raise WireError(f"<{tag[:_SHOWN]}> is no type of the profile")


def _unwrapped(written: str) -> str:
    try:
        return octets(written).decode("utf-8")
    except UnicodeDecodeError as error:
        raise WireError(f"<string base64>: not UTF-8: {error}") from error


def _attributes(element: ET.Element, names: set[str]) -> None:
    for name, value in element.attrib.items():
        wrapped = name == "base64" and value == "true" and element.tag == "string"
        if name not in names and not wrapped:
            shown = f"{name}={value[:_SHOWN]!r}"
            raise WireError(f"<{element.tag[:_SHOWN]}>: unexpected attribute {shown[:_SHOWN]}")


def _no_text(parent: ET.Element) -> None:
    stray = [parent.text, *(element.tail for element in parent)]
    for name in stray:
        if name and name.strip(" \t\r\n"):
            raise WireError(f"<{parent.tag[:_SHOWN]}>: text between elements: {name[:_SHOWN]!r}")
