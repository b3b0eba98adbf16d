"""Feeds of functions that cannot be had yet: tried again, for all who wait, until they can be."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeAlias

from attrs import define, field

from uoarm._resolve import NoPlanError
from uoarm._support.aio_deadlines import event_by
from uoarm.errors import BridgeError, FailureReason
from uoarm.server._failures import BusyError
from uoarm.server.streams._feed import Feed, FeedKey

OnAbsent: TypeAlias = Callable[[str], None]
"""Takes why a function cannot be had yet; called at once, and again when that changes."""

_LEAST_SECONDS = 0.25
_MOST_SECONDS = 5.0
_ABSENT = frozenset({FailureReason.NOT_FOUND, FailureReason.UNAVAILABLE, FailureReason.TIMEOUT})


def is_absent(error: BaseException) -> bool:
    """Say whether what failed may succeed once something is there that is not there now."""
    if isinstance(error, NoPlanError):
        return error.is_unavailable
    if isinstance(error, BridgeError):
        return error.reason in _ABSENT
    return isinstance(error, BusyError)


@define(eq=False)
class _Search:
    """The attempts to join one feed.

    Attributes:
        cause: why it cannot be had.
        changed: set when the next attempt may go otherwise than the last.
        waiting: what has the outcome for each who waits, and what reports the cause to them.
    """

    cause: str
    changed: asyncio.Event = field(factory=asyncio.Event)
    waiting: dict[asyncio.Future[Feed], OnAbsent] = field(factory=dict)
    task: asyncio.Task[None] | None = None

    def notify(self, cause: str) -> None:
        """Notify those who wait where the cause is another one."""
        if cause != self.cause:
            self.cause = cause
            for on_absent in tuple(self.waiting.values()):
                on_absent(cause)


class PendingFeeds:
    """Joins feeds as soon as they can be had, in the loop's thread.

    However many wait for a feed, it is tried once at a time: after a quarter of a second, then
    after twice as long each time, five seconds at most, and after a quarter of a second again when
    `poke` reports a change.

    Args:
        join: joins a feed, or fails.
        claim: claims a feed that is open once more, as if it had been joined.
        at_once: attempts that are made side by side, however many feeds are waited for.
    """

    def __init__(
        self,
        join: Callable[[FeedKey], Awaitable[Feed]],
        claim: Callable[[Feed], None],
        leave: Callable[[Feed], None],
        at_once: int,
    ) -> None:
        self._join = join
        self._claim = claim
        self._leave = leave
        self._turns = asyncio.Semaphore(at_once)
        self._searches: dict[FeedKey, _Search] = {}

    def cause(self, wanted: FeedKey) -> str | None:
        """Return why a feed cannot be had that a client waits for; None: none does."""
        search = self._searches.get(wanted)
        return None if search is None else search.cause

    def poke(self) -> None:
        """Try all again soon: something changed."""
        for search in self._searches.values():
            search.changed.set()

    async def join(self, wanted: FeedKey, cause: str, on_absent: OnAbsent) -> Feed:
        """Join a feed when it can be had; cancel to wait no longer.

        Args:
            wanted: the feed.
            cause: why it cannot be had; `on_absent` gets it.
            on_absent: what else it gets is why later attempts failed.

        Raises:
            UoarmError: it cannot be had for a reason that no waiting mends.
        """
        search = self._searches.get(wanted)
        if search is None:
            search = self._searches[wanted] = _Search(cause)
            search.task = asyncio.ensure_future(self._seek(wanted, search))
        waiter: asyncio.Future[Feed] = asyncio.get_running_loop().create_future()
        # Entered before the first report, which may raise: what is entered is always taken out.
        search.waiting[waiter] = on_absent
        try:
            on_absent(cause)
            return await waiter
        except asyncio.CancelledError:
            # The feed was claimed for this client in the turn in which the client was cancelled:
            # the claim would keep the feed open for ever.
            if waiter.done() and not waiter.cancelled() and waiter.exception() is None:
                self._leave(waiter.result())  # it was handed over just before
            raise
        finally:
            del search.waiting[waiter]
            if not search.waiting:
                self._end(wanted, search)
                assert search.task is not None, "a search has its task from the start"
                search.task.cancel()

    async def _seek(self, wanted: FeedKey, search: _Search) -> None:
        loop = asyncio.get_running_loop()
        pause = _LEAST_SECONDS
        while True:
            begun = loop.time()
            # In any case, so that changes that come in bursts do not make attempts without a pause.
            await asyncio.sleep(_LEAST_SECONDS)
            await event_by(search.changed, begun + pause)
            # Before the attempt: a change during it calls for another one.
            search.changed.clear()
            pause = min(2 * pause, _MOST_SECONDS)
            try:
                async with self._turns:
                    feed = await self._join(wanted)
            except Exception as error:  # noqa: BLE001 - it is passing, or reported to those who wait
                if not is_absent(error):
                    # Ended first: a client that asks before those who wait have run would join a
                    # search that never goes on.
                    self._end(wanted, search)
                    for waiter in search.waiting:
                        if not waiter.done():
                            waiter.set_exception(error)
                    return
                search.notify(str(error))
            else:
                break
        # Ended first: who asks from now on joins the open feed. Each that waits gets a claim of its
        # own, and the claim of this search is given back last, so that the feed is never without
        # one.
        self._end(wanted, search)
        for waiter in search.waiting:
            if not waiter.done():
                self._claim(feed)
                waiter.set_result(feed)
        self._leave(feed)

    def _end(self, wanted: FeedKey, search: _Search) -> None:
        """Let the next client begin anew."""
        # This one may have ended before, and another have begun since, which must stay.
        if self._searches.get(wanted) is search:
            del self._searches[wanted]
