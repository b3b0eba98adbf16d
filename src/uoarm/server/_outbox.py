"""What waits to be written to one client: replies first, data in bounded queues."""

from __future__ import annotations

import asyncio
from collections import deque

from attrs import define, field

from uoarm.model import OverflowPolicy, QueuePolicy

__all__ = ["Lane", "Outbox"]


@define(eq=False)
class Lane:
    """The queue of one stream to one client.

    Attributes:
        policy: its length and whether only the newest counts; `block` is not for clients.
        text: whether its frames are text frames.
        dropped: messages that this client lost here.
        sent: messages that were handed to the socket.
        waiting: messages in their pieces, oldest first.
        waiting_bytes: of them all.
    """

    policy: QueuePolicy
    text: bool
    dropped: int = 0
    sent: int = 0
    waiting: deque[tuple[bytes, ...]] = field(factory=deque)
    waiting_bytes: int = 0

    @property
    def length(self) -> int:
        """Messages that may wait."""
        return 1 if self.policy.policy is OverflowPolicy.LATEST else self.policy.length


class Outbox:
    """Frames for one client, all in the loop's thread.

    A reply never waits behind data, save for the one frame that is being written. Streams take
    turns. When too much waits the oldest of the fullest stream is dropped and counted; replies
    are never dropped: with too many of them `overflowed` is set, and the client must be cut off.
    `dropped` counts the data messages that were lost here.

    Args:
        max_bytes: of all data that waits.
        max_replies: replies and events that may wait.
    """

    def __init__(self, max_bytes: int, max_replies: int) -> None:
        self._max_bytes = max_bytes
        self._max_replies = max_replies
        self._replies: deque[tuple[bytes, bool]] = deque()
        self._turns: deque[Lane] = deque()
        self._pieces: deque[tuple[bytes, bool]] = deque()
        self._bytes = 0
        self._reply_bytes = 0
        self._filled = asyncio.Event()
        self._emptied = asyncio.Event()
        self.overflowed = False
        self.dropped = 0

    @property
    def waiting_bytes(self) -> int:
        """Bytes that wait."""
        return self._bytes + self._reply_bytes

    @property
    def empty(self) -> bool:
        """Whether nothing waits."""
        return not (self._replies or self._turns or self._pieces)

    def tell(self, frame: bytes, *, text: bool) -> None:
        """Add a reply or an event."""
        if len(self._replies) >= self._max_replies or (
            self._replies and self._reply_bytes + len(frame) > self._max_bytes
        ):
            self.overflowed = True
        if not self.overflowed:
            self._replies.append((frame, text))
            self._reply_bytes += len(frame)
        self._filled.set()

    def holds(self, frame: bytes) -> bool:
        """Say whether a reply still waits."""
        return any(one is frame for one, _ in self._replies)

    def put(self, lane: Lane, *frames: bytes) -> None:
        """Add one data message of a stream, dropping older ones as its policy says.

        Several frames are the pieces of one message: sent one after the other, or dropped whole.
        """
        self._add(lane, frames)
        if len(lane.waiting) > lane.length:
            self._drop(lane)
        while self._bytes > self._max_bytes and self._drop_somewhere():
            pass

    def finish(self, lane: Lane, *frames: bytes) -> None:
        """Add the last message of a stream, after all that waits of it; it is never dropped."""
        self._add(lane, frames)

    def discard(self, lane: Lane) -> None:
        """Forget what waits of a stream that was killed."""
        while lane.waiting:
            self._take(lane)
        if lane in self._turns:
            self._turns.remove(lane)

    async def next(self) -> tuple[bytes, bool]:
        """Wait for the next frame; returns it and whether it is text."""
        while True:
            if self._replies:
                frame, text = self._replies.popleft()
                self._reply_bytes -= len(frame)
                return frame, text
            if self._pieces:
                return self._pieces.popleft()
            if self._turns:
                return self._next_data()
            self._filled.clear()
            self._emptied.set()
            await self._filled.wait()

    async def emptied(self) -> None:
        """Wait until nothing waits."""
        if not self.empty:
            self._emptied.clear()
            await self._emptied.wait()

    def _next_data(self) -> tuple[bytes, bool]:
        lane = self._turns.popleft()
        frames = self._take(lane)
        self._pieces.extend((piece, lane.text) for piece in frames[1:])
        lane.sent += 1
        if lane.waiting:
            self._turns.append(lane)
        return frames[0], lane.text

    def _drop(self, lane: Lane) -> None:
        self._take(lane)
        lane.dropped += 1
        self.dropped += 1

    def _drop_somewhere(self) -> bool:
        """Drop from the stream that holds most; the only message of a stream is always kept."""
        several = [lane for lane in self._turns if len(lane.waiting) > 1]
        if several:
            self._drop(max(several, key=lambda lane: lane.waiting_bytes))
        return bool(several)

    def _add(self, lane: Lane, frames: tuple[bytes, ...]) -> None:
        if not lane.waiting:
            self._turns.append(lane)
        lane.waiting.append(frames)
        size = sum(map(len, frames))
        lane.waiting_bytes += size
        self._bytes += size
        self._filled.set()

    def _take(self, lane: Lane) -> tuple[bytes, ...]:
        frames = lane.waiting.popleft()
        size = sum(map(len, frames))
        lane.waiting_bytes -= size
        self._bytes -= size
        return frames
