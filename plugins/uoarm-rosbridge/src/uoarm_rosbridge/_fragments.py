"""Messages in pieces: put together within limits, and taken apart."""

from __future__ import annotations

from collections.abc import Mapping
from sys import getsizeof
from typing import Any

import orjson
from attrs import define, field

from uoarm.errors import ControlMessageError

__all__ = ["Fragments", "fragment_size", "split"]

_UNFINISHED = 8
_PIECES = 100_000
_SMALLEST = 64
_PLACE = 100  # what one piece takes in a dictionary, and its number


@define
class _Message:
    total: int
    pieces: dict[int, str] = field(factory=dict)
    octets: int = 0


class Fragments:
    """The unfinished messages of one client.

    Args:
        most: octets of memory that all of them may take together.

    Attributes:
        octets: that they take.
    """

    def __init__(self, most: int) -> None:
        self.octets = 0
        self._most = most
        self._messages: dict[str, _Message] = {}

    def add(self, fields: Mapping[str, Any]) -> str | None:
        """Take one piece; returns the whole text with the last one.

        Raises:
            ControlMessageError: it fits no message, or too much is unfinished; what its message
                had until then is forgotten.
        """
        identity, data = str(fields["id"]), fields["data"]
        number, total = fields["num"], fields["total"]
        if not isinstance(data, str):
            raise ControlMessageError("fragment: data: expected text")
        if not (type(number) is int and type(total) is int and 0 <= number < total <= _PIECES):
            raise ControlMessageError("fragment: expected whole numbers num < total")
        message = self._messages.get(identity)
        if message is None:
            if len(self._messages) >= _UNFINISHED:
                self._forget(next(iter(self._messages)))
                raise ControlMessageError(f"fragment: {_UNFINISHED} messages are unfinished")
            message = self._messages[identity] = _Message(total)
        if message.total != total or number in message.pieces:
            self._forget(identity)
            raise ControlMessageError(f"fragment: piece {number} of {total} fits no message")
        message.pieces[number] = data
        octets = getsizeof(data) + _PLACE
        message.octets += octets
        self.octets += octets
        if self.octets > self._most:
            self._forget(identity)
            raise ControlMessageError(f"fragment: more than {self._most:,} octets wait")
        if len(message.pieces) < total:
            return None
        self._forget(identity)
        return "".join(message.pieces[place] for place in range(total))

    def _forget(self, identity: str) -> None:
        self.octets -= self._messages.pop(identity).octets


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
