"""What waits to be written to one client: replies first, data in bounded queues."""

from __future__ import annotations

import asyncio
import itertools
import math
import sys
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from heapq import heapify, heappop, heappush

from attrs import define, field

from uoarm._dataplane import Clock
from uoarm.errors import MessageError
from uoarm.model import OverflowPolicy, QueuePolicy
from uoarm.server.streams._memory import Account, Charge, MemoryUse, ServerMemory
from uoarm.server.streams._send_window import SendWindow

_FRESH = 16
_BEHIND_SECONDS = 0.25
_SPARE = 64


@define(eq=False)
class Lane:
    """The queue of one stream to one client.

    Attributes:
        policy: its length and whether only the newest counts; `block` is not for clients.
        text: whether what is added goes in text frames.
        length: messages that may wait.
        age: seconds after which a message that waits is dropped, where there are 16 newer ones: a
            client that reads too slowly gets what is new, and a few messages are never lost.
        wants_all: whether what is late already, since the server was busy, is for it, too.
        is_for_new: whether a client that reads too slowly is to get what is new rather than all.
        dropped: messages that this client lost here.
        sent: messages that were handed to the socket.
        waiting: when they came, messages in their pieces, and whether these go in text frames;
            oldest first.
        waiting_bytes: of them all.
        finished: whether its last message was added.
    """

    policy: QueuePolicy
    text: bool
    age: float = math.inf
    wants_all: bool = False
    dropped: int = 0
    sent: int = 0
    waiting: deque[tuple[float, tuple[bytes, ...], bool]] = field(factory=deque)
    waiting_bytes: int = 0
    finished: bool = False
    length: int = field(init=False)
    is_for_new: bool = field(init=False)
    _refusal: str = field(default="", init=False)

    def __attrs_post_init__(self) -> None:
        is_latest = self.policy.policy is OverflowPolicy.LATEST
        self.length = 1 if is_latest else self.policy.length
        self.is_for_new = is_latest or self.age < math.inf

    def is_stale(self, now: float, transit: float) -> bool:
        """Say whether the oldest message is too old, or will be after this many seconds more."""
        return len(self.waiting) > _FRESH and now + transit - self.waiting[0][0] > self.age

    def refuse(self, error: MessageError) -> bool:
        """Count a message that cannot be written as lost; True: the client is to be notified.

        Each reason is reported once, and again only after another one.
        """
        self.dropped += 1
        text, self._refusal = self._refusal, str(error)
        return text != self._refusal


class Outbox:
    """Frames for one client, all in the loop's thread.

    A reply never waits behind data, save for what is being written. Streams take
    turns, also between the pieces of a message: after each of them one message of another stream
    may pass. When too much waits the oldest of the fullest stream is dropped and counted, but not
    the only message of a stream as long as there is room for it. Replies and the last messages of
    streams are never dropped: with too many of them `overflowed` is set, and the client must be cut
    off.

    Args:
        max_bytes: of data that waits, and as much of what is never dropped; one message more may
            wait, so that one of any size can pass.
        max_replies: replies and events that may wait.
        account: of the client; None: one without bounds.
        clock: seconds.

    Attributes:
        dropped: data messages that were lost here.
        sent: frames that were handed to the socket.
        sent_bytes: of them all.
    """

    def __init__(
        self,
        max_bytes: int,
        max_replies: int,
        account: Account | None = None,
        clock: Clock = time.monotonic,
    ) -> None:
        self.max_bytes = max_bytes
        self._clock = clock
        self._max_replies = max_replies
        self.account = account or ServerMemory(sys.maxsize, sys.maxsize).open()
        self._replies_held = self.account.hold(MemoryUse.REPLIES)
        self._data_held = self.account.hold(MemoryUse.DATA)
        # Replies and events, before any data.
        self._replies: deque[tuple[bytes, bool]] = deque()
        # Streams with messages, the next one first: after its turn a stream goes to the end (round
        # robin). A stream is in it if and only if something of it waits.
        self._turns: OrderedDict[Lane, None] = OrderedDict()
        # Once a client holds too much: its streams, the one to drop from first. A stream has an
        # entry for each change, of which only the true ones count. None: to be made when needed.
        self._fullest: list[tuple[bool, int, int, Lane]] | None = None
        self._entries = itertools.count()
        # What is left of a message that is being sent in pieces: nothing of the same stream may
        # pass it.
        self._pieces: deque[tuple[bytes, bool]] = deque()
        self._in_pieces: Lane | None = None
        self._may_pass = False
        self._bytes = 0
        self._last_bytes = 0
        self._reply_bytes = 0
        # Handed to the socket, and held until the next frames are asked for: only then was it
        # written.
        self._written: dict[Charge, int] = {}
        # Wakes the writer: something was added, or the window has room again.
        self._filled = asyncio.Event()
        # Whether the writer waits for that and was not woken since. Only then may `_write` write:
        # else the writer may be within a write, or about to ask for frames.
        self._is_awaited = False
        # Whether `_write` could not go on: the writer is to come back, even if nothing waits.
        self._is_called = False
        # Whether `_flush` was asked for and did not run yet.
        self._is_due = False
        self._write: Callable[[], bool] | None = None
        self._soon: Callable[[Callable[[], None]], object] | None = None
        # Wakes who ends the connection when all is written.
        self._emptied = asyncio.Event()
        # Wakes a reply that waits for room.
        self._has_gone = asyncio.Event()
        self.overflowed = False
        self.dropped = self.sent = self.sent_bytes = 0
        self._window = SendWindow()
        self._waits_since = math.inf
        # Whether a message of a stream that wants the newest was sent: only then pings are worth
        # it.
        self._has_streamed = False

    def write_with(
        self,
        write: Callable[[], bool] | None,
        soon: Callable[[Callable[[], None]], object] | None,
    ) -> None:
        """Have what is added while the writer waits written without waking it, from now on.

        That saves a turn of the loop and of a task for each message that comes alone.

        Args:
            write: writes what `take` returns; says whether it did, with nothing left to wait for.
                Where not, the writer is woken. None: it always is.
            soon: runs an action in the loop, after what is added now.
        """
        self._write, self._soon = write, soon

    @property
    def waiting_bytes(self) -> int:
        """Bytes that wait."""
        return self._bytes + self._reply_bytes

    @property
    def empty(self) -> bool:
        """Whether nothing waits."""
        return not (self._replies or self._turns or self._pieces)

    def has_room(self, size: int) -> bool:
        """Say whether a reply of a size can be added."""
        waiting = self._reply_bytes + self._last_bytes
        return len(self._replies) < self._max_replies and (
            not waiting or waiting + size <= self.max_bytes
        )

    def reply(self, frame: bytes, *, text: bool, first: bool = False) -> None:
        """Add a reply or an event; `first` before all that wait."""
        # Replies are never dropped, so a client that lets too many wait can only be cut off; who
        # waits for room is woken to see that.
        if self.overflowed or not self.has_room(len(frame)):
            self.overflowed = True
            self._has_gone.set()
        else:
            if first:
                self._replies.appendleft((frame, text))
            else:
                self._replies.append((frame, text))
            self._reply_bytes += len(frame)
            self._replies_held.grow(len(frame))
        self._wake()

    async def room(self, size: int) -> None:
        """Wait until a reply of a size can be added: for one that the client did not size."""
        while not (self.overflowed or self.has_room(size)):
            self._has_gone.clear()
            await self._has_gone.wait()

    def holds(self, frame: bytes) -> bool:
        """Say whether a reply still waits."""
        return any(chunk is frame for chunk, _ in self._replies)

    def put(self, lane: Lane, *frames: bytes) -> None:
        """Add one data message of a stream, dropping older ones as its policy says.

        Several frames are the pieces of one message: sent in order, or dropped whole. What the
        stream has after it waits for the last of them.
        """
        # Added before others are dropped, so that the newest message is never the one that goes.
        has_room = self._add(lane, frames, lane.text)
        if len(lane.waiting) > lane.length:
            self._drop(lane)
        if len(lane.waiting) > _FRESH:
            self._drop_stale(lane)
        if self._bytes > self.max_bytes or not has_room:
            # Each turn drops one message or finds none to drop, so this ends.
            while self._is_over() and self._drop_somewhere():
                pass

    def miss(self, lane: Lane) -> None:
        """Count a message of a stream that was let go of before it came here."""
        lane.dropped += 1
        self.dropped += 1

    def finish(self, lane: Lane, *frames: bytes, text: bool | None = None) -> None:
        """Add the last message of a stream, after all that waits of it; it is never dropped.

        Args:
            lane: the stream.
            frames: the pieces of the message.
            text: whether it goes in text frames; None: as the others do.
        """
        size = sum(map(len, frames))
        if self.overflowed or not self.has_room(size):
            self.overflowed = True
            self._wake()
        else:
            # From now on its last message is counted apart, and `_drop_somewhere` leaves it alone.
            lane.finished = True
            self._last_bytes += size
            self._add(lane, frames, lane.text if text is None else text)

    @property
    def may_ping(self) -> bool:
        """Whether `begin_ping` may find one due, where nothing waits."""
        window = self._window
        return self._has_streamed and not (window.is_free and self._clock() < window.rests_until)

    def begin_ping(self) -> Callable[[], None] | None:
        """Begin a ping behind what was written, where one is due: return what takes its answer.

        None where none is due. Clients without streams that are to be new are sent none.
        """
        if not self._has_streamed:
            return None
        now, window = self._clock(), self._window
        is_behind = now - self._waits_since > _BEHIND_SECONDS and any(
            lane.is_for_new for lane in self._turns
        )
        rests = window.is_free and not is_behind and now < window.rests_until
        if rests or not window.wants_ping(now, is_behind=is_behind):
            return None
        window.asked(now)

        def answered() -> None:
            # The window of this ping, also where `renew` has put another one in its place: the
            # answer says nothing of the new socket.
            window.answered(self._clock())
            self._wake()  # there is room again

        return answered

    def unread_seconds(self) -> float:
        """Return for how long the client has not read what would make room for more."""
        now = self._clock()
        return self._window.silent(now) if self._window.is_full(now) else 0.0

    def renew(self) -> None:
        """Take what waits as new: its client was away, and came back for it on another socket."""
        # What was under way on the old socket is never acknowledged: its window would stay full.
        now, self._window = self._clock(), SendWindow()
        for lane in self._turns:
            lane.waiting = deque((now, frames, text) for _, frames, text in lane.waiting)

    def discard(self, lane: Lane) -> None:
        """Forget what waits of a stream that was killed."""
        while lane.waiting:
            self._forget(lane)
        # Keeps the invariant of `_turns`: `_take_frame` takes a message of the first in it.
        self._turns.pop(lane, None)

    async def next(self, octets: int = 1) -> list[tuple[bytes, bool]]:
        """Wait for frames to write, or until a ping is due; returns each and whether it is text.

        One, and those that wait behind it until they are this many octets together. Their memory
        counts as held until the next are asked for: then they have been written. None where the
        writer of `write_with` could not go on: something may have to be waited for, or a ping sent.
        """
        self.note_written()
        # Asked less of a free window, which is never full or stuck.
        while not self._is_called and not (
            self._replies or self._turns or self._pieces
            if self._window.is_free
            else self._may_go() or self._window.is_stuck(self._clock())
        ):
            # Cleared before the wait and after the look: what is added in between sets it, and
            # wakes.
            self._filled.clear()
            self._is_awaited = True
            try:
                await self._filled.wait()
            finally:
                self._is_awaited = False
        self._is_called = False
        return self.take(octets)

    def note_written(self) -> None:
        """Free the memory of the frames taken last: they have been written."""
        for held, size in self._written.items():
            held.grow(-size)
        self._written.clear()
        if self.empty:
            self._emptied.set()

    def take(self, octets: int) -> list[tuple[bytes, bool]]:
        """Return what may be written now, as `next` does; none where nothing may."""
        frames: list[tuple[bytes, bool]] = []
        while octets > 0 and self._may_go():
            frame = self._take_frame()
            size = len(frame[0])
            octets -= size
            # Counted as under way when it is handed to the socket: a ping behind it covers it.
            self._window.sent += size
            self.sent_bytes += size
            frames.append(frame)
        self.sent += len(frames)
        if not self._turns:
            self._waits_since = math.inf
        return frames

    async def emptied(self) -> None:
        """Wait until nothing waits."""
        if not self.empty:
            self._emptied.clear()
            await self._emptied.wait()

    def _wake(self) -> None:
        """Have what was added written: after what is added in this turn of the loop."""
        if self._write is None or self._soon is None:
            self._filled.set()
        elif self._is_awaited and not self._is_due:
            self._is_due = True
            self._soon(self._flush)

    def _flush(self) -> None:
        self._is_due = False
        if not self._is_awaited:  # it was woken since, and looks at what waits by itself
            return
        if self._window.is_free and self._write is not None:
            if self._write():
                return
            self._is_called = True
        self._is_awaited = False
        self._filled.set()

    def _may_go(self) -> bool:
        if self._replies or not (self._turns or self._pieces):
            return bool(self._replies)
        return self._window.is_free or not self._window.is_full(self._clock())

    def _take_frame(self) -> tuple[bytes, bool]:
        held = self._data_held
        if self._replies:
            frame, text = self._replies.popleft()
            self._reply_bytes -= len(frame)
            self._has_gone.set()
            held = self._replies_held
        else:
            # Between the pieces of a long message one short one of another stream passes, then a
            # piece again: neither stops the other.
            passing = self._passing() if self._pieces and self._may_pass else None
            if passing is not None:
                self._begin_message(passing)
            elif not self._pieces:
                self._in_pieces = next(iter(self._turns))
                self._begin_message(self._in_pieces)
            frame, text = self._pieces.popleft()
            self._may_pass = passing is None
        self._written[held] = self._written.get(held, 0) + len(frame)
        return frame, text

    def _passing(self) -> Lane | None:
        """Return the stream whose next message, in one piece, goes between those of another's."""
        for lane in itertools.islice(self._turns, 2):  # one of them at most is in pieces itself
            if lane is not self._in_pieces:
                if len(lane.waiting) > _FRESH:
                    self._drop_stale(lane)
                return lane if len(lane.waiting[0][1]) == 1 else None
        return None

    def _begin_message(self, lane: Lane) -> None:
        del self._turns[lane]
        if len(lane.waiting) > _FRESH:
            self._drop_stale(lane)
        text = lane.waiting[0][2]
        for piece in reversed(self._take(lane)):
            self._pieces.appendleft((piece, text))
        lane.sent += 1
        # Noted at the first message that leaves: before that there is nothing a ping could measure.
        self._has_streamed |= lane.is_for_new
        if lane.waiting:
            self._turns[lane] = None

    def _drop(self, lane: Lane) -> None:
        self._forget(lane)
        self.miss(lane)

    def _drop_stale(self, lane: Lane) -> None:
        now = self._clock()
        transit = self._window.transit(now)
        while lane.is_stale(now, transit):
            self._drop(lane)

    def _is_over(self) -> bool:
        return self._bytes > self.max_bytes or not self.account.has_room(0)

    def _drop_somewhere(self) -> bool:
        """Drop from the stream that holds most; the only message of a stream as the last resort.

        The largest of these is always kept.
        """
        largest = self._take_fullest()
        if largest is None:
            return False
        if len(largest.waiting) > 1:
            self._drop(largest)
            return True
        # Every stream has one message. The largest stays: a picture that alone exceeds the bound
        # passes once those before it are written, instead of never.
        kept, lane = [largest], None
        if self._bytes - largest.waiting_bytes > self.max_bytes or not self.account.has_room(0):
            while (lane := self._take_fullest()) is largest or (lane and lane.finished):
                kept.append(lane)
        if lane is not None:
            # That was its only message: the invariant of `_turns`.
            self._drop(lane)
            del self._turns[lane]
        for other in kept:
            self._rank(other)
        return lane is not None

    def _take_fullest(self) -> Lane | None:
        """Take the stream out of the heap that holds most, one with a single message as the last.

        There may be thousands, of a client that reads too slowly: each message that comes for it
        costs the loop as much as one among few.
        """
        if self._fullest is None:
            self._fullest = [self._entry(lane) for lane in self._turns]
            heapify(self._fullest)
        while self._fullest:
            entry = heappop(self._fullest)
            lane = entry[-1]
            if lane.waiting and entry[:2] == self._entry(lane)[:2]:
                return lane
        return None

    def _rank(self, lane: Lane) -> None:
        """Keep the invariant of `_fullest`: a stream of which something waits has a true entry."""
        if self._fullest is None or not lane.waiting:
            return
        if len(self._fullest) > 2 * len(self._turns) + _SPARE:
            self._fullest = None
        else:
            heappush(self._fullest, self._entry(lane))

    def _entry(self, lane: Lane) -> tuple[bool, int, int, Lane]:
        # The number is another one for each, so that no two streams are compared.
        return len(lane.waiting) == 1, -lane.waiting_bytes, next(self._entries), lane

    def _add(self, lane: Lane, frames: tuple[bytes, ...], text: bool) -> bool:  # noqa: FBT001
        """Add a message; say whether the client holds no more than it may."""
        # Keeps the invariant of `_turns`.
        self._turns.setdefault(lane)
        now = self._clock()
        self._waits_since = min(self._waits_since, now)
        lane.waiting.append((now, frames, text))
        size = sum(map(len, frames))
        lane.waiting_bytes += size
        self._bytes += size
        self._rank(lane)
        self._wake()
        return self._data_held.grow(size)

    def _take(self, lane: Lane) -> tuple[bytes, ...]:
        """Take the oldest message of a stream; its memory is still held."""
        _, frames, _ = lane.waiting.popleft()
        size = sum(map(len, frames))
        lane.waiting_bytes -= size
        self._bytes -= size
        self._rank(lane)
        if lane.finished and not lane.waiting:
            self._last_bytes -= size
            self._has_gone.set()
        return frames

    def _forget(self, lane: Lane) -> None:
        self._data_held.grow(-sum(map(len, self._take(lane))))
