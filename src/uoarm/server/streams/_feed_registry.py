"""What all clients share: feeds, the manager's blocking calls in workers, and its events."""

from __future__ import annotations

import asyncio
import functools
import logging
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Hashable, Mapping
from typing import Any, TypeAlias, TypeVar

from attrs import evolve

from uoarm._control import Connection, RobotManager
from uoarm._raised import LimitedLog, Log, foreign, on_failure
from uoarm._wire import TEXT_FORM, Form
from uoarm.config import loads
from uoarm.errors import (
    ConnectionClosedError,
    UoarmError,
    UsageError,
)
from uoarm.model import (
    ConfigurationChange,
    LeaseHolder,
    Message,
    Plan,
    StatusEvent,
    StopReport,
    to_json,
)
from uoarm.server._failures import BusyError
from uoarm.server._limits import Limits
from uoarm.server.access import (
    AccessRole,
    ApprovalError,
    Approvals,
    Audit,
    RoleView,
    RoleViews,
    Supervision,
)
from uoarm.server.streams._action_goals import ActionRunners
from uoarm.server.streams._feed import Encoder, Feed, FeedKey
from uoarm.server.streams._input_sender import InputSender, Read, read_message
from uoarm.server.streams._known import KnownStructures, KnownTypes
from uoarm.server.streams._memory import Account, ServerMemory
from uoarm.server.streams._pending_feeds import OnAbsent, PendingFeeds, is_absent
from uoarm.server.streams._workers import CallEnded, LoopMailbox, SharedViews, Workers, settle

A = TypeVar("A")
Q = TypeVar("Q", bound=Hashable)
T = TypeVar("T")
_log = Log("uoarm.server")
Watcher: TypeAlias = "Callable[[ChangeNotice], None]"
"""Callback: a change."""

_READ_TEXT = functools.partial(read_message, TEXT_FORM)
_REMEMBERED = 200
_CLOSINGS = 8
_STOP_SECONDS = 2.0
_AGAIN_SECONDS = 1.0
_KILLS_AT_ONCE = 20
_STOPS = 16
_ENDS = frozenset({"closed", "failed"})


class ChangeNotice:
    """A change of the robot, written once for all who get it in the same form and role."""

    def __init__(self, event: StatusEvent, views: RoleViews) -> None:
        self.event = event
        self._views = views
        self._written: dict[tuple[AccessRole, str], bytes | None] = {}

    def written(self, role: AccessRole, form: Form) -> bytes | None:
        """Return it as it goes to clients; None: the role does not see what has changed."""
        key = role, form.name
        if key not in self._written:
            shown = shown_event(self.event, self._views.of(role))
            change = {"op": "Status", "type": "change", "jsonMessage": shown}
            self._written[key] = None if shown is None else form.write(change)
        return self._written[key]


def shown_event(event: StatusEvent, view: RoleView) -> dict[str, Any] | None:
    """Return a change as data for a role; None: it does not see what has changed."""
    if not view.has_event(event):
        return None
    fields: dict[str, Any] = to_json(evolve(event, cause=view.text(event.cause)))
    return fields


class FeedRegistry:
    """Feeds by what was asked for; all in the loop's thread, and what blocks goes to the workers.

    It is the `Backend` of front ends, which has the contract of what they call.

    Args:
        robot: the manager; it is not closed here.

    Attributes:
        memory: what is held for all clients.
        views: answers what is asked of the whole robot.
        role_views: what each role sees of it.
        actions: what works on the goals of functions.
    """

    def __init__(self, robot: RobotManager, limits: Limits) -> None:
        self._records = LimitedLog(_log)
        self.robot = robot
        self.limits = limits
        self.memory = ServerMemory(limits.total_memory_bytes, limits.memory_bytes)
        self.open_account = self.memory.open
        self.mailbox = LoopMailbox(asyncio.get_running_loop())
        self.workers = Workers(limits.workers, limits.openings, self.mailbox)
        self.encoder = Encoder()
        self.views = SharedViews(self.mailbox)
        self.view = self.views.get
        self.role_views = RoleViews(lambda: robot.config)
        self.actions = ActionRunners(self)
        self.approvals = Approvals(Audit(), Supervision(lambda: robot.config))
        # Feeds that may still be joined; taken out as soon as one has ended or failed, so that the
        # next request opens anew.
        self._feeds: dict[FeedKey, Feed] = {}
        self._keys: dict[Feed, FeedKey] = {}
        self._by_id: dict[str, Feed] = {}
        # How many clients have a feed, also while it is being opened; at none it is closed.
        self._claims: dict[Feed, int] = {}
        self._openings: dict[Feed, asyncio.Task[None]] = {}
        # Those of them that receive, by function; see `_open`.
        self._receiving: defaultdict[str, set[asyncio.Task[None]]] = defaultdict(set)
        # Connections that are being ended, so that a second kill waits for the same end.
        self._kills: dict[str, asyncio.Future[None]] = {}
        self._to_kill: deque[tuple[Connection, str]] = deque()
        # Ends under way by function: a bridge that hangs in closing must not collect threads.
        self._closings: Counter[str] = Counter()
        # Half of the threads, so that what can be had does not wait for what cannot.
        at_once = max(1, limits.openings // 2)
        self._known = KnownStructures(robot.resolve, self.workers, at_once)
        self.structures = self._known.of
        self._types = KnownTypes(
            robot.structure_of_type, self.in_worker, lambda: robot.config.bridges
        )
        self.structure_of_type = self._types.of
        self._pending = PendingFeeds(self._join, self._claim, self.leave, at_once)
        self._is_ending = False
        self._stopping: asyncio.Future[StopReport] | None = None
        self._after_stop: dict[Hashable, asyncio.Future[Any]] = {}
        self._releasing: asyncio.Future[None] | None = None
        self._watchers: dict[Watcher, None] = {}
        self._past: deque[tuple[float, StatusEvent]] = deque(maxlen=_REMEMBERED)
        self._stop_observing = robot._observe(  # noqa: SLF001 - of the house
            lambda event: self.mailbox.put(functools.partial(self._take_event, event))
        )

    @property
    def feeds(self) -> tuple[Feed, ...]:
        """The feeds that are open or opening."""
        return tuple(self._feeds.values())

    def past(self) -> list[tuple[float, StatusEvent]]:
        """Return the last changes: seconds ago, and the change. For any thread."""
        now = time.monotonic()
        return [(now - came, event) for came, event in tuple(self._past)]

    def after(self, number: int) -> list[ChangeNotice]:
        """Return those of the last changes that came after one of this number."""
        views = self.role_views
        return [ChangeNotice(event, views) for _, event in self._past if event.number > number]

    def is_watched_by(self, watcher: Watcher) -> bool:
        """Say whether a watcher is notified."""
        return watcher in self._watchers

    async def join(self, wanted: FeedKey, on_absent: OnAbsent | None = None) -> Feed:
        """Return the open feed, opening it for the first; see `Backend.join`."""
        if on_absent is None:
            return await self._join(wanted)
        cause = self._pending.cause(wanted)
        if cause is None:
            try:
                return await self._join(wanted)
            except UoarmError as error:
                if not is_absent(error):
                    raise
                cause = str(error)
        return await self._pending.join(wanted, cause, on_absent)

    async def _join(self, wanted: FeedKey) -> Feed:
        feed = self._feeds.get(wanted)
        if feed is None:
            if self._is_ending:
                raise ConnectionClosedError("the server stops")
            if self._closings[wanted.function] >= _CLOSINGS:
                raise BusyError(
                    f"{_CLOSINGS} earlier connections to {wanted.function!r} are being closed still"
                )
            feed = self._feeds[wanted] = Feed(self.mailbox, self.limits, self.encoder)
            self._keys[feed] = wanted
            opening = asyncio.ensure_future(self._open(wanted, feed))
            if wanted.receive:
                self._receiving[wanted.function].add(opening)
            # Reads the error also when every client has gone: asyncio would report it as never
            # retrieved.
            opening.add_done_callback(lambda done: done.cancelled() or done.exception())
            self._openings[feed] = opening
        # Claimed before the wait: an opening that no client claims is closed when it is done.
        self._claim(feed)
        with on_failure(self.leave, feed):
            if feed in self._openings:
                # Shielded: a client that goes must not end the opening for others that wait for it.
                await asyncio.shield(self._openings[feed])
        return feed

    def _claim(self, feed: Feed) -> None:
        self._claims[feed] = self._claims.get(feed, 0) + 1

    def leave(self, feed: Feed, cause: str = "") -> None:
        """Give a feed back; the last one closes it, without waiting, and with this cause."""
        if feed not in self._claims:
            return  # `close` has let go of it for all that waited
        self._claims[feed] -= 1
        if not self._claims[feed]:
            del self._claims[feed]
            # Forgotten first: a request from now on opens another connection instead of one that
            # ends.
            self._forget(feed)
            if feed.connection is not None and not feed.connection.ended:
                self._to_kill.append((feed.connection, cause or "no client uses it any more"))
                if len(self._to_kill) == 1:
                    asyncio.get_running_loop().call_soon(self._kill_some)

    def _kill_some(self) -> None:
        """Kill what was left, a few in each of the loop's turns: a client may leave a thousand."""
        for _ in range(min(_KILLS_AT_ONCE, len(self._to_kill))):
            connection, cause = self._to_kill[0]
            if not connection.ended:
                self.kill(connection, cause)
            self._to_kill.popleft()  # not before: while there are any, a turn is asked for
        if self._to_kill:
            asyncio.get_running_loop().call_soon(self._kill_some)

    def sender(
        self,
        connection: Connection,
        account: Account,
        read: Read = _READ_TEXT,
        holder: LeaseHolder | None = None,
    ) -> InputSender:
        """Return what hands a client's messages, which `read` understands, to a connection."""
        limit = self.limits.queue_messages
        return InputSender(connection, read, self.workers, account, limit=limit, holder=holder)

    def kill(self, connection: Connection, cause: str) -> asyncio.Future[None]:
        """End a connection in a thread of its own kind; the future has its end, the cause says who.

        Idempotent: while it is being ended, every call returns the same future. It must not be
        cancelled: `asyncio.shield` it.
        """
        pending = self._kills.get(connection.id)
        if pending is not None:
            return pending
        function = connection.plan.function
        self._closings[function] += 1

        def ended(done: asyncio.Future[None]) -> None:
            del self._kills[connection.id]
            # Not `Counter.__isub__`, which looks at all functions each time.
            self._closings[function] -= 1
            if not self._closings[function]:
                del self._closings[function]
            if not done.cancelled() and isinstance(error := done.exception(), UoarmError):
                _log.warning("closing connection %s: %s", connection.id, error)
                if isinstance(error, BusyError):  # there was no thread for it
                    done.get_loop().call_later(_AGAIN_SECONDS, self.kill, connection, cause)

        kill = functools.partial(connection._kill, cause)  # noqa: SLF001 - of the house
        # Entered before its callback is added, which takes it out.
        killing = self._kills[connection.id] = self.workers.free(kill)
        killing.add_done_callback(ended)
        return killing

    def connection(self, identity: str) -> Connection | None:
        """Return a connection that has not ended, also one that the application itself opened."""
        feed = self._by_id.get(identity)
        if feed is not None:
            return feed.connection
        return next((item for item in self.robot.connections() if item.id == identity), None)

    async def call(self, name: str, message: Message, read: Read, timeout: float) -> Message:
        """Call a service in a worker; the limit for all clients holds as well."""
        limit = min(timeout, self.limits.call_seconds)
        return await self.call_planned(name, None, message, read, limit, str, lambda reply: reply)

    async def call_planned(
        self,
        wanted: Plan | str,
        revision: int | None,
        message: Message,
        read: Read,
        timeout: float,
        began: Callable[[Callable[[], bool]], object],
        act: Callable[[Message], T],
    ) -> T:
        """Call a service in a worker; see `Backend.call_planned`."""
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        ended: CallEnded = functools.partial(settle, future)
        self.begin_call(wanted, revision, message, read, timeout, began, act, ended)
        return await future

    def begin_call(
        self,
        wanted: Plan | str,
        revision: int | None,
        message: Message,
        read: Read,
        timeout: float,
        began: Callable[[Callable[[], bool]], object],
        act: Callable[[Message], T],
        ended: CallEnded,
    ) -> None:
        """Begin what `call_planned` does; `ended` gets what it returns, or raises, in the loop.

        Raises:
            BusyError: every worker is taken.
        """

        def work() -> T:
            plan = self.robot.resolve(wanted) if isinstance(wanted, str) else wanted
            structure = plan.provider.structures.get("request")
            if structure is None:
                raise UsageError(f"function {plan.function!r} is a stream, not a service")
            if revision is not None and self.robot.revision != revision:
                raise ApprovalError(f"the configuration is not revision {revision} any more")
            reply = self.robot._call_planned(  # noqa: SLF001 - of the house
                plan, read(structure, message), timeout, began
            )
            return act(reply)

        self.workers.call(work, ended)

    async def resolve(self, name: str) -> Plan:
        """Find a plan in a worker; see `resolve_and`."""
        return await self.resolve_and(lambda plan: plan, name)

    async def resolve_and(self, act: Callable[[Plan], T], name: str) -> T:
        """Find a plan in a worker, and do something with it there, too.

        Raises:
            UoarmError: as `RobotManager.resolve`, and BusyError.
        """
        # A search that computes has its turn, so that many of them do not keep the loop waiting.
        return await self.workers.open(lambda: act(self.robot.resolve(name)))

    async def configure(self, options: Mapping[str, Any]) -> ConfigurationChange:
        """Change the configuration of the robot, in a worker.

        Args:
            options: `text`, the whole configuration, or `rollback`, a revision; and `dry_run`,
                `force`, `revision`, `keep` and `reload_code`, as `RobotManager.apply` has them.

        Raises:
            UoarmError: as `RobotManager.apply`, and BusyError.
        """
        robot = self.robot
        names = ("dry_run", "force", "revision", "keep")
        how = {name: options[name] for name in names if name in options}

        def apply() -> ConfigurationChange:
            if "rollback" in options:
                return robot.rollback(options["rollback"], **how)
            wanted = loads(options["text"], robot.config.origin, robot.registry.types)
            reload_code = options.get("reload_code", False)
            return robot.apply(wanted, **how, reload_code=reload_code)

        return await self.workers.start(apply)

    async def stop_all(self, key: Hashable, act: Callable[[StopReport], T]) -> tuple[StopReport, T]:
        """Stop what moves, for all who ask while it lasts; see `Backend.stop_all`."""
        if self._stopping is None or self._stopping.done():
            self._stopping = self.workers.stop(
                functools.partial(self.robot.stop_all, timeout=_STOP_SECONDS)
            )
            self._after_stop = {}
            self._releasing = None  # who asks from now on wants this one released
        # Taken before the wait, after which another stop may have begun with reports of its own.
        shared, after = self._stopping, self._after_stop
        report = await asyncio.shield(shared)
        # The first to come back from the wait begins it; the others wait for the same.
        if key not in after:
            after[key] = self.workers.stop(lambda: act(report))
        return report, await asyncio.shield(after[key])

    async def release(self) -> None:
        """Let commands through again.

        Raises:
            BridgeError: some inputs could not be reached.
            BusyError: earlier stops and releases last still; what stops is never refused.
        """
        if self._releasing is None or self._releasing.done():
            if self.workers.stopping >= _STOPS:
                raise BusyError(f"{_STOPS} stops and releases are under way still; ask again later")
            self._stopping = None  # one that is asked for from now on has to stop what moves then
            self._releasing = self.workers.stop(
                functools.partial(self.robot.release, timeout=_STOP_SECONDS)
            )
        await asyncio.shield(self._releasing)

    async def in_worker(self, action: Callable[[], T]) -> T:
        """Return what an action returns that takes its time and ends by itself."""
        return await self.workers.start(action, always=True)

    def watch(self, watcher: Watcher) -> None:
        """Notify a watcher of every change and the function that it concerns, from now on."""
        self._watchers[watcher] = None

    def unwatch(self, watcher: Watcher) -> None:
        """Notify a watcher no more. Idempotent."""
        self._watchers.pop(watcher, None)

    def end(self) -> None:
        """Begin to kill what is open, and open nothing more: no command passes from now on."""
        # First: no client is to take the end for that of its stream, which it opens anew later.
        self._stop_observing()
        self._is_ending = True
        for feed in list(self._claims):
            # However many clients still have it: the server stops, and this is the last claim.
            self._claims[feed] = 1
            self.leave(feed, "the server stops")
        while self._to_kill:
            self._kill_some()

    async def close(self) -> None:
        """Kill what is open, as far as it can be done while the server closes; after `end`."""
        self._known.close()
        self._types.close()
        self.views.close()
        if self._kills:
            await asyncio.wait(self._kills.values(), timeout=self.limits.stop_seconds / 4)
        # After the kills, which need its threads; the mailbox last, which brings their outcomes.
        self.workers.close()
        self.encoder.close()
        self.mailbox.close()

    async def _open(self, wanted: FeedKey, feed: Feed) -> None:
        take = feed.take if wanted.receive else lambda _: None
        function = wanted.function
        if not wanted.receive and function in self._receiving:
            # What was to be received before this one sends must be there for the answer: a client
            # that subscribes and then publishes gets what comes of it.
            await asyncio.wait(self._receiving[function])

        def request() -> Connection:
            # Looked at in the worker, when its turn comes: those who asked may have gone while it
            # waited. A stale look is harmless, for the loop looks again when it is open.
            if feed not in self._claims:
                raise ConnectionClosedError("no client waits for it any more")
            return _request(self.robot, wanted, take, self.limits.request_seconds)

        try:
            with on_failure(self._forget, feed):
                connection = await self.workers.open(request)
        finally:
            # From here on nothing is awaited: who joins finds it being opened, or open, or none.
            opening = self._openings.pop(feed, None)
            if wanted.receive and opening is not None:
                self._receiving[function].discard(opening)
                if not self._receiving[function]:
                    del self._receiving[function]
        feed.connection = connection
        if feed not in self._claims:  # everyone who asked has gone meanwhile
            self.kill(connection, "the client that asked for it has gone")
            return
        # Found by its events from here on. One that ended before that has had its event: it is
        # looked at once, or its clients would wait for an end for ever.
        self._by_id[connection.id] = feed
        if connection.ended:
            self._ended(feed)

    def _take_event(self, event: StatusEvent) -> None:
        kind, _, name = event.subject.partition(" ")
        if kind == "configuration":
            self.approvals.reconfigured(self.robot.revision)
        elif event.change == "replaced":
            self.approvals.taken_over(event.function)
        # What bridges and components are like decides what can be had: what is known is asked for
        # again, and what waits is tried again.
        if kind != "connection":
            self._known.forget()
            self._pending.poke()
        elif event.change in _ENDS and name in self._by_id:
            self._ended(self._by_id[name])
        # Before watchers are notified: one that asks for the past in there finds the event in it.
        self._past.append((time.monotonic(), event))
        announcement = ChangeNotice(event, self.role_views)
        # A copy: a watcher may end its watch in there.
        for watcher in tuple(self._watchers):
            try:
                foreign(watcher, announcement)
            except Exception as error:  # noqa: BLE001 - that of a front end may raise anything
                text = f"a watcher of {watcher.__module__} failed"
                self._records.write(logging.ERROR, text, error)

    def _ended(self, feed: Feed) -> None:
        assert feed.connection is not None, "only an opened feed can end"
        self._forget(feed)
        feed.finish(feed.connection.state.value, feed.connection.cause)

    def _forget(self, feed: Feed) -> None:
        wanted = self._keys.pop(feed, None)
        if wanted is not None:
            del self._feeds[wanted]
        if feed.connection is not None:
            self._by_id.pop(feed.connection.id, None)


def _request(
    robot: RobotManager, wanted: FeedKey, take: Callable[[Message], None], timeout: float
) -> Connection:
    outputs = robot.resolve(wanted.name).provider.component.outputs
    name = wanted.name
    if not wanted.receive and len(outputs) > 1:
        name = f"{wanted.function}.{outputs[0].name}"
    return robot.request(
        name,
        validate=wanted.validate,
        on_message=take if outputs else None,
        timeout=timeout,
    )
