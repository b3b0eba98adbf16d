"""One client's subscription: the way of a feed's messages from the fan-out to the outbox."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol, TypeAlias

from attrs import frozen

from uoarm._dataplane import Clock
from uoarm._raised import contained, text_of
from uoarm.errors import MessageError
from uoarm.model import Message, QueuePolicy
from uoarm.server._limits import Limits
from uoarm.server.streams._feed import Envelope, Feed, FeedKey
from uoarm.server.streams._memory import Account, Charge, MemoryUse
from uoarm.server.streams._outbox import Lane, Outbox
from uoarm.server.streams._pending_feeds import OnAbsent

_AGAIN_SECONDS = 1.0
_MOST_OCTETS = 2**30  # of a message as it is held: more than is ever written of one

Write: TypeAlias = Callable[[int, Message], bytes]
"""Makes the form of a message that has a number."""


class Subscriber(Protocol):
    """The client of a subscription."""

    @property
    def outbox(self) -> Outbox:
        """What waits to be written to it."""

    @property
    def account(self) -> Account:
        """Of the memory that is held for it."""

    @property
    def limits(self) -> Limits:
        """What it may use."""


class FeedSource(Protocol):
    """Where feeds are opened."""

    async def join(self, wanted: FeedKey, on_absent: OnAbsent | None = None) -> Feed:
        """Return an open feed; with `on_absent`, wait for what cannot be had yet."""

    def leave(self, feed: Feed) -> None:
        """Give a feed back."""


@frozen
class MessageForm:
    """How the messages of a subscription are written.

    Attributes:
        key: what has the same key must write the same, and is written once for all.
        write: makes the form; may be called in another thread.
        text: whether it goes into text frames.
        write_standing: makes the form of what stood at a latched output; None: the same.
        frames: makes of the form, and the number of a message, what goes to this client; several
            frames are sent, or dropped, together. None: the form itself.
    """

    key: str
    write: Write
    text: bool
    write_standing: Write | None = None
    frames: Callable[[bytes, int], Sequence[bytes]] | None = None


class Throttle:
    """Says which messages to pass on, so that as many a second pass as are asked for; no clock.

    Args:
        every: least seconds between two messages; 0: all pass.
        is_even: each is due one period after the last one was due, not after it came: of a source
            of 12 a second 10 pass, and not every other one. What is left out is made up for by no
            burst: one that was slower than a period begins anew.
    """

    def __init__(self, every: float, *, is_even: bool) -> None:
        self.every = every
        self.due = -math.inf
        self._is_even = is_even

    def set_period(self, every: float, now: float) -> None:
        """Let messages pass at another rate from now on."""
        self.every = every
        self.due = min(self.due, now + every)

    def is_due(self, now: float) -> bool:
        """Say whether a message that comes now passes."""
        return now >= self.due

    def take(self, now: float) -> None:
        """Count one that passes."""
        late = now - self.due if self._is_even else 0.0
        self.due = now + self.every - (late if late < self.every else 0.0)


class Subscription:
    """Hands the messages of a feed to one client, in the loop's thread.

    A long message is written beside the loop. Messages come from a feed, see `begin` and `follow`,
    or from who calls `offer`.

    Args:
        form: in which messages are written.
        lane: the client's queue for these messages; None: as long as its limits allow, and for what
            is new.
        throttle: which messages pass.
        on_refused: called once for each reason for which a message could not be written.
        on_end: called when no more will come, with state and cause.

    Attributes:
        lane: the queue, with what was sent and lost.
        feed: where messages come from; None while there is none.
        module: whose code it calls, for the log.
        skipped: messages that were left out, since fewer are asked for.
    """

    def __init__(
        self,
        client: Subscriber,
        form: MessageForm,
        *,
        lane: Lane | None = None,
        throttle: Throttle | None = None,
        clock: Clock = time.monotonic,
        on_refused: Callable[[MessageError], None],
        on_end: Callable[[str, str], None],
    ) -> None:
        limits = client.limits
        queue = QueuePolicy(limits.queue_messages)
        self.lane = lane or Lane(queue, form.text, limits.queue_seconds)
        self.feed: Feed | None = None
        self.module = on_end.__module__
        self.skipped = 0
        self._outbox = client.outbox
        self._account = client.account
        self._form = form
        self._throttle = throttle or Throttle(0.0, is_even=True)
        self._clock = clock
        self._on_refused = on_refused
        self._on_end = on_end
        # What waits until it is due, where the client asked for that; the newest so many of it.
        self._held: deque[Envelope] = deque()
        self._most_held = 0
        self._charge: Charge | None = None  # for what is held, from the first of it on
        self._timer: asyncio.TimerHandle | None = None
        self._source: FeedSource | None = None
        self._opening: asyncio.Task[None] | None = None
        self._reopen: Callable[[str], None] | None = None
        self._warned = ""

    def begin(self, feed: Feed) -> None:
        """Let the messages of an open feed come, first those that wait; its owner leaves it."""
        # Before it is added: a feed that has ended hands all over in that call, and the messages
        # are numbered by it.
        self.feed = feed
        feed.add(self, self.prepare, None if self.lane.wants_all else self.miss)

    def follow(
        self,
        source: FeedSource,
        wanted: FeedKey,
        *,
        on_open: Callable[[Feed], None] = lambda _: None,
        on_waiting: Callable[[str], None],
        on_failed: Callable[[BaseException], None],
    ) -> None:
        """Join a feed, and again each time its provider has failed, until `close`.

        Args:
            source: where it is opened.
            wanted: the feed.
            on_open: called with the feed before its first message; may refuse it.
            on_waiting: called with why there are no messages for now, with each reason once.
            on_failed: called with why there will be none.
        """
        self._source = source

        def say(text: str) -> None:
            if text != self._warned:
                self._warned = text
                on_waiting(f"{text}; it is waited for")

        async def join(pause: float) -> None:
            try:
                await asyncio.sleep(pause)
                feed = self.feed = await source.join(
                    wanted, lambda cause: say(f"unavailable: {cause}")
                )
                # Over before `on_open`, which may close this: the task must not cancel itself.
                self._opening = None
                on_open(feed)
            except Exception as error:  # noqa: BLE001 - given to who follows
                # Given back before it is reported: who follows may ask for it anew in there.
                self._opening = None
                self._leave()
                on_failed(error)
            else:
                self.begin(feed)

        def reopen(cause: str) -> None:
            say(f"has failed: {cause}")
            self._opening = asyncio.ensure_future(join(_AGAIN_SECONDS))

        self._reopen = reopen
        self._opening = asyncio.ensure_future(join(0.0))

    def set_form(self, form: MessageForm) -> None:
        """Write messages in another form from now on; what waits to be sent keeps its own."""
        self._form = form
        self.lane.text = form.text

    def repeat(self) -> None:
        """Send again what stands at the feed, if it is latched and open."""
        if self.feed is not None:
            self.feed.repeat(self)

    def set_rate(self, every: float, most_held: int) -> None:
        """Let messages pass at another rate, and keep so many of the others until they are due."""
        now = self._clock()
        self._throttle.set_period(every, now)
        self._most_held = most_held
        if self._timer is not None:
            # The timer is of the old rate: with the new one, what is held may be due sooner.
            self._timer.cancel()
            self._timer = None
            self._set_timer(now)

    def prepare(self, envelope: Envelope) -> asyncio.Future[object] | None:
        """Have a long message written beside the loop; None where it need not be waited for.

        The future never fails: what went wrong is known when the message is offered.
        """
        # What would be left out, or held, is not written: it may never be sent.
        is_wanted = envelope.joiner is not None or (
            not self._held and self._throttle.is_due(self._clock())
        )
        form = self._form
        if not is_wanted or form.key in envelope.forms or self.feed is None:
            return None
        # Kept, so that clients of the same form wait for one writing, not one each.
        future = envelope.writing.get(form.key)
        if future is None:
            future = self.feed.encoder.start(lambda: self._written(envelope, form))
            if future is not None:
                envelope.writing[form.key] = future
        return future

    @property
    def number(self) -> int:
        """The number of the last message that was sent, lost, or waits here; as its client has it.

        Those that are left out are not counted, so that a gap is what was lost.
        """
        return 0 if self.feed is None else self.feed.handed - self.skipped

    def offer(self, envelope: Envelope) -> None:
        """Take one message: to the client, to be held until it is due, or nowhere."""
        # What is held goes first also where the rate was set to all: messages stay in order. What
        # stood before its client joined is no part of the rate.
        is_throttled = self._throttle.every or self._held
        if not is_throttled or envelope.joiner is not None or self._passes(envelope):
            self._send(envelope)

    def miss(self) -> None:
        """Count a message that was let go of before it came here."""
        self._outbox.miss(self.lane)

    def ended(self, state: str, cause: str) -> None:
        """Wait for a provider that failed to come back, where that is asked for; else end."""
        if self._reopen is not None and state == "failed":
            # Before it is joined again: this feed has ended, and the next join opens another.
            self._leave()
            self._reopen(cause)
            return
        # Nothing is due later: what is held goes now, while it is known of which feed it is.
        while self._held:
            self._send(self._let_go())
        self._leave()
        self._on_end(state, cause)

    def finish(self, *frames: bytes) -> None:
        """Send what waits, then these text frames, and nothing more; give back as `close` does."""
        if frames:
            self._outbox.finish(self.lane, *frames, text=True)
        self._give_back()

    def close(self) -> None:
        """Send nothing more, and give back what is held, and the feed that was followed."""
        self._outbox.discard(self.lane)
        self._give_back()

    def _give_back(self) -> None:
        # First: a join that ends later would begin a feed that is never left.
        if self._opening is not None:
            self._opening.cancel()
        if self._timer is not None:
            self._timer.cancel()
        self._held.clear()
        if self._charge is not None:
            self._charge.release()
        self._leave()

    def _leave(self) -> None:
        if self._source is not None and self.feed is not None:
            # Forgotten first: both calls may end the feed, and so come here again.
            feed, self.feed = self.feed, None
            feed.remove(self)
            self._source.leave(feed)

    def _send(self, envelope: Envelope) -> None:
        # Written by the first subscription of this form, in this very call where it is short.
        form = self._form
        made = envelope.forms.get(form.key) or self._written(envelope, form)
        if isinstance(made, MessageError):
            if self.lane.refuse(made):
                self._on_refused(made)
        elif form.frames is None:
            self._outbox.put(self.lane, made)
        else:
            self._outbox.put(self.lane, *form.frames(made, envelope.number))

    def _written(self, envelope: Envelope, form: MessageForm) -> bytes | MessageError:
        """Write a message in a form: in the loop, or in the encoder's thread."""
        standing = form.write_standing if envelope.joiner is not None else None
        write = standing or form.write
        made: bytes | MessageError
        try:
            if envelope.is_long and envelope.message_octets > _MOST_OCTETS:
                text = f"the message holds {envelope.message_octets:,} octets of memory"
                raise MessageError(f"{text}; {_MOST_OCTETS:,} are allowed")  # noqa: TRY301
            made = write(envelope.number, envelope.message)
        except BaseException as error:  # noqa: BLE001 - of the message's values, or a front end's
            raised = contained(error)
            made = raised if isinstance(raised, MessageError) else MessageError(text_of(raised))
            # Kept as long as the message waits: its frames would keep what they refer to as well.
            made = made.with_traceback(None)
        envelope.forms[form.key] = made
        return made

    def _passes(self, envelope: Envelope) -> bool:
        now = self._clock()
        # One that passed those that are held would be out of order.
        if not self._held and self._throttle.is_due(now):
            self._throttle.take(now)
            return True
        if self._most_held:
            self._hold(envelope)
            self._set_timer(now)
        else:
            self.skipped += 1
        return False

    def _hold(self, envelope: Envelope) -> None:
        """Keep a message until it is due; the oldest are left out where there are too many."""
        # Before others are left out, so that the newest stays whatever its size.
        self._held.append(envelope)
        if self._charge is None:
            self._charge = self._account.hold(MemoryUse.THROTTLED)
        self._charge.grow(envelope.message_octets)
        while len(self._held) > 1 and (
            len(self._held) > self._most_held
            or self._charge.octets > self._outbox.max_bytes
            or not self._account.has_room(0)
        ):
            self.skipped += 1
            self._let_go()

    def _let_go(self) -> Envelope:
        envelope = self._held.popleft()
        if self._charge is not None:
            self._charge.grow(-envelope.message_octets)
        return envelope

    def _set_timer(self, now: float) -> None:
        if self._timer is None:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(max(0.0, self._throttle.due - now), self._release)

    def _release(self) -> None:
        """Send the oldest of what is held; all of it where nothing is to be held any more."""
        # Its time has come: the next message that is held sets another.
        self._timer = None
        now = self._clock()
        while self._held:
            envelope = self._let_go()
            self._throttle.take(now)
            self._send(envelope)
            if self._throttle.every and self._held:
                self._set_timer(now)
                return
