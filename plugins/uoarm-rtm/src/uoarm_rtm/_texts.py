"""Strings on the wire: a length, the characters, and for narrow ones a closing zero.

Wide strings are UTF-16 with a byte order mark, as omniORB's GIOP 1.2 code sets write them.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct

from uoarm.model import Message
from uoarm_rtm._scalars import IdlMismatch, shown
from uoarm_rtm._shape import IdlString

__all__ = ["text_of", "wchar_of", "write_text", "write_wchar"]

_LAST_OF_PLANE = 0xFFFF
_BIG_MARK, _LITTLE_MARK = b"\xfe\xff", b"\xff\xfe"


def write_text(text: IdlString, order: str, encoding: str) -> Callable[[Message], bytes]:
    """Return the function that makes the bytes of a string, length included; it raises Misfit."""
    length = Struct(f"{order}I").pack
    bound, wide = text.bound, text.wide

    def write(value: Message) -> bytes:
        if not isinstance(value, str):
            raise IdlMismatch(f"expected a string, got {shown(value)}")
        if "\0" in value:
            raise IdlMismatch("a string cannot hold a zero character in CORBA")
        try:
            data = value.encode("utf-16-le" if wide else encoding)
        except UnicodeEncodeError as error:
            raise IdlMismatch(f"cannot be written as {error.encoding}: {shown(value)}") from error
        units = len(data) // 2 if wide else len(data)
        if bound is not None and units > bound:
            raise IdlMismatch(f"expected at most {bound} characters, got {units} (as {encoding})")
        if wide:
            data = _LITTLE_MARK + data if data else b""
            return length(len(data)) + data
        return length(len(data) + 1) + data + b"\0"

    return write


def text_of(data: bytes, text: IdlString, encoding: str) -> str:
    """Return the string in the bytes after the length; raises Misfit."""
    try:
        if text.wide:
            value = _wide(data)
        elif not data or data[-1] != 0 or 0 in data[:-1]:
            raise IdlMismatch("expected a string that ends with its only zero")
        else:
            value = data[:-1].decode(encoding)
    except UnicodeDecodeError as error:
        raise IdlMismatch(f"not a text in {error.encoding}: {shown(data)}") from error
    if text.bound is not None and len(value) > text.bound:
        raise IdlMismatch(f"expected at most {text.bound} characters, got {len(value)}")
    return value


def _wide(data: bytes) -> str:
    if data[:2] == _LITTLE_MARK:
        return data[2:].decode("utf-16-le")
    return data.removeprefix(_BIG_MARK).decode("utf-16-be")


def write_wchar(value: Message) -> bytes:
    """Return the three bytes of a wide character; raises Misfit."""
    if not isinstance(value, str) or len(value) != 1 or ord(value) > _LAST_OF_PLANE:
        raise IdlMismatch(f"expected one character of the basic plane, got {shown(value)}")
    try:
        return b"\x02" + value.encode("utf-16-be")
    except UnicodeEncodeError as error:
        raise IdlMismatch(f"cannot be written as {error.encoding}: {shown(value)}") from error


def wchar_of(data: bytes) -> str:
    """Return the wide character in three bytes; raises Misfit."""
    if data[0] != 2:  # noqa: PLR2004 - the length of one unit of UTF-16
        raise IdlMismatch(f"expected a wide character of 2 octets, got {data[0]}")
    try:
        return data[1:].decode("utf-16-be")
    except UnicodeDecodeError as error:
        raise IdlMismatch(f"not a character of UTF-16: {shown(data)}") from error
