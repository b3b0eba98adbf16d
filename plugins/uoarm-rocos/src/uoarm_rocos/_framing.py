"""Where one message ends on a stream of octets: a length over TCP, stuffing and CRC on a line."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
import zlib
from typing import Any, Protocol

from attrs import frozen
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser

from uoarm.errors import BridgeError, FailureReason


class WireError(BridgeError):
    """A frame or message breaks the protocol; the text says where and what was expected."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.BAD_MESSAGE)


class LineError(BridgeError):
    """The line is not there, was cut, or takes nothing any more; the cause is chained."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.UNAVAILABLE)


@frozen
class MessageLimits:
    """Bounds of one message, as section 7 of the profile has them.

    Attributes:
        octets: most octets of a message before framing.
        depth: most elements inside each other.
        elements: most elements in a message.
        attribute_octets: most octets of one attribute.
        attributes: most attributes of one element.
    """

    octets: int = 1_048_576
    depth: int = 32
    elements: int = 100_000
    attribute_octets: int = 1024
    attributes: int = 16


TCP_LIMITS = MessageLimits()
SERIAL_LIMITS = MessageLimits(octets=65_536)


def parse(data: bytes, limits: MessageLimits) -> ET.Element:
    """Parse one message.

    Raises:
        WireError: it is no XML, not UTF-8, has a DTD, or is beyond the limits.
    """
    if len(data) > limits.octets:
        raise WireError(f"a message has {len(data):,} octets, {limits.octets:,} are allowed")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise WireError(f"a message is not UTF-8: octet {error.start} of {len(data)}") from error
    if text.startswith("<?xml"):
        _check_declaration(text)
    parser = DefusedXMLParser(target=_Builder(limits), forbid_dtd=True)
    try:
        parser.feed(text)
        root = parser.close()
    except DefusedXmlException as error:
        raise WireError(f"a message holds a document type declaration: {error}") from error
    except (ET.ParseError, ValueError) as error:
        raise WireError(f"a message is no XML: {error}") from error
    assert isinstance(root, ET.Element)
    return root


def _check_declaration(text: str) -> None:
    declaration = text.partition("?>")[0].lower()
    if "encoding" in declaration and "utf-8" not in declaration:
        raise WireError(f"a message declares another encoding than UTF-8: {declaration[:60]!r}")


class _Builder(ET.TreeBuilder):
    """Counts while the tree grows, so that nothing beyond the limits is ever built."""

    def __init__(self, limits: MessageLimits) -> None:
        super().__init__()
        self._limits = limits
        self._depth = 0
        self._elements = 0

    def start(self, tag: Any, attributes: Any, /) -> ET.Element:
        limits = self._limits
        self._depth += 1
        self._elements += 1
        if self._depth > limits.depth:
            raise WireError(f"elements stand more than {limits.depth} deep inside each other")
        if self._elements > limits.elements:
            raise WireError(f"a message has more than {limits.elements:,} elements")
        if len(attributes) > limits.attributes:
            raise WireError(f"an element has more than {limits.attributes} attributes")
        for name, value in attributes.items():
            if max(len(name), len(value)) * 4 > limits.attribute_octets and (
                max(len(name.encode()), len(value.encode())) > limits.attribute_octets
            ):
                raise WireError(
                    f"attribute {name[:20]!r} has over {limits.attribute_octets} octets"
                )
        return super().start(tag, attributes)

    def end(self, tag: str, /) -> ET.Element:
        self._depth -= 1
        return super().end(tag)

    def pi(self, target: str, text: str | None = None, /) -> Any:
        del text
        raise WireError(f"a message holds a processing instruction <?{target[:20]}")


_FLAG = b"\x7e"
_ESCAPE = 0x7D
_STUFFED = re.compile(b"[\x7e\x7d\x11\x13]")
_ESCAPED = re.compile(b"\x7d(.?)", re.DOTALL)
_CRC = 4
_LENGTH = 4


class Framer(Protocol):
    """Makes frames of messages, and finds messages in what arrives. One for each line.

    Attributes:
        discarded: frames that were thrown away as damaged.
        resynchronises: whether a damaged frame harms only itself.
    """

    discarded: int
    resynchronises: bool

    def frame(self, message: bytes) -> bytes:
        """Return the octets to send for a message; any thread."""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that are complete with these octets; one thread.

        Raises:
            WireError: what arrives can never become a message again; the line must be dropped.
        """


class LengthFramer:
    """Four octets of length, most significant first, then the message."""

    resynchronises = False

    def __init__(self, limit: int = TCP_LIMITS.octets) -> None:
        self.discarded = 0
        self._limit = limit
        self._buffer = bytearray()

    def frame(self, message: bytes) -> bytes:
        """Return the octets to send for a message."""
        return len(message).to_bytes(_LENGTH, "big") + message

    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that are complete with these octets.

        Raises:
            WireError: a length is 0 or beyond the limit.
        """
        kept = self._buffer
        size = len(data) - _LENGTH
        if not kept and 0 < size <= self._limit and size == int.from_bytes(data[:_LENGTH], "big"):
            return [bytes(data[_LENGTH:])]  # most often: one message, and nothing else
        if kept:
            kept += data
        came = kept or data
        found, start, there = [], 0, len(came)
        while there - start >= _LENGTH:
            size = int.from_bytes(came[start : start + _LENGTH], "big")
            if not 0 < size <= self._limit:
                raise WireError(
                    f"a frame says it has {size:,} octets, expected 1 to {self._limit:,}: this is "
                    "not the profile over TCP, or the stream is damaged"
                )
            end = start + _LENGTH + size
            if there < end:
                break
            found.append(bytes(came[start + _LENGTH : end]))
            start = end
        if kept:
            del kept[:start]
        elif start < there:
            kept += data[start:]
        return found


class StuffedFramer:
    """Flags, byte stuffing and a CRC-32; finds the next frame after any garbage."""

    resynchronises = True

    def __init__(self, limit: int = SERIAL_LIMITS.octets) -> None:
        self.discarded = 0
        self._most = 2 * (limit + _CRC)
        self._buffer = bytearray()
        self._skipping = False

    def frame(self, message: bytes) -> bytes:
        """Return the octets to send for a message."""
        plain = message + zlib.crc32(message).to_bytes(_CRC, "big")
        stuffed = _STUFFED.sub(lambda item: bytes([_ESCAPE, item[0][0] ^ 0x20]), plain)
        return _FLAG + stuffed + _FLAG

    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that are complete with these octets; damaged ones are counted."""
        *ended, rest = data.split(_FLAG)
        found = []
        for part in ended:
            self._collect(part)
            message = self._take()
            if message is not None:
                found.append(message)
        self._collect(rest)
        return found

    def _collect(self, part: bytes) -> None:
        if self._skipping:
            return
        self._buffer += part
        if len(self._buffer) > self._most:
            self._buffer.clear()
            self._skipping = True

    def _take(self) -> bytes | None:
        stuffed = bytes(self._buffer)
        self._buffer.clear()
        skipped, self._skipping = self._skipping, False
        if not stuffed and not skipped:
            return None
        plain = _ESCAPED.sub(_unescape, stuffed)
        message, check = plain[:-_CRC], plain[-_CRC:]
        broken = skipped or not message or stuffed.endswith(b"\x7d")
        if broken or zlib.crc32(message).to_bytes(_CRC, "big") != check:
            self.discarded += 1
            return None
        return message


def _unescape(pair: re.Match[bytes]) -> bytes:
    return bytes([pair[1][0] ^ 0x20]) if pair[1] else b""
