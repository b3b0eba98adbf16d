"""Feeds: one function's messages, received once and handed to every client that asked for it."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol, TypeAlias, TypeVar

from attrs import define, field, frozen

from uoarm._control import Connection
from uoarm._dataplane import Clock, Outlet
from uoarm._raised import LimitedLog, contained, foreign
from uoarm._support.workers import WorkerExecutor
from uoarm._wire import is_octets
from uoarm.errors import MessageError
from uoarm.model import Message, ValidationMode, message_octets
from uoarm.server._limits import Limits
from uoarm.server.streams._workers import LoopMailbox

_FRESH = 16
_LATE_SECONDS = 0.1
_PATIENCE_SECONDS = 1.0


class FeedBacklog:
    """Distinguishes a backlog that stands from one that is being worked off.

    A loop that can just keep up never works off what came in its one longest delay, and everything
    after it is as late. So where what is looked at has been late, more than 0.1 s old, for as long
    as makes a second in all, it is to be let go of: then, and until nothing waits any more, all
    that is late, save the newest 16. A delay that ends within the second costs nothing.

    It knows no clock: times are seconds of one clock, and do not go back.
    """

    def __init__(self) -> None:
        self._late_since = math.inf
        self._stands = False

    def lets_go(self, waiting: int, came: float, now: float) -> bool:
        """Say whether to let go of the oldest message; to be asked about each before it is handed.

        Args:
            waiting: messages, with the oldest.
            came: when the oldest did.
            now: the time.
        """
        if waiting <= _FRESH:
            return False
        if now - came <= _LATE_SECONDS:
            self._late_since = math.inf
            return False
        self._late_since = min(self._late_since, came + _LATE_SECONDS)
        # What was found to stand stands until all of it is worked off: one message that is in time
        # between two late ones, as after a burst, must not begin the second anew.
        self._stands |= now - self._late_since >= _PATIENCE_SECONDS - _LATE_SECONDS
        return self._stands

    def worked_off(self) -> None:
        self._late_since = math.inf
        self._stands = False


T = TypeVar("T")
# A number takes at most some 0.5 us to write, and 256 octets less: so some 2 ms.
_QUICK = 4096
_OCTETS_SHIFT = 8
_SCALARS = frozenset({int, float, bool, type(None)})
_TEXTS = frozenset({str, bytes, bytearray, memoryview})


def takes_long(message: Message) -> bool:
    """Say whether a message takes more than some 2 ms to write in any form; quick to say.

    One of other values than messages have may: it is written where it holds up no client.
    """
    try:
        return _is_long(message)
    except BaseException as error:  # noqa: BLE001 - of its methods, or it changes meanwhile
        contained(error)
        return True


def _is_long(message: Message) -> bool:
    left = _QUICK
    waiting: list[Any] = [message]
    for item in waiting:
        kind = type(item)
        if kind in _SCALARS:
            continue
        if kind is dict or kind is list or kind is tuple:
            left -= len(item)
            if left >= 0:
                waiting += item.values() if kind is dict else item
        elif kind in _TEXTS:
            left -= len(item) >> _OCTETS_SHIFT
        elif is_octets(item):
            left -= memoryview(item).nbytes >> _OCTETS_SHIFT
        else:  # an array of numbers, of the standard library or of numpy
            left -= getattr(item, "size", 0) or (len(item) if hasattr(item, "__len__") else 0)
        if left < 0:
            return True
    return False


class Encoder:
    """One thread in which long messages are written.

    One, because writers hold the interpreter's lock: several would keep the loop waiting for it,
    and take memory for as many messages at a time.
    """

    def __init__(self) -> None:
        self._thread = WorkerExecutor("uoarm-encode", 1)
        self._closed = False

    def start(self, write: Callable[[], object]) -> asyncio.Future[object] | None:
        """Begin to write, from the loop's thread; None after `close`."""
        if self._closed:
            return None
        return asyncio.get_running_loop().run_in_executor(self._thread, write)

    def wait(self, message: Message, write: Callable[[], T]) -> T:
        """Return what `write` makes of a message, in a worker: it waits for its turn."""
        if self._closed or not takes_long(message):
            return write()
        return self._thread.submit(write).result()

    def close(self) -> None:
        """Begin with nothing more; does not wait for what is under way."""
        self._closed = True
        self._thread.shutdown(wait=False)


_log = logging.getLogger("uoarm.server")
_TURN_SECONDS = 0.001
_UNCOUNTED = 16  # messages: to count the octets of each would cost more than to hand it out


@frozen
class FeedKey:
    """What makes two requests the same feed.

    Attributes:
        name: function, or function.output.
        validate: how many messages are checked.
        receive: False where the client only sends.
    """

    name: str
    validate: ValidationMode = ValidationMode.SAMPLED
    receive: bool = True

    @property
    def function(self) -> str:
        """The function's name alone."""
        return self.name.partition(".")[0]


@define(eq=False)
class Envelope:
    """One message on its way to all clients; each form is written once.

    Attributes:
        number: counts the feed's messages from 1; a gap is a loss.
        message: the message as it came.
        octets: of memory that it holds, where that is known already.
        came: when, in seconds of the feed's clock.
        joiner: who alone gets it, since it stood when that one joined; None: it is for all.
        is_late: whether only those get it who want all.
        is_long: whether it takes long to write.
        forms: what was written of it, by form. A message that has none keeps its error: each client
            is refused, and it is tried once. The encoder's thread sets an entry, the loop reads it
            after the future of that is done.
        writing: what is being written beside the loop, by form.
    """

    number: int
    message: Message
    _octets: int | None = None
    came: float = 0.0
    joiner: Listener | None = None
    is_late: bool = field(default=False, init=False)
    is_long: bool = field(default=False, init=False)
    forms: dict[str, bytes | MessageError] = field(factory=dict, init=False)
    writing: dict[str, asyncio.Future[object]] = field(factory=dict, init=False)

    @property
    def message_octets(self) -> int:
        """Memory that the message holds, counted once."""
        if self._octets is None:
            self._octets = message_octets(self.message)
        return self._octets

    @property
    def octets(self) -> int:
        """Memory that the message and its written forms hold."""
        frames = (item for item in self.forms.values() if isinstance(item, bytes))
        return self.message_octets + sum(map(len, frames))

    def forget_written(self) -> None:
        """Let its written forms go; they are made again for the next client."""
        self.forms.clear()
        self.writing.clear()


Prepare: TypeAlias = Callable[[Envelope], "asyncio.Future[object] | None"]
"""Begins to write a message beside the loop for a listener; None: it need not wait for that."""


Missed: TypeAlias = Callable[[], None]
"""Counts a message as lost to a listener."""


class Listener(Protocol):
    """What a client has on a feed. Called in the loop's thread; must not wait."""

    def offer(self, envelope: Envelope) -> None:
        """Take one message."""

    def ended(self, state: str, cause: str) -> None:
        """Called once: no more will come, and why."""


@frozen
class _Place:
    """What the feed knows of a listener.

    Attributes:
        prepare: asked about each long message first.
        missed: called instead for what is late.
        first: the number of its first message; what stood before it gets apart.
    """

    prepare: Prepare | None
    missed: Missed | None
    first: int


@define(eq=False)
class Feed:
    """The messages of one open connection, fanned out in the loop's thread.

    In order: while a long message is being written for a client, those behind it wait for it.
    What `Backend.join` returns is open. Only the server calls `take` and `finish`.

    When the loop gets to its messages too late for longer than a second, late ones go only to those
    who want all; see `FeedBacklog`.

    Args:
        mailbox: the way into the loop.
        limits: of these, how many messages wait for the loop, and what memory they hold; with more
            the oldest are lost, as a gap in the numbers.
        encoder: writes long messages.

    Attributes:
        number: messages received so far.
        handed: the number of the last message that was handed out, or is being written for that.
        is_writing: whether the last of these is being written still.
        connection: the one whose messages these are; None until it is open.
        lost: messages lost before the loop got to them.
        end: state and cause, once no more will come.
    """

    _mailbox: LoopMailbox
    _limits: Limits
    encoder: Encoder
    _clock: Clock = time.monotonic
    _records: LimitedLog = field(factory=lambda: LimitedLog(_log), init=False)
    # The thread in which messages come appends and, to make room, takes from the left; the loop
    # takes from the left and, for a client that joins, puts back there. A deque allows both
    # without a lock: a side that finds it empty was overtaken by the other, which is no error
    # (`_next`, `_lose_oldest`).
    _waiting: deque[Envelope] = field(factory=deque, init=False)
    number: int = field(default=0, init=False)
    # Set with a request for a turn of the loop, cleared at the start of that turn, before
    # anything is taken: a message that comes after that asks again, so that none stays until
    # the next one.
    _pending: bool = field(default=False, init=False)
    is_writing: bool = field(default=False, init=False)
    _is_done: bool = field(default=False, init=False)
    _listeners: dict[Listener, _Place] = field(factory=dict, init=False)
    # Changed by the thread in which messages come; `add` copies it in the loop, in one step.
    _known: list[tuple[int, Message]] = field(
        factory=list, init=False
    )  # what may stand, with its number
    _most_known: int = field(default=0, init=False)
    handed: int = field(default=0, init=False)
    _listened_since: float = field(default=0.0, init=False)
    _backlog: FeedBacklog = field(factory=FeedBacklog, init=False)
    connection: Connection | None = field(default=None, init=False)
    lost: int = field(default=0, init=False)
    end: tuple[str, str] | None = field(default=None, init=False)

    @property
    def before_newcomer(self) -> int:
        """The number of the message before the first one of a listener that joins now."""
        with suppress(IndexError):  # the first one gets what waits, if anything does
            if not self._listeners:
                return max(self.handed, self._waiting[0].number - 1)
        return self.handed

    @property
    def outlet(self) -> Outlet | None:
        """Where its messages come from; None until the connection is open."""
        connection = self.connection
        return None if connection is None else connection._receiver.outlet  # noqa: SLF001 - of ours

    @property
    def is_latched(self) -> bool:
        """Whether who joins gets first what the output gave last."""
        return self.outlet is not None and self.outlet.retains is True

    def take(self, message: Message) -> None:
        """Take one message in the thread in which it came. Waits for nothing."""
        self.number += 1
        # Most outputs retain nothing: then there is nothing to remember.
        outlet = self.outlet
        if outlet is None or outlet.retains is not False:
            self._remember(self.number, message)
        elif self._known:  # it was being opened when these came
            self._known = []
        # Remembered before it can be handed out: a client that joins in between finds its number.
        self._waiting.append(Envelope(self.number, message, came=self._clock()))
        if len(self._waiting) > self._limits.feed_messages:
            self._lose_oldest()
        elif len(self._waiting) == _UNCOUNTED + 1 or (
            len(self._waiting) > _UNCOUNTED and self.number % _UNCOUNTED == 0
        ):
            # Octets are counted at every 16th message only, so at most 15 large ones exceed the
            # bound.
            self._bound_memory()
        if not self._pending:
            # Once for all messages until the loop comes: a wake-up costs more than a message.
            self._pending = True
            self._mailbox.put(self._hand_out)

    def _remember(self, number: int, message: Message) -> None:
        """Know the number of a message for as long as it stands, in the thread in which it came."""
        self._known.append((number, message))
        if len(self._known) <= self._most_known:
            return
        if self.connection is None:  # whether its output is latched is known once it is open
            if len(self._known) > self._limits.feed_messages:
                del self._known[0]
            return
        self._known = _of_those(self._known, self._standing())
        self._most_known = 2 * len(self._known)

    def _standing(self) -> tuple[Message, ...]:
        outlet = self.outlet
        return () if outlet is None else outlet.standing()

    def _bound_memory(self) -> None:
        """Lose the oldest until what waits holds no more than it may; what came last is kept."""
        # A copy, since the loop takes messages meanwhile.
        held = [envelope.message_octets for envelope in self._waiting.copy()]
        excess = sum(held) - self._limits.feed_bytes
        for octets in held[:-1]:
            if excess <= 0:
                return
            excess -= octets
            self._lose_oldest()

    def _lose_oldest(self) -> None:
        with suppress(IndexError):  # the loop has taken all since
            self._waiting.popleft()
            self.lost += 1

    def add(
        self,
        listener: Listener,
        prepare: Prepare | None = None,
        missed: Missed | None = None,
    ) -> None:
        """Hand messages to a listener from now on; to the first one what came before it, too.

        What stands at a latched output it gets first, each message with its own number.

        Args:
            listener: takes them.
            prepare: asked about each long message first; what it begins is waited for.
            missed: called instead for each message that comes to be late while the loop is busy,
                so that what is new is there sooner; None: the listener gets all.
        """
        if not self._listeners:
            # Before the place is made, with whose first number messages are compared.
            self._listened_since = self._clock()  # no client was late for what waited for the first
        self._listeners[listener] = _Place(prepare, missed, self.handed + 1)
        self._put_standing(listener)
        # A client that joins after the end gets the end, in this call: no other call follows.
        if self._is_done:
            assert self.end is not None, "only what has ended is done"
            self._end(listener, *self.end)
        elif self.end is not None:
            self._hand_all()
        elif self._waiting:
            self._schedule()

    def repeat(self, listener: Listener) -> None:
        """Hand a listener that was added what stands at a latched output once more."""
        self._put_standing(listener)
        if self._waiting and self.end is None:
            self._schedule()

    def _put_standing(self, listener: Listener) -> None:
        # From the newest to the oldest, each put before the others: they end in order, before all
        # that waits, and no client gets a latched message after a newer one.
        for number, message in reversed(_of_those(tuple(self._known), self._standing())):
            if number <= self.handed:  # others are on their way to all
                envelope = Envelope(number, message, came=self._clock(), joiner=listener)
                self._waiting.appendleft(envelope)

    def remove(self, listener: Listener) -> bool:
        """Hand a listener no more; True when it was the last one."""
        self._listeners.pop(listener, None)
        return not self._listeners

    def finish(self, state: str, cause: str) -> None:
        """Hand out what waits, then notify every listener of the end.

        At once, unless a long message is being written: then after it.
        """
        if self.end is not None:
            return
        # Set before what waits is handed out: a long message under way then goes on to the end
        # itself.
        self.end = (state, cause)
        if self._listeners:
            self._hand_all()

    def _schedule(self) -> None:
        if not self._pending:
            self._pending = True
            asyncio.get_running_loop().call_soon(self._hand_out)

    def _hand_out(self) -> None:
        """Hand out for a moment, then let writers and replies have their turn."""
        # Before anything is taken; see where it is made.
        self._pending = False
        if self.end is not None:
            self._hand_all()
            return
        end = time.perf_counter() + _TURN_SECONDS
        while self._hand_next() and self._waiting and time.perf_counter() < end:
            pass
        # Through the loop, not at once: sockets and replies that became ready have their turn
        # before.
        if self._waiting and self._can_hand():
            self._schedule()

    def _hand_all(self) -> None:
        """Hand out the last messages, then notify of the end."""
        while self._hand_next():
            pass
        if self.is_writing or self._is_done or not self._listeners:
            return
        assert self.end is not None, "nothing is the last before the end"
        # Before listeners are notified: one of them may remove itself or join another feed in
        # there.
        self._is_done = True
        for listener in tuple(self._listeners):
            self._end(listener, *self.end)

    def _can_hand(self) -> bool:
        return bool(self._waiting and self._listeners) and not self.is_writing

    def _hand_next(self) -> bool:
        """Hand out one message, or have it written first; False when none can be handed out."""
        envelope = self._next() if self._can_hand() else None
        if envelope is None:
            return False
        envelope.is_long = takes_long(envelope.message)
        if envelope.is_long and self._begin_writing(envelope):
            return False
        self._hand_one(envelope)
        return True

    def _begin_writing(self, envelope: Envelope) -> bool:
        """Have a long message written for those who get it; False where that need not be."""
        writing = [
            future
            for listener, place in self._takers(envelope)
            if place.prepare is not None
            and not (envelope.is_late and place.missed)
            and (future := self._prepared(listener, place.prepare, envelope)) is not None
        ]
        # Everything behind waits, also for clients of a form that is written: messages stay in
        # order.
        if writing:
            self.is_writing = True
            asyncio.gather(*writing).add_done_callback(lambda _: self._written(envelope))
        return bool(writing)

    def _next(self) -> Envelope | None:
        """Take the oldest message that waits, and settle who gets it."""
        waiting = len(self._waiting)
        try:
            envelope = self._waiting.popleft()
        except IndexError:  # it was lost since, to make room
            return None
        if envelope.joiner is not None:
            return envelope
        # From here on who joins does not get this one from what stands: it is on its way to all,
        # and would come twice.
        self.handed = envelope.number
        # What waited for the first client is not late for it.
        came = max(envelope.came, self._listened_since)
        envelope.is_late = self._backlog.lets_go(waiting, came, self._clock())
        if not self._waiting:
            self._backlog.worked_off()
        return envelope

    def _takers(self, envelope: Envelope) -> list[tuple[Listener, _Place]]:
        """Return whom a message is for, of those who are there now."""
        if envelope.joiner is None:
            places = self._listeners.items()
            return [
                (listener, place) for listener, place in places if envelope.number >= place.first
            ]
        place = self._listeners.get(envelope.joiner)
        return [] if place is None else [(envelope.joiner, place)]

    # In the loop, after the encoder's thread. The listeners are looked up again: some have gone.
    def _written(self, envelope: Envelope) -> None:
        self.is_writing = False
        self._hand_one(envelope)
        self._hand_out()

    def _hand_one(self, envelope: Envelope) -> None:
        for listener, place in self._takers(envelope):
            try:
                if envelope.is_late and place.missed is not None:
                    place.missed()
                else:
                    listener.offer(envelope)
            # As `foreign`, without its call for each message and listener.
            except BaseException as error:  # noqa: BLE001 - a listener may raise anything
                contained(error)
                self._drop(listener, error)

    def _prepared(
        self, listener: Listener, prepare: Prepare, envelope: Envelope
    ) -> asyncio.Future[object] | None:
        try:
            return prepare(envelope)
        except BaseException as error:  # noqa: BLE001 - a listener may raise anything
            contained(error)
            self._drop(listener, error)
            return None

    def _drop(self, listener: Listener, error: BaseException) -> None:
        """Hand a listener that fails nothing more, so that the others go on."""
        self._log_failure(listener, error)
        self._listeners.pop(listener, None)
        self._end(listener, "failed", "the server failed; its log says more")

    def _end(self, listener: Listener, state: str, cause: str) -> None:
        try:
            foreign(listener.ended, state, cause)
        except Exception as error:  # noqa: BLE001 - a listener of a front end may raise anything
            self._log_failure(listener, error)

    def _log_failure(self, listener: Listener, error: BaseException) -> None:
        self._records.write(logging.ERROR, f"a listener of {_module_of(listener)} failed", error)


def _of_those(
    known: Sequence[tuple[int, Message]], standing: Sequence[Message]
) -> list[tuple[int, Message]]:
    """Return of known messages those that stand, which are the very same objects, in order."""
    if not standing:
        return []
    numbers: dict[int, list[int]] = {}
    for number, message in known:
        numbers.setdefault(id(message), []).append(number)
    # An object may stand twice, as small integers do: from the newest one on.
    found = [
        (numbers[id(item)].pop(), item) for item in reversed(standing) if numbers.get(id(item))
    ]
    return found[::-1]


def _module_of(listener: Listener) -> str:
    module: str = getattr(listener, "module", type(listener).__module__)
    return module
