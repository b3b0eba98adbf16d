"""The one connection to a rosbridge server, and what waits for what comes on it."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import count
from typing import Any

from attrs import define, field
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.frames import CloseCode
from websockets.sync.client import ClientConnection, connect

from uoarm.bridge import (
    Backoff,
    Disconnection,
    close_in_children,
    other_protocol,
    redirection,
    refusal,
    tls_fault,
)
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    ControlMessageError,
    FailureReason,
    MessageError,
)
from uoarm.model import BudgetUse, Health
from uoarm.server.front_end import read_binary, read_text
from uoarm_rosbridge.client._options import ClientOptions, ServerAccess

Fields = Mapping[str, Any]

_STEP_SECONDS = 4.0  # for the connection: less than the manager waits, and the error says why
_CONNECT_SECONDS = 3.0
_GOODBYE_SECONDS = 0.5
_JOIN_SECONDS = 2.0
_BACKOFF = Backoff(first=0.1, most=5.0)
_LONGEST_PATIENCE_SECONDS = 60.0
_QUICKEST_SECONDS = 0.25
_STEADY_SECONDS = 5.0
_LIBRARY_LOG = logging.getLogger("uoarm.rosbridge.websockets")
_LIBRARY_LOG.setLevel(logging.CRITICAL)  # each silence would be there with a traceback
_FINAL = (401, 403)  # answers to the handshake that no other attempt changes
_MOST_WAITING = 1024
_ROOM_FOR_FIELDS = 65_536
_SERVED = {"call_service": "service", "send_action_goal": "action", "cancel_action_goal": "action"}
_WELL = {"rosapi": "answers again", "frames": "can be read again"}


@define(eq=False)
class _Pending:
    """A call, or a goal, that has not been answered."""

    done: threading.Event = field(factory=threading.Event)
    answer: Fields | None = None
    failure: str = ""


@define(eq=False)
class SubscribedTopic:
    """One topic: the operation that the server knows, what takes its messages, and the last one."""

    fields: Fields
    takes: tuple[Callable[[Any], None], ...]
    newest: Any = None


class ServerConnection:
    """Connects at the first use, again after each break, and to nothing once it is closed.

    What stands at the server (subscriptions, and what is advertised) ends there with a connection:
    it is sent again, in its order, with the next one. A request is sent once.

    What comes is handed on in the connection's thread: what takes it must return at once.

    Args:
        access: reads what the server is shown, for each attempt to connect.
        questions: what asks rosapi; left out: this connection.

    Attributes:
        serving: what takes the calls of a service, or the goals of an action, by which and name.
        watchers: are called with why the connection broke, and with nothing when it is up again.
        breaks: how often it broke.
        patient_until: monotonic seconds; until then a robot may be as incomplete as after a break.
    """

    def __init__(
        self,
        name: str,
        options: ClientOptions,
        access: Callable[[], ServerAccess],
        report: Callable[[Health, str], None],
        questions: ServerConnection | None = None,
    ) -> None:
        self.options = options
        self._read_access = access
        self._questions = questions or self
        self.serving: dict[tuple[str, str], Callable[[Fields], None]] = {}
        self.watchers: tuple[Callable[[str], None], ...] = ()
        self.breaks = 0
        self.patient_until = 0.0
        self._name, self._report = name, report
        # Guards the state of the connection, and what waits for answers, between the connection's
        # thread and those of steps. Nothing is sent, and no receiver called, under it.
        self._changed = threading.Condition()
        self._socket: ClientConnection | None = None
        self._thread: threading.Thread | None = None
        self._cause = ""  # why it is not up; empty: not known yet
        self._is_closed = False
        self._is_hurried = False  # whether the next attempt waits for nothing
        # Since when a request was answered too late, and none in time; and how long that may last.
        self._unanswered_since: float | None = None
        self._patience = options.wait
        # What is wrong although it is up, with the last frame or the last question, by its name.
        self._troubles: dict[str, str] = {}
        # Octets of the longest message of this connection, and of those that the server has ended
        # one for: it has no operation that states its limit.
        self._longest = 0
        self._refused: int | None = None
        self._disconnection = Disconnection(options.grace)
        # Guards the two tables of what stands at the server, and the order in which that is sent:
        # what stands when a connection begins is sent with it, all else by who has it stand.
        self._standing_lock = threading.RLock()
        self._standing: dict[str, Fields] = {}
        self._topics: dict[str, SubscribedTopic] = {}
        self._pending: dict[str, _Pending] = {}
        self._statuses: dict[str, Callable[[str], None]] = {}
        self._numbers = count(1)

    @property
    def is_up(self) -> bool:
        """Whether it is connected."""
        return self._socket is not None

    def new_id(self, what: str) -> str:
        """Return an id that nothing else here has."""
        return f"{what}:{next(self._numbers)}"

    def require_up(self) -> ClientConnection:
        """Return when it is connected; the first call connects.

        Raises:
            BridgeError: it is not, or it is closed; the text says why.
        """
        with self._changed:
            if self._thread is None and not self._is_closed:
                name = f"uoarm-rosbridge-{self._name}"
                thread = threading.Thread(target=self._run, name=name, daemon=True)
                thread.start()
                self._thread = thread
            self._changed.wait_for(
                lambda: self._socket is not None or self._cause or self._is_closed, _STEP_SECONDS
            )
            if self._socket is not None:
                return self._socket
            if self._is_closed:
                text = f"bridge {self._name!r}: the connection to {self.options.url} is closed"
                raise BridgeError(text, FailureReason.CLOSED)
            raise self._down(self._cause or "no answer yet")

    def send(self, fields: Fields) -> None:
        """Send an operation; waits while the server reads nothing, until it counts as lost.

        Raises:
            BridgeError: the connection is down, or breaks.
            MessageError: something in it has no form as JSON, or it is as long as a message for
                which the server has ended the connection.
        """
        self.send_text(json_text(fields))

    def send_text(self, text: str) -> None:
        """Send an operation that is written already; as `send`."""
        octets = len(text) if text.isascii() else len(text.encode())
        if self._refused is not None and octets >= self._refused:
            why = f"the server has ended the connection for one of {self._refused:,}"
            raise MessageError(f"the message has {octets:,} octets: {why}")
        socket = self.require_up()
        self._longest = max(self._longest, octets)
        try:
            socket.send(text)
        except (ConnectionClosed, OSError) as error:
            raise self._down(_cause_of(error)) from error

    def request(self, fields: Fields, timeout: float) -> Fields:
        """Send an operation and return the one that answers it, by its id.

        Raises:
            BridgeError: the connection is down, or breaks before the answer.
            BridgeTimeoutError: no answer within `timeout` seconds.
        """
        pending, identity = _Pending(), fields["id"]
        self._leave_what_is_held_up()
        with self._changed:
            if len(self._pending) >= _MOST_WAITING:
                raise self._down(f"{_MOST_WAITING} requests wait for an answer already")
            self._pending[identity] = pending
        try:
            self.send(fields)
            if not pending.done.wait(timeout):
                with self._changed:
                    self._unanswered_since = self._unanswered_since or time.monotonic()
                raise BridgeTimeoutError(
                    f"bridge {self._name!r}: {self.options.url}: no answer to {fields['op']} "
                    f"within {timeout:g} s"
                )
        finally:
            with self._changed:
                self._pending.pop(identity, None)
        if pending.answer is None:
            raise self._down(pending.failure)
        return pending.answer

    def hurry(self) -> None:
        """Have the next attempt to connect made at once, if there is one to come."""
        with self._changed:
            if self._socket is None and self._thread is not None:
                self._is_hurried, self._cause = True, ""
                self._changed.notify_all()

    def settle(self, within: float | None = None) -> None:
        """Return when the server has worked through what was sent on this connection.

        It works through that in order, so a question at its end says so; but one that rosapi leaves
        unanswered holds up all that comes after it. Hence rosapi is first asked elsewhere.

        Raises:
            BridgeError: as `rosapi`.
        """
        self.rosapi("get_time", within)
        self._ask("get_time", within, {})

    def rosapi(self, service: str, within: float | None = None, /, **arguments: str) -> Fields:
        """Call a service of rosapi and return the values of its answer.

        Args:
            service: its name.
            within: seconds that it has; the option `wait` unless given, and that at most.
            arguments: of the service.

        Raises:
            BridgeError: it is not there, or fails.
        """
        try:
            values = self._questions._ask(service, within, arguments)  # noqa: SLF001 - of this class
        except BridgeTimeoutError as error:
            if within is None or within >= self.options.wait:
                self._note("rosapi", str(error))
            raise
        self._note("rosapi", "")
        return values

    def ask_again(self) -> None:
        """Ask rosapi whether it answers again, where it did not.

        Raises:
            BridgeError: as `rosapi`.
        """
        if "rosapi" in self._troubles:
            self.rosapi("get_time")
        if "frames" in self._troubles:  # nothing else may come for long
            self._ask("get_time", None, {})

    def _note(self, what: str, trouble: str) -> None:
        """Report that something is wrong, or is well again, and what else is wrong still."""
        with self._changed:
            if (what in self._troubles) is bool(trouble) or not self.is_up:
                return
            self._troubles.pop(what, "")
            if trouble:
                self._troubles[what] = trouble
            cause = trouble or next(iter(self._troubles.values()), "")
        well = f"{what} of {self.options.url} {_WELL[what]}"
        self._report(Health.DEGRADED if cause else Health.OK, cause or well)

    def _ask(self, service: str, within: float | None, arguments: Fields) -> Fields:
        seconds = self.options.wait if within is None else min(self.options.wait, within)
        fields = {
            "op": "call_service", "id": self.new_id("rosapi"), "service": f"/rosapi/{service}",
            "args": arguments, "timeout": seconds,
        }  # fmt: skip
        try:
            answer = self.request(fields, seconds)
        except BridgeTimeoutError:
            text = (
                f"bridge {self._name!r}: {self.options.url}: no answer of /rosapi/{service} within "
                f"{seconds:g} s: does rosapi still run there?"
            )
            raise BridgeTimeoutError(text) from None
        values = answer.get("values")
        if answer.get("result") is False or not isinstance(values, dict):
            why = str(values)[:300]
            is_missing = "does not exist" in why or "no service" in why
            hint = ": does rosapi run there?" if is_missing else ""
            text = (
                f"bridge {self._name!r}: {self.options.url}: /rosapi/{service} failed: {why}{hint}"
            )
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        return values

    def stand(self, fields: Fields) -> None:
        """Send an operation that stands at the server from now on, over breaks, by its id.

        Raises:
            BridgeError: the connection is down, or breaks; then nothing stands.
        """
        self.require_up()
        with self._standing_lock:
            self._standing[fields["id"]] = fields
            try:
                self.send(fields)
            except BaseException:
                del self._standing[fields["id"]]
                raise

    def withdraw(self, identity: str, fields: Fields) -> None:
        """Have an operation stand no more, and send the one that ends it if that can be."""
        with self._standing_lock:
            was_there = self._standing.pop(identity, None) is not None
            if was_there and self.is_up:
                with suppress(BridgeError):
                    self.send(fields)

    def subscribe(self, fields: Fields, take: Callable[[Any], None]) -> SubscribedTopic:
        """Have the messages of a topic taken; returns what the server knows of it.

        The server sends each message once to a client, however often that has subscribed: the
        first subscription to a topic is that of all.

        Raises:
            BridgeError: the connection is down, or breaks; then nothing is taken.
        """
        topic = fields["topic"]
        self.require_up()
        with self._standing_lock:
            subscription = self._topics.get(topic)
            if subscription is None:
                subscription = self._topics[topic] = SubscribedTopic(fields, (take,))
                try:
                    self.stand(fields)
                except BaseException:
                    del self._topics[topic]
                    raise
            else:
                subscription.takes = (*subscription.takes, take)
            return subscription

    def unsubscribe(self, topic: str, take: Callable[[Any], None]) -> None:
        """Have them taken no more; the last one to do so ends the subscription."""
        with self._standing_lock:
            subscription = self._topics.get(topic)
            if subscription is None:
                return
            subscription.takes = tuple(taking for taking in subscription.takes if taking != take)
            if not subscription.takes:
                del self._topics[topic]
                fields = {"op": "unsubscribe", "topic": topic}
                self.withdraw(subscription.fields["id"], fields)

    def on_status(self, identity: str, report: Callable[[str], None]) -> None:
        """Have statuses of the level error that belong to an operation handed on."""
        with self._changed:
            self._statuses[identity] = report

    def forget_status(self, identity: str) -> None:
        """Have them handed on no more."""
        with self._changed:
            self._statuses.pop(identity, None)

    def close(self) -> None:
        """End the connection and its thread."""
        with self._changed:
            self._is_closed = True
            socket, thread = self._socket, self._thread
            self._changed.notify_all()
        if socket is not None:
            with suppress(OSError, ConnectionClosed):
                socket.close()
        if thread is not None and thread is not threading.current_thread():
            thread.join(_JOIN_SECONDS)

    def _leave_what_is_held_up(self) -> None:
        """Begin another connection where a request may hold up all others for ever.

        That of a service that hangs, or whose node died, does in rosbridge_suite.
        """
        with self._changed:
            since, socket = self._unanswered_since, self._socket
            if socket is None or since is None or self._pending or self._standing:
                return
            if time.monotonic() - since < self._patience:
                return
            # What it leaves at the server may stay there: so ever more seldom.
            self._patience = min(2 * self._patience, _LONGEST_PATIENCE_SECONDS)
            self._unanswered_since, self._socket = None, None
            self._is_hurried, self._cause = True, ""
        with suppress(OSError, ConnectionClosed):
            socket.close()

    def _down(self, cause: str) -> BridgeError:
        text = f"bridge {self._name!r}: no connection to {self.options.url}: {cause}"
        return BridgeError(text, FailureReason.UNAVAILABLE)

    def _run(self) -> None:
        failed = 0
        while not self._is_closed:
            try:
                access = self._read_access()
                with self._connect(access) as socket:
                    close_in_children(socket.socket)
                    begun = time.monotonic()
                    self._begin(socket, access)
                    cause, final = self._read(socket)
                    self._lose(cause, final=final)
                    # One that breaks at once is not begun again at once, for ever.
                    if time.monotonic() - begun > _STEADY_SECONDS:
                        failed = 0
            except Exception as error:  # noqa: BLE001 - of a URL, TLS, sockets: it is reported
                cause = _cause_of(error, self.options.url)
                if self.is_up:
                    self._lose(cause)
                else:
                    self._set(None, cause)
                    self._judge(cause, final=_is_final(error))
            failed += 1
            pause, left = _BACKOFF.pause(failed), self._disconnection.left(time.monotonic())
            with self._changed:
                until = pause if left is None else min(pause, left)
                if self._changed.wait_for(lambda: self._is_closed or self._is_hurried, until):
                    self._is_hurried, failed = False, 0

    def _connect(self, access: ServerAccess) -> ClientConnection:
        options, left = self.options, self._disconnection.left(time.monotonic())
        limit = _CONNECT_SECONDS if left is None else max(left, _QUICKEST_SECONDS)
        return connect(
            options.url,
            ssl=access.context,
            additional_headers=dict(access.headers),
            compression=None,
            open_timeout=min(limit, _CONNECT_SECONDS),
            ping_interval=options.silence / 2,
            ping_timeout=options.silence / 2,
            close_timeout=_GOODBYE_SECONDS,
            max_size=options.budget.octets + _ROOM_FOR_FIELDS,
            proxy=None,
            logger=_LIBRARY_LOG,
        )

    def _begin(self, socket: ClientConnection, access: ServerAccess) -> None:
        self._longest = 0
        if access.authentication is not None:
            socket.send(json.dumps(access.authentication()))
        with self._standing_lock:
            for fields in self._standing.values():
                socket.send(json.dumps(fields, allow_nan=False))
            self._set(socket, "")
        for watcher in self.watchers:
            watcher("")
        if (health := self._disconnection.up()) is not None:
            self._report(health, f"{self.options.url} answers again")

    def _read(self, socket: ClientConnection) -> tuple[str, bool]:
        """Take what comes until the connection ends; returns why it did, and whether for good."""
        refused = None  # after any other end another server may answer next
        try:
            for frame in socket:
                self._take(frame)
        except ConnectionClosed as error:
            ended = error.rcvd if error.rcvd_then_sent else error.sent  # the answer has its code
            if ended is not None and ended.code == CloseCode.MESSAGE_TOO_BIG:
                if error.rcvd_then_sent:
                    refused = self._longest
                    text = f"a message of {self._longest:,} octets is too long for the server"
                    return text, False
                most = self.options.budget.octets
                return f"a message came that is larger than `max_octets`, {most:,}", True
            if ended is not None and ended.code == CloseCode.INTERNAL_ERROR and ended is error.sent:
                return f"no answer to pings for {self.options.silence:g} s", False
            return _cause_of(error), False
        except OSError as error:
            return _cause_of(error), False
        finally:
            self._refused = refused
        return "the server closed the connection", False

    def _take(self, frame: str | bytes) -> None:
        spending = BudgetUse(self.options.budget)
        try:
            if isinstance(frame, str):
                fields = read_text(frame, spending)
            else:
                fields = read_binary(frame, spending)
        except ControlMessageError as error:
            self._note("frames", f"{self.options.url} sends what cannot be read: {error}")
            return
        if self._troubles:
            self._note("frames", "")
        if not isinstance(fields, dict):
            return
        op = fields.get("op")
        if op == "publish":
            if (subscription := self._topics.get(str(fields.get("topic")))) is not None:
                # Before it is handed on: who is added meanwhile finds it, or has it handed on.
                subscription.newest = fields.get("msg")
                for take in subscription.takes:
                    take(subscription.newest)
        elif op in {"service_response", "action_result"}:
            self._answer(fields)
        elif op in _SERVED:
            name = str(fields.get(_SERVED[op]))
            if (serve := self.serving.get((_SERVED[op], name))) is not None:
                serve(fields)
        elif op == "status" and fields.get("level") == "error":
            with self._changed:
                report = self._statuses.get(str(fields.get("id")))
            if report is not None:
                report(str(fields.get("msg"))[:500])

    def _answer(self, fields: Fields) -> None:
        with self._changed:
            pending = self._pending.get(str(fields.get("id")))
            self._unanswered_since, self._patience = None, self.options.wait
        if pending is not None:
            pending.answer = fields
            pending.done.set()

    def _set(self, socket: ClientConnection | None, cause: str) -> None:
        with self._changed:
            self._socket, self._cause = socket, cause
            self._is_hurried = self._is_hurried and socket is None
            self._changed.notify_all()
            closed = self._is_closed
        if closed and socket is not None:
            with suppress(OSError, ConnectionClosed):
                socket.close()

    def _lose(self, cause: str, *, final: bool = False) -> None:
        self._unanswered_since, self._troubles = None, {}
        with self._changed:
            # What came since it was left for the next connection waits for that one.
            is_left, is_closed = self._is_hurried and not self._is_closed, self._is_closed
            pending = () if is_left else tuple(self._pending.values())
        self._set(None, "" if is_left else cause)
        for request in pending:
            request.failure = cause
            request.done.set()
        if is_closed:
            return
        self.breaks += 1
        self.patient_until = time.monotonic() + self.options.grace
        for watcher in self.watchers:
            watcher(cause)
        self._judge(cause, final=final)

    def _judge(self, cause: str, *, final: bool = False) -> None:
        """Report that it is down where that is news; in the connection's thread alone."""
        health = self._disconnection.down(time.monotonic(), final=final)
        if health is not None and not self._is_closed:
            self._report(health, f"{self.options.url}: {cause}")


def json_text(value: object) -> str:
    """Return a value as JSON.

    Raises:
        MessageError: it has no form there.
    """
    try:
        text = json.dumps(value, allow_nan=False, ensure_ascii=False)
        text.encode()  # half of a surrogate pair cannot be sent
    except (TypeError, ValueError, RecursionError) as error:
        raise MessageError(f"it has no form as JSON: {error}") from error
    return text


def _is_final(error: Exception) -> bool:
    return isinstance(error, InvalidStatus) and error.response.status_code in _FINAL


def _cause_of(error: Exception, url: str = "") -> str:
    if where := redirection(error, url):
        return where
    if isinstance(error, InvalidStatus):
        said = refusal(error) or ("is the token right?" if _is_final(error) else "")
        return f"the server answered with {error.response.status_code}{said and f': {said}'}"
    if said := other_protocol(error, url):
        return said
    if isinstance(error, InvalidHandshake):
        return f"no WebSocket server answers there: {error}"
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return tls_fault(error)
