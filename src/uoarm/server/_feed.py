"""Feeds: one function's messages, received once and handed to every client that asked for it."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from attrs import define, field

from uoarm._control import Connection
from uoarm.errors import MessageError
from uoarm.model import Message, message_octets
from uoarm.server._hop import Hop

__all__ = ["Feed", "Listener", "Parcel"]

_TURN_SECONDS = 0.001


@define(eq=False)
class Parcel:
    """One message on its way to all clients; each form is written once.

    Attributes:
        number: counts the feed's messages from 1; a gap is a loss.
        message: the message as it came.
        octets: of memory that it holds, where that is known already.
    """

    number: int
    message: Message
    _octets: int | None = None
    _written: dict[str, bytes] = field(factory=dict, init=False)

    def written(self, key: str, write: Callable[[int, Message], bytes]) -> bytes:
        """Return the message as `write` makes it, made once for each key.

        Raises:
            MessageError: it has no such form.
        """
        frame = self._written.get(key)
        if frame is None:
            frame = self._written[key] = write(self.number, self.message)
        return frame

    @property
    def message_octets(self) -> int:
        """Memory that the message holds, counted once."""
        if self._octets is None:
            self._octets = message_octets(self.message)
        return self._octets

    @property
    def octets(self) -> int:
        """Memory that the message and its written forms hold."""
        return self.message_octets + sum(map(len, self._written.values()))

    def forget_written(self) -> None:
        """Let its written forms go; they are made again for whoever comes."""
        self._written.clear()


class Listener(Protocol):
    """What a client has on a feed. Called in the loop's thread; must not wait."""

    def offer(self, parcel: Parcel) -> None:
        """Take one message; MessageError when it cannot be written."""

    def refuse(self, parcel: Parcel, error: MessageError) -> None:
        """Hear that a message could not be written."""

    def ended(self, state: str, cause: str) -> None:
        """Hear that no more will come, and why."""


class Feed:
    """The messages of one open connection, fanned out in the loop's thread.

    Args:
        hop: the way into the loop.
        limit: messages that wait for the loop; then the oldest is lost, as a gap in the numbers.
    """

    def __init__(self, hop: Hop, limit: int) -> None:
        self._hop = hop
        self._waiting: deque[Parcel] = deque(maxlen=limit)
        self._number = 0
        self._pending = False
        self._listeners: dict[Listener, None] = {}
        self.connection: Connection | None = None
        self.lost = 0
        self.end: tuple[str, str] | None = None

    @property
    def number(self) -> int:
        """Messages received so far."""
        return self._number

    def take(self, message: Message) -> None:
        """Take one message in the thread in which it came. Waits for nothing."""
        self._number += 1
        if len(self._waiting) == self._waiting.maxlen:
            self.lost += 1
        self._waiting.append(Parcel(self._number, message))
        if not self._pending:
            self._pending = True
            self._hop.put(self._hand_out)

    def add(self, listener: Listener) -> None:
        """Hand messages to a listener from now on; to the first one what came before it, too."""
        self._listeners[listener] = None
        if self.end is not None:
            self._hand_all()
            listener.ended(*self.end)
        elif self._waiting:
            self._schedule()

    def remove(self, listener: Listener) -> bool:
        """Hand a listener no more; True when it was the last one."""
        self._listeners.pop(listener, None)
        return not self._listeners

    def finish(self, state: str, cause: str) -> None:
        """Hand out what waits, then tell every listener that this was all."""
        if self.end is not None:
            return
        self.end = (state, cause)
        if self._listeners:
            self._hand_all()
        for listener in tuple(self._listeners):
            listener.ended(state, cause)

    def _schedule(self) -> None:
        if not self._pending:
            self._pending = True
            asyncio.get_running_loop().call_soon(self._hand_out)

    def _hand_out(self) -> None:
        """Hand out for a moment, then let writers and replies have their turn."""
        self._pending = False
        if not self._listeners:
            return
        end = time.perf_counter() + _TURN_SECONDS
        while self._waiting and time.perf_counter() < end:
            self._hand_one(self._waiting.popleft())
        if self._waiting:
            self._schedule()

    def _hand_all(self) -> None:
        while self._waiting:
            self._hand_one(self._waiting.popleft())

    def _hand_one(self, parcel: Parcel) -> None:
        for listener in tuple(self._listeners):
            try:
                listener.offer(parcel)
            except MessageError as error:
                listener.refuse(parcel, error)
