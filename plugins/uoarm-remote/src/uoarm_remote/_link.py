"""The link to the other manager: a loop in a thread of its own, which other threads ask.

It is made with the first question, and made again when it breaks. Within some seconds the session
goes on as it was; after that another one opens what was open. What is open sees both as events.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import math
import ssl
import threading
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from websockets.exceptions import InvalidHandshake, InvalidStatus

from uoarm.bridge import (
    Backoff,
    Disconnection,
    LimitedLog,
    Log,
    WorkerExecutor,
    asking_managers,
    other_protocol,
    reason_of,
    redirection,
    refusal,
    refuse_loop,
    renewed,
    text_of,
    tls_fault,
    wait_step,
)
from uoarm.client import RemoteRobot, ServerAddress, ServerError, ThreadAnswer, trust_fingerprint
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    CommandRefusedError,
    ConfigurationError,
    ConnectionClosedError,
    FailureReason,
    MessageError,
    PluginError,
    ResolutionError,
    UoarmError,
    UsageError,
)
from uoarm.model import Health
from uoarm_remote._options import ManagerOptions

_log = Log("uoarm.remote")

T = TypeVar("T")
_BACKOFF = Backoff(first=0.1, most=5.0, jitter=0.5)
_FOREVER = 1e9
_TICK_SECONDS = 0.25
_CLOCK_SECONDS = 30.0
_AT_ONCE = 8  # questions of one kind: the other manager has other clients, too
_JOIN_SECONDS = 2.0
_MOST_TOKEN = 4096
CONNECTING_ERRORS = (OSError, InvalidHandshake, TimeoutError, asyncio.TimeoutError, UoarmError)
"""What connecting to another manager raises."""
_WAITING = 32  # threads for what the loop waits for, such as the names of machines


class LinkMember(Protocol):
    """What is open, and learns of the link. Its methods return at once, in the link's thread."""

    def link_broke(self, cause: str) -> None: ...

    def link_is_up(self) -> None: ...

    def tick(self) -> None: ...


class ManagerLink:
    """One connection to another manager.

    Args:
        identity: returns the identity of the manager that asks.
        report: called with the health of the bridge, and why, in the link's thread.
    """

    def __init__(
        self,
        name: str,
        options: ManagerOptions,
        identity: Callable[[], str],
        report: Callable[[Health, str], object],
    ) -> None:
        self._records = LimitedLog(_log)
        self._name, self._options, self._identity = name, options, identity
        self._report = report
        # What is open is lost by itself, and the link is tried for ever.
        self._disconnection = Disconnection(math.inf)
        # Guards the beginning of the thread, the members and why the link is down: between steps,
        # in any thread, and the link's own.
        self._lock = threading.Lock()
        self._members: dict[LinkMember, None] = {}
        self._why_down = "it has not been reached yet"  # empty while it is up
        self._tried, self._is_closing = threading.Event(), False
        self._thread: threading.Thread | None = None
        self._loop = asyncio.new_event_loop()
        self._loop.set_default_executor(WorkerExecutor(f"uoarm-remote {name}", _WAITING))
        self._closing: asyncio.Event | None = None
        self._robot: RemoteRobot | None = None  # in the loop only
        self._down_since: float | None = None
        # Questions under way, in the loop only. They are ended once a break has lasted for the
        # grace: the answer would come only if the link did.
        self._asking: set[asyncio.Task[Any]] = set()
        # Likewise of threads that wait by themselves.
        self._waiting: set[ThreadAnswer] = set()
        self.breaks = 0
        # Their time of day less our monotonic seconds, and when it was measured, or its measuring
        # begun: clocks may be set, and after a break another machine may answer. In the loop only.
        self._difference: float | None = None
        self._measured = -math.inf
        self._measuring: asyncio.Future[None] | None = None
        self._version: int | None = None  # of their status, which has the time

    @property
    def _is_up(self) -> bool:
        return not self._why_down

    @property
    def grace(self) -> float:
        """Seconds that it may be broken before what is open is lost."""
        return self._options.grace

    @property
    def timeout(self) -> float:
        """Seconds that an answer may take."""
        return self._options.timeout

    @property
    def ahead(self) -> float | None:
        """Seconds by which the other clock is ahead, None while it is unknown."""
        if (difference := self._difference) is None:
            return None
        return round(difference - (time.time() - time.monotonic()), 3)  # a fact, not noise

    @property
    def url(self) -> str:
        """Where the other manager is."""
        return self._options.url

    @property
    def peer(self) -> str:
        """The identity of the other manager; empty before the first greeting."""
        robot = self._robot
        return "" if robot is None else str(robot.hello.get("manager", ""))

    def way(self) -> dict[str, Any]:
        """Return the field that says through which managers a question of this thread comes."""
        identity = self._identity()
        return {"x-managers": [*asking_managers(), identity]} if identity else {}

    def require(self, timeout: float) -> None:
        """Raise where the other manager is not reached, of the first attempt after `timeout`.

        Raises:
            BridgeError: as `ask`.
        """
        self._begin()
        self._await_attempt(time.monotonic() + timeout)
        try:
            self._reached()
        except BridgeError as error:
            raise translated(self.place, error) from error

    def ask(self, op: str, kind: str, timeout: float, **fields: Any) -> Any:
        """Ask the other manager, in any thread but the link's; returns the answer.

        Raises:
            BridgeError: it cannot be reached, or refused; the text says which manager did.
            BridgeTimeoutError: no answer within `timeout` seconds.
        """
        asked: dict[str, Any] = {**fields, **self.way()}

        async def asking(robot: RemoteRobot) -> Any:
            return await robot.ask(op, kind, **asked)

        return self.run(asking, timeout, f"{op} {kind}".strip())

    def ask_at_once(
        self,
        op: str,
        question: Callable[[], tuple[str, Mapping[str, Any]]],
        timeout: float,
        began: Callable[[Callable[[], object]], object] = lambda _: None,
    ) -> Any:
        """Ask what is asked often, without a turn of the link's thread before it is sent.

        Args:
            op: of the control message.
            question: returns its `type`, and further fields.
            timeout: seconds that the answer may take.
            began: called with what cancels the question.

        Raises:
            BridgeError: as `ask`.
        """
        self._begin()
        deadline = time.monotonic() + timeout
        self._await_attempt(deadline)
        kind = ""
        waiting: list[ThreadAnswer] = []

        def begin(answer: ThreadAnswer) -> None:
            waiting.append(answer)
            self._waiting.add(answer)
            cancelled = BridgeError(f"{self.place}: {op} {kind} was cancelled")
            began(lambda: answer.set_exception(cancelled))

        try:
            robot = self._reached()
            session = robot.restarts
            kind, fields = question()
            left = deadline - time.monotonic()
            return robot.ask_in_thread(op, kind, left, session, begin, **fields)
        except TimeoutError:
            text = f"{self.place}: no answer to {op} {kind} within {timeout:g} s"
            raise BridgeTimeoutError(text) from None
        except UoarmError as error:
            if self._is_closing:
                raise self._closed(f"{op} {kind}") from None
            raise translated(self.place, error) from error
        finally:
            self._waiting.difference_update(waiting)

    def ask_each(
        self, op: str, kinds: Sequence[str], timeout: float
    ) -> list[Mapping[str, Any] | UoarmError]:
        """Ask the same of several functions, some at a time; raises as `ask` where none is reached.

        Returns:
            What was answered of each, or why nothing was within `timeout` seconds.
        """
        way, turns = self.way(), asyncio.Semaphore(_AT_ONCE)

        async def ask(robot: RemoteRobot, kind: str) -> Mapping[str, Any] | UoarmError:
            async with turns:
                try:
                    asking = robot.ask(op, kind, **way)
                    answer: Mapping[str, Any] = await asyncio.wait_for(asking, timeout)
                except UoarmError as error:
                    return error
                except asyncio.TimeoutError:
                    return BridgeTimeoutError(f"no answer to {op} {kind} within {timeout:g} s")
                return answer

        async def ask_all(robot: RemoteRobot) -> list[Mapping[str, Any] | UoarmError]:
            return await asyncio.gather(*(ask(robot, kind) for kind in kinds))

        limit = timeout * (1 + len(kinds) // _AT_ONCE)
        return self.run(ask_all, limit, f"{op} of {len(kinds)} functions")

    def run(
        self,
        work: Callable[[RemoteRobot], Coroutine[Any, Any, T]],
        timeout: float,
        what: str,
    ) -> T:
        """Run a coroutine in the loop; otherwise as `ask`."""
        self._begin()
        deadline = time.monotonic() + timeout
        self._await_attempt(deadline)
        future = asyncio.run_coroutine_threadsafe(self._within(work), self._loop)
        while not future.done() and (left := deadline - time.monotonic()) > 0:
            concurrent.futures.wait((future,), wait_step(left))
        try:
            return future.result(0)
        except concurrent.futures.TimeoutError:
            future.cancel()
            text = f"{self.place}: no answer to {what} within {timeout:g} s"
            raise BridgeTimeoutError(text) from None
        except concurrent.futures.CancelledError:
            raise self._closed(what) from None
        except UoarmError as error:
            raise translated(self.place, error) from error

    @property
    def place(self) -> str:
        """The other manager, as errors name it."""
        return f"the manager at {self._options.url}"

    def start(self, work: Callable[[], Coroutine[Any, Any, object]]) -> None:
        """Run a coroutine in the loop, up or not, and wait for nothing; what it raises is lost."""
        with self._lock:
            if self._thread is not None and not self._is_closing:
                asyncio.run_coroutine_threadsafe(work(), self._loop)

    def join(self, member: LinkMember) -> None:
        """Have a member learn of the link from now on."""
        with self._lock:
            self._members[member] = None

    def leave(self, member: LinkMember) -> None:
        """Have a member learn nothing more."""
        with self._lock:
            self._members.pop(member, None)

    def drop(self) -> None:
        """Break the connection, so that a command which has not gone out never does."""
        robot = self._robot
        if robot is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(robot.drop)

    def close(self) -> None:
        """End the link and its thread; waits two seconds at most."""
        with self._lock:
            self._is_closing = True
            thread, closing = self._thread, self._closing
        if thread is None:
            self._loop.close()
            return
        if closing is not None:
            self._loop.call_soon_threadsafe(closing.set)
        thread.join(_JOIN_SECONDS)

    def _begin(self) -> None:
        with self._lock:
            if self._is_closing:
                raise self._closed("a question")
            if self._thread is None:
                thread = threading.Thread(
                    target=self._main, name=f"uoarm-remote {self._name}", daemon=True
                )
                self._closing = asyncio.Event()
                thread.start()
                self._thread = thread

    def _await_attempt(self, deadline: float) -> None:
        """Wait for the first attempt, which is given the time that an answer may take."""
        while (left := deadline - time.monotonic()) > 0 and not self._tried.wait(wait_step(left)):
            pass

    def _closed(self, what: str) -> BridgeError:
        return BridgeError(f"{self.place}: closed before {what}", FailureReason.CLOSED)

    def _main(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._run())
        finally:
            self._tried.set()
            for task in asyncio.all_tasks(self._loop):
                task.cancel()
            self._loop.run_until_complete(asyncio.sleep(0))
            self._loop.close()

    async def _run(self) -> None:
        assert self._closing is not None, "made before the thread"
        ticking = asyncio.ensure_future(self._tick())
        closing, failed = asyncio.ensure_future(self._closing.wait()), 0
        try:
            while not closing.done():
                cause = await self._session(closing)
                failed = 1 if self._is_up else failed + 1
                self._down(cause)
                await asyncio.wait((closing,), timeout=_BACKOFF.pause(failed))
        finally:
            ticking.cancel()
            closing.cancel()

    async def _session(self, closing: asyncio.Future[Any]) -> str:
        """Connect and stay until the connection ends for good; returns why."""
        try:
            server = await server_address(self._name, self._options, self._identity())
            began = time.monotonic()
            robot = server.robot(reconnect=_FOREVER, on_link=self._changed)
            async with robot.running(resume=True):
                self._robot = robot
                await robot.ask("List")  # the greeting has come before its answer
                self._greeted(robot, began)
                ended = asyncio.ensure_future(robot.ended())
                await asyncio.wait((closing, ended), return_when=asyncio.FIRST_COMPLETED)
                if not ended.done():
                    ended.cancel()
                    return "the bridge is closed"
                return ended.result()
        except CONNECTING_ERRORS as error:
            return why_unreachable(error, self._options.url)
        except Exception as error:  # noqa: BLE001 - it is reported, and tried again
            self._records.write(logging.ERROR, f"{self.place}: the link failed", error)
            return text_of(error)

    def _greeted(self, robot: RemoteRobot, began: float) -> None:
        self._note_clock(robot.hello, began)
        refuse_loop(self.place, (self._identity(), str(robot.hello.get("manager", ""))))
        self._changed("")

    def _note_clock(self, said: Mapping[str, Any], began: float) -> None:
        """Note their time of day, right to half of the time that the answer took."""
        self._measured = time.monotonic()
        if (there := said.get("time")) is not None:
            self._difference = there - (began + self._measured) / 2

    def _tick_clock(self) -> None:
        robot, now = self._robot, time.monotonic()
        if robot is not None and self._is_up and now - self._measured > _CLOCK_SECONDS:
            self._measured = now
            if self._measuring is None or self._measuring.done():
                self._measuring = asyncio.ensure_future(self._measure(robot, now))

    async def _measure(self, robot: RemoteRobot, began: float) -> None:
        since: dict[str, Any] = (
            {} if self._version is None else {"jsonMessage": {"since": self._version}}
        )
        try:
            status = await robot.ask("Status", **since)
            self._version = status["version"]
            if self._measured == began:  # else it broke meanwhile, or took too long
                self._note_clock(status, began)
        except Exception as error:  # noqa: BLE001 - it is measured again
            _log.debug("%s: its clock was not measured: %s", self.place, error)

    def _changed(self, cause: str) -> None:
        if cause:
            self._down(cause)
            return
        with self._lock:
            self._why_down = ""
            members = tuple(self._members)
        self._down_since = None
        self._tried.set()
        for member in members:
            member.link_is_up()
        if (health := self._disconnection.up()) is not None:
            # What is not open is described again: it may have another structure now.
            self._report(health, f"{self.place} is reached")

    def _down(self, cause: str) -> None:
        with self._lock:
            self.breaks += self._is_up
            self._why_down = cause
            members = tuple(self._members)
        self._measured = -math.inf
        if self._down_since is None:
            self._down_since = time.monotonic()
        self._tried.set()
        for member in members:
            member.link_broke(cause)
        if (health := self._disconnection.down(time.monotonic(), final=False)) is not None:
            self._report(health, f"{self.place}: {cause}")

    async def _within(self, work: Callable[[RemoteRobot], Coroutine[Any, Any, T]]) -> T:
        robot = self._reached()
        task = asyncio.current_task()
        assert task is not None, "it runs in the loop"
        self._asking.add(task)
        try:
            return await work(robot)
        except asyncio.CancelledError:
            if task in self._asking:
                raise  # who asked waits no longer
            raise self._broken() from None
        finally:
            self._asking.discard(task)

    def _reached(self) -> RemoteRobot:
        """Return the other manager.

        Raises:
            BridgeError: it is not reached.
        """
        robot = self._robot
        if robot is None or not self._is_up:
            text = f"it is not reached: {self._why_down}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        return robot

    def _broken(self) -> BridgeError:
        why = f"the link broke before the answer: {self._why_down}"
        return BridgeError(f"{why}; whether it was done is unknown", FailureReason.UNAVAILABLE)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(_TICK_SECONDS)
            since = self._down_since
            if since is not None and time.monotonic() - since > self._options.grace:
                while self._asking:
                    self._asking.pop().cancel()
                for answer in tuple(self._waiting):
                    answer.set_exception(self._broken())
            self._tick_clock()
            self._tick_members()

    def _tick_members(self) -> None:
        # Not in the frame of `_tick`, which would keep the last member while it sleeps.
        with self._lock:
            members = tuple(self._members)
        for member in members:
            member.tick()


async def server_address(name: str, options: ManagerOptions, identity: str = "") -> ServerAddress:
    """Return where another manager is, and how it is greeted.

    Reads the token; for a fingerprint, asks the server for its certificate.

    Args:
        name: of the bridge.
        options: of the bridge.
        identity: of the manager that asks; "": of none.

    Raises:
        ConfigurationError: a file cannot be read, or is wrong.
        OSError: no server listens there.
    """
    token = None if options.token_file is None else _token(Path(options.token_file))
    tls: ssl.SSLContext | Callable[[], ssl.SSLContext] | None = None
    if options.tls is not None:
        tls = renewed(partial(options.tls.context, name))
    elif options.fingerprint is not None:
        tls = await asyncio.to_thread(
            trust_fingerprint, options.url, options.fingerprint, timeout=options.timeout
        )
    return ServerAddress(
        options.url,
        token,
        tls,
        options.timeout,
        options.silence,
        {"Uoarm-Manager": identity} if identity else {},
    )


def why_unreachable(error: BaseException, url: str) -> str:
    """Say why there is no connection to an address, of one of `CONNECTING_ERRORS`."""
    if where := redirection(error, url):
        return where
    if isinstance(error, InvalidStatus):
        return _refusal(error)
    if said := other_protocol(error, url):
        return said
    if isinstance(error, ConnectionRefusedError):
        return "nothing listens there: does `uoarm serve` run?"
    return tls_fault(error, "compare `fingerprint` with what `uoarm serve` prints there")


def _token(path: Path) -> str:
    """Read a token, as it is shown: the file may have been renewed since the last time."""
    try:
        with path.open(encoding="ascii", errors="replace") as stream:
            token = stream.read(_MOST_TOKEN).strip()
    except OSError as error:
        why = reason_of(error, path)
        raise ConfigurationError(f"the token file {path} cannot be read: {why}") from error
    if not token.isascii() or len(token.split()) != 1:
        raise ConfigurationError(f"the token file {path}: expected one token and nothing else")
    return token


def _refusal(error: InvalidStatus) -> str:
    status = error.response.status_code
    why = {
        400: "it speaks another version of the protocol, or is no uoarm server",
        401: "it does not take the token, or wants one: `token_file`",
        403: "it does not let this manager in",
    }.get(status, "it refused")
    said = refusal(error)
    return f"{why} (HTTP {status}{said and f': {said}'})"


_REASONS: Mapping[type[UoarmError], FailureReason] = {
    ResolutionError: FailureReason.UNAVAILABLE,
    ConnectionClosedError: FailureReason.UNAVAILABLE,
    UsageError: FailureReason.BAD_ENDPOINT,
    ConfigurationError: FailureReason.UNAVAILABLE,
    PluginError: FailureReason.UNAVAILABLE,
}
_SERVER_REASONS: Mapping[str, FailureReason] = {"denied": FailureReason.NOT_FOUND}


def translated(place: str, error: UoarmError) -> UoarmError:
    """Return what a bridge raises for an error that came over the link.

    A message that does not fit, and a command that is refused there, stay what they are: they are
    no failure of the link or of the component.
    """
    text = f"{place}: {error}"
    if isinstance(error, MessageError):
        return MessageError(text)
    if isinstance(error, CommandRefusedError):
        return CommandRefusedError(text, error.reason)
    if isinstance(error, BridgeTimeoutError):
        return BridgeTimeoutError(text)
    if isinstance(error, BridgeError):
        return BridgeError(text, error.reason)
    if isinstance(error, ServerError):
        return BridgeError(text, _SERVER_REASONS.get(error.code, FailureReason.REFUSED))
    kinds = (reason for kind, reason in _REASONS.items() if isinstance(error, kind))
    return BridgeError(text, next(kinds, FailureReason.REFUSED))
