"""Where one message ends on a stream of octets: a length over TCP, stuffing and CRC on a line."""

from __future__ import annotations

import re
import zlib
from typing import Protocol

from uoarm_rocos._errors import WireError
from uoarm_rocos._parse import SERIAL_LIMITS, TCP_LIMITS

__all__ = ["Framer", "LengthFramer", "StuffedFramer"]

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
        if kept:
            kept += data
        came = kept or data  # most often the one message that is there: nothing is kept of it
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
