"""Messages in pieces: put together within limits, and taken apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import orjson
from attrs import define, field

from uoarm.errors import ControlMessageError

__all__ = ["Fragments", "fragment_size", "split"]

_UNFINISHED = 8
_PIECES = 100_000
_SMALLEST = 64


@define
class _Message:
    total: int
    pieces: dict[int, str] = field(factory=dict)
    size: int = 0


class Fragments:
    """The unfinished messages of one client.

    Args:
        most: characters that all of them may have together.
    """

    def __init__(self, most: int) -> None:
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
                oldest = next(iter(self._messages))
                del self._messages[oldest]
                raise ControlMessageError(f"fragment: {_UNFINISHED} messages are unfinished")
            message = self._messages[identity] = _Message(total)
        if message.total != total or number in message.pieces:
            del self._messages[identity]
            raise ControlMessageError(f"fragment: piece {number} of {total} fits no message")
        message.pieces[number] = data
        message.size += len(data)
        if sum(one.size for one in self._messages.values()) > self._most:
            del self._messages[identity]
            raise ControlMessageError(f"fragment: more than {self._most:,} characters wait")
        if len(message.pieces) < total:
            return None
        del self._messages[identity]
        return "".join(message.pieces[place] for place in range(total))


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
