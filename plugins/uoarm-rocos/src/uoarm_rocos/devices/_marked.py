"""Frames of one size whose first octet alone has its highest bit set."""

from __future__ import annotations

__all__ = ["MARK", "MarkedFrames"]

MARK = 0x80


class MarkedFrames:
    """Finds frames by their mark; a frame that the next mark cuts short is thrown away.

    Args:
        size: octets of a frame.

    Attributes:
        discarded: octets that belonged to no frame.
    """

    def __init__(self, size: int) -> None:
        self.discarded = 0
        self._size = size
        self._frame = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that are complete with these octets."""
        found = []
        for octet in data:
            if octet & MARK:
                self.discarded += len(self._frame)
                self._frame = bytearray([octet])
            elif self._frame:
                self._frame.append(octet)
            else:
                self.discarded += 1
            if len(self._frame) == self._size:
                found.append(bytes(self._frame))
                self._frame = bytearray()
        return found
