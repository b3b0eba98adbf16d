"""Outlets: where the messages of one open output fan out to its routes."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from uoarm._dataplane._failures import OutputWatch
from uoarm._dataplane._route import Route
from uoarm.model import Message, message_octets

_MOST_WRITERS = 1000
_MOST_OCTETS = 64 * 1024 * 1024
_DEPTH_WHILE_OPENING = 1000  # what the source keeps is known once it is open


class _Turn:
    """One route of an output that retains: it gets no message twice.

    The lock orders the thread that brings messages with one that joins: without it, what stands
    could overtake, or be overtaken by, what replaces it.

    Attributes:
        number: messages up to this one are not handed on live any more.
        joined: the last number before it came, while it was not known what stands.
    """

    __slots__ = ("joined", "lock", "number", "route")

    def __init__(self, route: Route) -> None:
        self.route = route
        self.number = 0
        self.joined = 0
        # Guards `number` and `joined`, and is held while the route takes a message: from the
        # threads of the source against `attach` and `letting_through`. Re-entrant, since a consumer
        # may emit at the same output in the thread in which it takes a message.
        self.lock = threading.RLock()

    def deliver(self, number: int, message: Message, *, is_copy: bool) -> None:
        with self.lock:
            # Numbers are given out under the outlet's lock, this one is taken later: two threads
            # may come here in the other order. The older message is left out, never delivered late.
            if number > self.number:
                self.number = number
                self.route.copies += is_copy
                self.route.deliver(message)


class _LastMessages:
    """The last messages of each writer, within bounds; the oldest go first.

    What one message of one writer holds is not counted: no more is kept than the newest message.
    """

    __slots__ = ("_by_writer", "_octets", "_uncounted", "depth", "messages")

    def __init__(self) -> None:
        self.depth = _DEPTH_WHILE_OPENING
        self.messages: dict[int, tuple[str, Message, int]] = {}
        self._by_writer: dict[str, deque[int]] = {}
        self._octets = 0
        # The number of a message that is not measured, as it stood alone so far: measuring walks
        # over a whole message, and most outputs that retain have one at a time.
        self._uncounted: int | None = None

    def add(self, number: int, message: Message, writer: str) -> None:
        numbers = self._by_writer.setdefault(writer, deque())
        numbers.append(number)
        self.messages[number] = writer, message, 0
        while len(numbers) > self.depth:
            self._remove(numbers.popleft())
        if len(self.messages) == 1:
            self._uncounted, self._octets = number, 0
            return
        # The first is measured only now, when there is a second to bound it with.
        for uncounted in (self._uncounted, number):
            if uncounted in self.messages:
                self._count(uncounted)
        self._uncounted = None
        while len(self.messages) > 1 and (
            self._octets > _MOST_OCTETS or len(self._by_writer) > _MOST_WRITERS
        ):
            oldest = next(iter(self.messages))  # a dict keeps the order in which they came
            of = self.messages[oldest][0]
            self._by_writer[of].popleft()
            if not self._by_writer[of]:
                del self._by_writer[of]
            self._remove(oldest)

    def limit(self, depth: int) -> None:
        self.depth = depth
        for numbers in self._by_writer.values():
            while len(numbers) > depth:
                self._remove(numbers.popleft())

    def let_go(self, writer: str) -> None:
        for number in self._by_writer.pop(writer, ()):
            self._remove(number)

    def newest_of(self, writer: str) -> int:
        return self._by_writer[writer][-1]

    def _count(self, number: int) -> None:
        writer, message, _ = self.messages[number]
        octets = message_octets(message)
        self.messages[number] = writer, message, octets
        self._octets += octets

    def _remove(self, number: int) -> None:
        self._octets -= self.messages.pop(number)[2]


_NOTHING_STANDS = _LastMessages()  # of all outputs that retain none, which add nothing to it


class Outlet:
    """The routes that one output feeds.

    `deliver` reads a tuple that `attach` and `detach` replace, so that it needs no lock. Only
    an output that retains, or of which that is not known yet, takes one for each message.

    Args:
        reader: what the output's component is judged by; None: nothing is.

    Attributes:
        undelivered: messages that came while no route was there.
        retains: whether the last messages are for those who join later; None while the source opens
            and that is not known.
    """

    __slots__ = (
        "_is_suspected",
        "_last",
        "_lock",
        "_reader",
        "_routes",
        "_standing",
        "_turns",
        "retains",
        "undelivered",
    )

    def __init__(self, reader: OutputWatch | None = None) -> None:
        self._reader = reader
        self._is_suspected = False  # written by the source alone, which has one thread at a time
        # Replaced as a whole and never changed, so that `deliver` reads it without a lock: a
        # message goes to the routes from before a change, or to those from after it, and to each
        # once.
        self._routes: tuple[Route, ...] = ()
        # Guards all that follows, and the replacing of `_routes`: from `attach` and `detach` in
        # threads of the manager against the source's. It is never held while a route takes a
        # message, which may block. Where a turn's lock is needed too, that one is taken first.
        self._lock = threading.Lock()
        # Read without the lock on the way of every message: once it is False it stays, and a
        # reader that saw None before looks again under the lock.
        self.retains: bool | None = None
        self._turns: dict[Route, _Turn] = {}
        self._last: tuple[int, Message] = 0, None
        self._standing = _LastMessages()
        self.undelivered = 0

    @property
    def routes(self) -> tuple[Route, ...]:
        return self._routes

    def retain(self, retains: bool, depth: int = 1) -> None:  # noqa: FBT001 - the source's answer
        """Say, once the source is open, whether the last messages are for those who join later.

        Until then they are kept, since a framework may hand them over while it opens.

        Args:
            retains: whether.
            depth: how many of each writer.
        """
        with self._lock:
            self.retains = retains
            if not retains:
                self._turns, self._last, self._standing = {}, (0, None), _NOTHING_STANDS
                return
            turns = tuple(self._turns.values())
            self._standing.limit(max(1, depth))
            standing = self._standing
            kept = [(n, standing.newest_of(w), m) for n, (w, m, _) in standing.messages.items()]
        # Outside of the lock, since turns come first in the order of locks, and routes may block.
        for turn in turns:
            with turn.lock:
                joined, turn.joined = turn.joined, 0
                for number, newest, message in kept:
                    # Of a writer of whom a later message was handed on, an earlier one is late.
                    if newest <= joined and number <= joined:
                        self._hand_standing(turn, number, message)

    def deliver(self, message: Message, writer: str = "") -> None:
        """Hand one message to every route. Never raises.

        Args:
            message: the message.
            writer: whose it is, where the last of several stand beside one another.
        """
        if self._is_suspected:
            self.readable()
        if self.retains is not False and self._deliver_kept(message, writer):
            return
        routes = self._routes  # read once: it may be replaced while a route takes the message
        for route in routes:
            route.deliver(message)
        for other in routes[1:]:
            other.copies += 1
        if not routes:
            self.undelivered += 1

    __call__ = deliver

    def let_go(self, writer: str = "") -> None:
        """Let nothing of a writer stand any more."""
        with self._lock:
            self._standing.let_go(writer)

    def unreadable(self, why: str) -> None:
        """Take in that a message came which cannot be read: it counts on every route."""
        if self._reader is not None:
            self._reader.unreadable(why)
            self._is_suspected = True
        for place, route in enumerate(self._routes):
            route.copies += place > 0
            route.unreadable(why)

    def readable(self) -> None:
        """Take in that something could be read, with or without a message of it."""
        if self._reader is not None and self._is_suspected:
            self._is_suspected = self._reader.read()

    def standing(self) -> tuple[Message, ...]:
        """Return what stands, oldest first; of a source that is being opened, what may."""
        if self.retains is False:
            return ()
        with self._lock:
            return tuple(message for _, message, _ in self._standing.messages.values())

    def _deliver_kept(self, message: Message, writer: str) -> bool:
        """Hand a message over and keep it; False where it turns out that none is retained."""
        with self._lock:
            if self.retains is False:  # said while this waited for the lock: no route has a turn
                return False
            number = self._last[0] + 1
            self._last = number, message
            self._standing.add(number, message, writer)
            turns = tuple(self._turns.values())
        # Without the lock: a slow route holds up its own turn only, and a consumer may emit here.
        for place, turn in enumerate(turns):
            turn.deliver(number, message, is_copy=place > 0)
        if not turns:
            self.undelivered += 1
        return True

    def attach(self, route: Route) -> None:
        """Feed a route from the next message on, and no more those that were closed meanwhile.

        An output that retains gives it what stands first, in this thread.

        A closed route counts what is lost as long as no route has taken its place; from the message
        on that another one gets, it would be counted twice.
        """
        turn = _Turn(route)
        # Its lock first: what comes from now on waits until it has what stood before.
        with turn.lock:
            with self._lock:
                kept = []
                for attached in self._routes:
                    if attached.closed:
                        self._turns.pop(attached, None)
                    else:
                        kept.append(attached)
                self._routes = (*kept, route)
                if self.retains is not False:
                    self._turns[route] = turn
                if not self.retains:
                    turn.joined = self._last[0]
                    return
                standing = tuple(self._standing.messages.items())
            # With the lock of the turn: a live message of a later number waits, or came before and
            # is in `standing` already.
            for number, (_, message, _) in standing:
                self._hand_standing(turn, number, message)

    @contextmanager
    def letting_through(self, route: Route) -> Iterator[None]:
        """Give a route, which dropped what came so far, what stands after the block.

        The block ends the dropping. Messages wait meanwhile, so that none comes twice.
        """
        turn = self._turns.get(route)
        if turn is None:
            yield
            return
        with turn.lock:
            yield
            if not self.retains:
                return
            with self._lock:
                # What came until now is in `standing` or is gone: a thread that still brings one
                # of these waits for the turn, and finds that its number is not above this one.
                turn.number = self._last[0]
                standing = tuple(self._standing.messages.items())
            for number, (_, message, _) in standing:
                self._hand_standing(turn, number, message)

    def detach(self, route: Route) -> None:
        """Feed a route no more; a message under way may still reach it."""
        with self._lock:
            self._routes = tuple(kept for kept in self._routes if kept is not route)
            self._turns.pop(route, None)

    def _hand_standing(self, turn: _Turn, number: int, message: Message) -> None:
        """Hand on what counts for another route already, or as undelivered, if it stands still."""
        # Read without the lock: one that goes as this looks was standing when the route joined.
        if number in self._standing.messages:
            turn.route.copies += 1
            turn.route.deliver(message)
