"""What an agent has open: streams that it reads and inputs that it sends to, for a while."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from attrs import define, field

from uoarm.errors import ConnectionClosedError, UoarmError
from uoarm.model import LeaseHolder, Message, Plan, ValidationMode, message_octets
from uoarm.server.front_end import (
    TEXT_FORM,
    Account,
    Backend,
    Charge,
    Envelope,
    Feed,
    FeedKey,
    InputSender,
    LimitError,
    MemoryUse,
    read_message,
)

AGAIN_SECONDS = 2.0
_read = partial(read_message, TEXT_FORM)
_IDLE_SECONDS = 30.0
_MOST_OPEN = 64
_MOST_OCTETS = 8_388_608


@define(eq=False)
class ReadMessages:
    """Messages for one read: so many, of so many octets at most.

    Attributes:
        wanted: how many.
        messages: those that came.
        lost: how many were missed between the first and the last.
        full: set when no more are wanted, or will come.
    """

    wanted: int
    messages: list[Message] = field(factory=list)
    lost: int = 0
    octets: int = 0
    full: asyncio.Event = field(factory=asyncio.Event)
    _last: int | None = None

    def add(self, envelope: Envelope) -> None:
        """Take a message, unless there are enough."""
        if self.full.is_set():
            return
        if self._last is not None and envelope.joiner is None:
            self.lost += max(0, envelope.number - self._last - 1)
        self._last = envelope.number
        self.messages.append(envelope.message)
        self.octets += envelope.message_octets
        if len(self.messages) >= self.wanted or self.octets >= _MOST_OCTETS:
            self.full.set()


class HeldStream:
    """A feed that an agent has open, with the newest message of it. A listener of the feed."""

    def __init__(self, feed: Feed, charge: Charge, on_end: Callable[[], None]) -> None:
        self.feed = feed
        self.newest: Envelope | None = None
        self.end = ""
        self.has_failed = False
        self.users = 0
        self.is_left = False
        self.timer: asyncio.TimerHandle | None = None
        self.collectors: set[ReadMessages] = set()
        self.watchers: dict[object, Callable[[], None]] = {}
        self.sender: InputSender | None = None
        self._charge = charge
        self._on_end = on_end

    def offer(self, envelope: Envelope) -> None:
        """Take one message."""
        self.newest = envelope
        self._charge.resize(
            envelope.message_octets + sum(collector.octets for collector in self.collectors)
        )
        for collector in self.collectors:
            collector.add(envelope)
        for watcher in tuple(self.watchers.values()):
            watcher()

    def ended(self, state: str, cause: str) -> None:
        """Take in that no more will come."""
        self.end = f"{state}: {cause}" if cause else state
        self.has_failed = state == "failed"
        for collector in self.collectors:
            collector.full.set()
        for watcher in tuple(self.watchers.values()):
            watcher()
        self._on_end()

    def release(self) -> None:
        """Hold no memory any more."""
        self._charge.release()


class AgentStreams:
    """All that one agent has open; in the server's loop.

    What is not used for half a minute is closed, and with it what it moved is stopped.

    Args:
        account: charged for it.
        holder: as whom the agent commands inputs that have a lease.
    """

    def __init__(self, backend: Backend, account: Account, holder: LeaseHolder) -> None:
        self._backend = backend
        self._account = account
        self._holder = holder
        self._held: dict[FeedKey, HeldStream] = {}
        self._opening: dict[FeedKey, asyncio.Task[HeldStream]] = {}
        self._watched: dict[object, HeldStream] = {}  # by the token of who watches it
        self._again: set[asyncio.Task[None]] = set()
        self._closed = False

    @property
    def open(self) -> list[str]:
        """What is open, for the status."""
        return [key.name for key in self._held]

    async def read(
        self,
        name: str,
        count: int,
        seconds: float,
        *,
        latest: bool,
        check: Callable[[Plan], None] | None = None,
    ) -> tuple[ReadMessages, str]:
        """Return messages of a function's output, and why no more will come.

        Args:
            name: of the function and the output.
            count: how many are wanted.
            seconds: for how long they are waited for.
            latest: whether the newest one that came before is one of them.
            check: called with the plan of the connection; may refuse it.
        """
        key, collector = FeedKey(name, ValidationMode.ALWAYS), ReadMessages(count)
        held = await self.take(key, collector, check)
        try:
            if latest and not collector.messages and held.newest is not None:
                collector.add(held.newest)
            held.collectors.add(collector)
            if not held.end:
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(collector.full.wait(), seconds)
        finally:
            held.collectors.discard(collector)
            self.give_back(key, held)
        return collector, held.end

    async def send(
        self, function: str, port: str, message: Message, check: Callable[[Plan], None]
    ) -> None:
        """Send one message to an input of a function, and wait until it is handed over.

        Args:
            function: the function.
            port: of the input; empty: the only one.
            message: as it came.
            check: called with the plan of the connection before anything is sent.
        """
        key = FeedKey(function, ValidationMode.ALWAYS, receive=False)
        held = await self.take(key, check=check)
        try:
            connection = held.feed.connection
            assert connection is not None, "join returns feeds that are open"
            if held.sender is None:
                held.sender = self._backend.sender(connection, self._account, _read, self._holder)
            done: asyncio.Future[None] = asyncio.get_running_loop().create_future()

            def conclude(error: BaseException | None) -> None:
                if done.done():
                    return
                if error is None:
                    done.set_result(None)
                else:
                    done.set_exception(error)

            held.sender.send(message, port or None, conclude, message_octets(message))
            await done
        finally:
            self.give_back(key, held)

    async def watch(self, name: str, notify: Callable[[], None]) -> Callable[[], None]:
        """Have something called with each message of an output; returns what ends that.

        It is called with the end as well, after which one that failed is watched again as soon as
        it can be had.
        """
        key, token = FeedKey(name, ValidationMode.ALWAYS), object()
        held = await self.take(key)
        self._begin_watch(token, held, notify)
        self._follow(key, held)  # it may have ended since it was opened

        def end() -> None:
            held = self._watched.pop(token, None)
            if held is not None:
                del held.watchers[token]
                self.give_back(key, held)

        return end

    def _begin_watch(self, token: object, held: HeldStream, notify: Callable[[], None]) -> None:
        self._watched[token] = held
        held.watchers[token] = notify
        if held.newest is not None or held.end:
            notify()

    async def _watch_again(self, key: FeedKey, ended: HeldStream) -> None:
        while ended.watchers and not self._closed:
            await asyncio.sleep(AGAIN_SECONDS)
            try:
                held = await self.take(key)
            except UoarmError:
                continue  # it cannot be had yet
            if held.has_failed:  # again, before it was watched
                self.give_back(key, held)
                continue
            for token, notify in ended.watchers.items():
                held.users += 1
                self._begin_watch(token, held, notify)
                self.give_back(key, ended)
            ended.watchers.clear()
            self.give_back(key, held)

    def stop_own(self) -> list[str]:
        """Stop every input that the agent has sent to; returns which."""
        stopped = []
        for key, held in self._held.items():
            if held.sender is not None and held.feed.connection is not None:
                inputs = held.feed.connection.plan.provider.component.inputs
                own = [port for port in inputs if port.source is None]
                for port in own:
                    command = port.endpoint.command
                    if command is not None and command.stop is not None:
                        # Named as in `send`: what waits for the same input fails.
                        held.sender.stop(port.name if own[1:] else None, lambda _: None)
                        stopped.append(f"{key.function}.{port.name}")
        return stopped

    def close(self) -> None:
        """Close everything. Idempotent."""
        self._closed = True
        for task in (*self._opening.values(), *self._again):
            task.cancel()
        for key in list(self._held):
            self._leave(key, self._held[key])

    async def take(
        self,
        key: FeedKey,
        first: ReadMessages | None = None,
        check: Callable[[Plan], None] | None = None,
    ) -> HeldStream:
        """Return what is open, opening it at need; give it back with `give_back`.

        Args:
            key: what.
            first: where it has to be opened, gets its messages from the first one on.
            check: called with the plan of the connection; what it refuses and no one uses is
                closed at once.
        """
        held = self._held.get(key)
        if held is None:
            opening = self._opening.get(key)
            if opening is None:
                if len(self._held) + len(self._opening) >= _MOST_OPEN:
                    self._make_room()
                opening = self._opening[key] = asyncio.ensure_future(self._open(key, first))
                opening.add_done_callback(lambda _: self._opening.pop(key, None))
            try:
                held = await asyncio.shield(opening)
            except asyncio.CancelledError:
                opening.add_done_callback(lambda _: self._await_use(key))
                raise
        if check is not None:
            self._check(key, held, check)
        held.users += 1
        if held.timer is not None:
            held.timer.cancel()
            held.timer = None
        return held

    def _check(self, key: FeedKey, held: HeldStream, check: Callable[[Plan], None]) -> None:
        connection = held.feed.connection
        if held.is_left or connection is None:
            raise ConnectionClosedError(f"{key.function!r} has been closed; try again")
        try:
            check(connection.plan)
        except UoarmError:
            if not held.users:
                self._leave(key, held)
            raise

    def give_back(self, key: FeedKey, held: HeldStream) -> None:
        """Use it no more; it stays open for a while."""
        held.users -= 1
        if held.users:
            return
        if held.end or self._held.get(key) is not held:
            self._leave(key, held)
            return
        self._await_use(key)

    def _await_use(self, key: FeedKey) -> None:
        held = self._held.get(key)
        if held is None or held.users or held.timer is not None:
            return
        loop = asyncio.get_running_loop()
        held.timer = loop.call_later(_IDLE_SECONDS, self._leave, key, held)

    async def _open(self, key: FeedKey, first: ReadMessages | None) -> HeldStream:
        feed = await self._backend.join(key)
        if self._closed:
            self._backend.leave(feed)
            raise ConnectionClosedError("the agent's rights have ended")
        charge = self._account.charge(MemoryUse.DATA, 0)
        held = HeldStream(feed, charge, lambda: self._ended(key, held))
        self._held[key] = held
        if first is not None:
            held.collectors.add(first)
        feed.add(held)
        return held

    def _ended(self, key: FeedKey, held: HeldStream) -> None:
        """Have the next use open it anew; what is watched has one, where it has failed."""
        if not held.users:
            self._leave(key, held)
            return
        self._held.pop(key, None)
        self._follow(key, held)

    def _follow(self, key: FeedKey, ended: HeldStream) -> None:
        """Watch again what has failed, where it is watched."""
        if ended.watchers and ended.has_failed:
            again = asyncio.ensure_future(self._watch_again(key, ended))
            self._again.add(again)
            again.add_done_callback(self._again.discard)

    def _make_room(self) -> None:
        # What is not used and has no timer was just opened: who asked for it goes on shortly.
        idle = next((key for key, held in self._held.items() if held.timer is not None), None)
        if idle is None:
            raise LimitError(f"{_MOST_OPEN} streams are in use; wait for one of them first")
        self._leave(idle, self._held[idle])

    def _leave(self, key: FeedKey, held: HeldStream) -> None:
        if self._held.get(key) is held:
            del self._held[key]
        if held.is_left:
            return
        held.is_left = True
        if held.timer is not None:
            held.timer.cancel()
        if held.sender is not None:
            held.sender.close()
        held.feed.remove(held)
        held.release()
        self._backend.leave(held.feed)
