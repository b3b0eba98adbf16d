"""Messages in pieces: put together within limits, and taken apart."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
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
    begun: float
    pieces: dict[int, str] = field(factory=dict)
    octets: int = 0


class Fragments:
    """The unfinished messages of one client.

    Args:
        most: octets of memory that all of them may take together.
        seconds: in which a message is finished.
        clock: monotonic seconds.

    Attributes:
        octets: that they take.
    """

    def __init__(
        self, most: int, seconds: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.octets = 0
        self._most = most
        self._seconds = seconds
        self._clock = clock
        self._messages: dict[str, _Message] = {}
        # Pieces come in the thread that decodes long frames; what is late is let go in the loop.
        self._lock = threading.Lock()

    def forget_late(self) -> list[str]:
        """Forget what was not finished in time; returns which messages these were."""
        with self._lock:
            due = self._clock() - self._seconds
            late = [name for name, message in self._messages.items() if message.begun <= due]
            for name in late:
                self._forget(name)
            return late

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._messages.clear()
            self.octets = 0

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
        with self._lock:
            return self._add(identity, data, number, total)

    def _add(self, identity: str, data: str, number: int, total: int) -> str | None:
        message = self._messages.get(identity)
        if message is None:
            if len(self._messages) >= _UNFINISHED:
                self._forget(next(iter(self._messages)))
                raise ControlMessageError(f"fragment: {_UNFINISHED} messages are unfinished")
            message = self._messages[identity] = _Message(total, self._clock())
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
