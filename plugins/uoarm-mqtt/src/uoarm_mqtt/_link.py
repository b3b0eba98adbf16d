"""The one connection to the broker, and the only place where paho's client is called."""

from __future__ import annotations

import logging
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any
from weakref import WeakSet

from attrs import define, field, frozen
from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from uoarm.bridge import (
    Backoff,
    ChannelMonitor,
    Disconnection,
    LimitedLog,
    close_in_children,
    foreign,
    on_failure,
    text_of,
    tls_fault,
)
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Health
from uoarm_mqtt._client import MOST_IN_FLIGHT, BrokerClient, properties, reason_text
from uoarm_mqtt._options import ConnectionOptions
from uoarm_mqtt._subscriptions import ReceivedMessage, Receiver, Subscriptions

_log = logging.getLogger("uoarm.mqtt")

_STEP_SECONDS = 4.0
"""How long one step waits for the broker: less than the manager does, which knows no cause."""

_CONNECT_SECONDS = 3.0
_GOODBYE_SECONDS = 1.0
_BACKOFF = Backoff(first=0.1, most=2.0)  # paho makes each pause twice the one before
_ROOM_FOR_TOPIC = 65_536
_HEADER = 9  # type, length, packet identifier, length of the topic: at most
_PROPERTIES = 64  # of a message, about: its content type, its expiry, where the reply goes
_NO_SUBSCRIBERS = 0x10
# What trying again does not change: the credentials, the rights, the identifier, the protocol.
_FINAL = frozenset({0x82, 0x84, 0x85, 0x86, 0x87, 0x8A, 0x8C, 0x8E, 0x9C, 0x9D})


@frozen
class PacketOutcome:
    """How a packet ended.

    Attributes:
        failure: why the broker did not take it, "" when it did.
        is_answer: whether the broker said so; else the connection ended before.
        no_subscribers: whether it was taken while no client is subscribed to its topic.
    """

    failure: str = ""
    is_answer: bool = True
    no_subscribers: bool = False


Done = Callable[[PacketOutcome], object]
"""Takes once how a packet ended, from any thread; must return at once."""


def _ignore(_: PacketOutcome) -> None:
    """For packets on whose end nothing depends."""


@define
class _Pending:
    done: Done
    survives: bool  # a break: paho sends it again


@define(eq=False)
class BrokerConnection:
    """Connects at the first use, again after each break, and to nothing once it is closed.

    Callbacks of paho run in its thread; no lock of ours is held while paho is called, since paho
    holds its own while it calls us.

    Attributes:
        report: is called with health, and cause, of the connection.
        breaks: how often it broke.
    """

    name: str
    options: ConnectionOptions
    report: Callable[[Health, str], None]
    breaks: int = 0
    _up: bool = False
    _cause: str = ""  # why it is not up; empty: not known yet
    _running: bool = False
    _closed: bool = False
    _calls: int = 0  # of paho that are under way, which `close` waits for
    _fails: int = 0  # how often what was under way was answered that it failed
    _largest: int | None = None  # octets of a packet that the broker takes
    _most_qos: int = 2  # that it takes
    _may_retain: bool = True
    # When what stood before a break lapses; touched by paho's thread only.
    _lapse_at: float | None = None
    # Guards all that is mutable here: callers in any thread, against paho's.
    _changed: threading.Condition = field(factory=threading.Condition, init=False)
    _subscriptions: Subscriptions = field(factory=Subscriptions, init=False)
    _senders: WeakSet[ChannelMonitor] = field(factory=WeakSet, init=False)
    # Packets that wait for an answer, and answers that came before their packet was noted.
    _pending: dict[tuple[str, int], _Pending] = field(factory=dict, init=False)
    _early: dict[tuple[str, int], PacketOutcome] = field(factory=dict, init=False)
    _records: LimitedLog = field(factory=partial(LimitedLog, "uoarm.mqtt"), init=False)
    _disconnection: Disconnection = field(init=False)
    _client: BrokerClient = field(init=False)

    def __attrs_post_init__(self) -> None:
        """Make the client; nothing is connected."""
        options = self.options
        self._disconnection = Disconnection(options.grace)
        self._client = client = BrokerClient(
            CallbackAPIVersion.VERSION2,
            options.client_id,
            protocol=MQTTProtocolVersion.MQTTv5,
        )
        client.connect_timeout = _CONNECT_SECONDS
        client.reconnect_delay_set(_BACKOFF.first, _BACKOFF.most)  # type: ignore[arg-type]
        client.when_ended, client.when_turned = self._on_ended, self._lapse
        client.most_octets = options.budget.octets + _ROOM_FOR_TOPIC
        client.on_socket_open = _prepare
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
        client.on_publish = lambda _c, _u, mid, reason, _p: self._answer(("p", mid), [reason])
        client.on_subscribe = lambda _c, _u, mid, reasons, _p: self._answer(("s", mid), reasons)
        client.on_unsubscribe = lambda _c, _u, mid, reasons, _p: self._answer(("u", mid), reasons)
        client.on_pre_connect = self._on_pre_connect
        if options.announcement is not None:
            client.will_set(
                options.announcement.topic, options.announcement.will, qos=1, retain=True
            )

    @property
    def _where(self) -> str:
        return f"{self.options.host}:{self.options.port}"

    def require_up(self) -> None:
        """Return when the link is up; the first call connects.

        Raises:
            BridgeError: it is not, or it is closed; the text says why.
        """
        with self._calling():
            with self._changed:
                start = not self._running
                if start:
                    self._running, self._cause = True, ""
            if start:
                self._start()
        with self._changed:
            self._changed.wait_for(lambda: self._up or self._cause or self._closed, _STEP_SECONDS)
            # It may have come up for the moment before `close` says goodbye.
            if self._closed:
                raise self._closed_error()
            if not self._up:
                cause = self._cause or "no answer yet"
                text = f"bridge {self.name!r}: no connection to the broker at {self._where}: "
                text += cause
                raise BridgeError(text, FailureReason.UNAVAILABLE)

    def subscribe(self, receiver: Receiver, *, settled: bool = False) -> None:
        """Subscribe for a receiver; returns when the broker has said yes.

        With `settled`, when it has sent what is retained, where it sends that before it answers.

        Raises:
            BridgeError: the broker refuses, or the link is not up.
        """
        self.require_up()
        with self._changed:
            qos = self._subscriptions.add(receiver)
        with on_failure(self.unsubscribe, receiver):
            what = f"subscribing to {receiver.topic}"
            self._wait("s", what, lambda: self._subscribe(receiver, qos))
            if settled:
                self.barrier()

    def unsubscribe(self, receiver: Receiver) -> None:
        """Give a receiver nothing more; returns at once."""
        with self._changed:
            is_last = self._subscriptions.remove(receiver)
        if is_last:
            with suppress(BridgeError), self._calling():  # a closed link unsubscribes from all
                self._leave(receiver.topic, receiver.id)

    def barrier(self, seconds: float = _STEP_SECONDS) -> None:
        """Return when the broker has worked through all that was sent before.

        Brokers take the packets of one client in order, and this is one that changes nothing.

        Raises:
            BridgeTimeoutError: it has not in so many seconds, or in those of a step.
            BridgeError: the connection is broken, or breaks meanwhile.
        """
        topic = f"uoarm/barrier/{self.options.client_level}"
        self.require_up()
        what, limit = "waiting for what was sent", min(seconds, _STEP_SECONDS)
        self._wait("u", what, lambda: self._client.unsubscribe(topic), limit)

    def drain(self, seconds: float) -> bool:
        """Say whether the broker works through what was sent, in so many seconds."""
        try:
            self.barrier(seconds)
        except BridgeError:
            return False
        return True

    def largest_payload(self, topic: str) -> int:
        """Return how many octets a payload on a topic may have: by our budget, and the broker's."""
        most = self.options.budget.octets
        if self._largest is None:
            return most
        return max(1, min(most, self._largest - len(topic.encode()) - _HEADER - _PROPERTIES))

    def require_taken(self, qos: int, *, retain: bool) -> None:
        """Return when the link is up, to a broker that takes such messages.

        It would end the connection for another, and again when paho repeats it.

        Raises:
            BridgeError: the link is not up; or with REFUSED: it takes none.
        """
        self.require_up()
        wrong = f"QoS {self._most_qos} at most (qos)" if qos > self._most_qos else ""
        if retain and not self._may_retain:
            wrong = "nothing to be retained (retain)"
        if wrong:
            text = f"bridge {self.name!r}: the broker at {self._where} takes {wrong}"
            raise BridgeError(text, FailureReason.REFUSED)

    def join(self, sender: ChannelMonitor) -> None:
        """Have what the broker refused of a sender end with the connection: the next may take it.

        Another broker may answer at the same address, or one with other rights.
        """
        with self._changed:
            self._senders.add(sender)

    def publish(
        self,
        topic: str,
        payload: bytes,
        done: Done = _ignore,
        *,
        qos: int = 1,
        retain: bool = False,
        more: Mapping[str, Any] | None = None,
    ) -> None:
        """Publish a message; returns at once. `done`, if given, is called once, from any thread.

        Raises:
            BridgeError: the link is down, or the broker takes none such; `done` is not called.
            MessageError: it is larger than the broker takes.
        """
        self.require_taken(qos, retain=retain)
        said = properties("PUBLISH", **(more or {}))
        written: bytes = said.pack()  # type: ignore[no-untyped-call]
        size = len(topic.encode()) + len(payload) + len(written) + _HEADER
        if self._largest is not None and size > self._largest:
            # The broker would end the connection for it, and again when paho repeats it.
            text = f"{topic}: {size:,} octets, while the broker takes {self._largest:,} at most"
            raise MessageError(text)
        with self._calling() as fails:
            info = self._client.publish(topic, payload, qos, retain, said)
            # Not connected any more: paho keeps what has a QoS, and sends it when it is.
            if info.rc and not (qos and info.rc == MQTTErrorCode.MQTT_ERR_NO_CONN):
                text = f"bridge {self.name!r}: {topic}: not sent: {info.rc.name}"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            self._note(("p", info.mid), _Pending(done, survives=qos > 0), fails)

    def close(self) -> None:
        """Say goodbye, where a broker is there to take it, and end paho's thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            # Below, what they have started is ended, and what they have noted is answered.
            self._changed.wait_for(lambda: not self._calls, _STEP_SECONDS)
            was_up = self._up
        said = self.options.announcement
        if was_up and said is not None:
            self._announce(said.topic, said.offline())
        self._client.disconnect(properties=properties("DISCONNECT", SessionExpiryInterval=0))
        with self._changed:
            self._changed.wait_for(lambda: not self._up, _GOODBYE_SECONDS)
        if (stuck := self._client.socket()) is not None:
            assert isinstance(stuck, socket.socket)  # of no WebSocket
            with suppress(OSError):  # the broker takes nothing: paho's thread would wait for it
                stuck.shutdown(socket.SHUT_RDWR)
        self._client.loop_stop()
        self._client.release()
        self._fail("the bridge was closed", everything=True)

    def _closed_error(self) -> BridgeError:
        text = f"bridge {self.name!r}: the connection to the broker is closed"
        return BridgeError(text, FailureReason.CLOSED)

    @contextmanager
    def _calling(self) -> Iterator[int]:
        """Call paho, and note what it was given, in any thread; `close` waits for the end of it.

        Yields how often what was under way has failed before, for the note.

        Raises:
            BridgeError: the connection is closed.
        """
        with self._changed:
            if self._closed:
                raise self._closed_error()
            self._calls += 1
            fails = self._fails
        try:
            yield fails
        finally:
            with self._changed:
                self._calls -= 1
                if not self._calls:
                    self._early.clear()  # all is noted: these are of what was never sent
                self._changed.notify_all()

    def _start(self) -> None:
        options = self.options
        wanted: dict[str, Any] = {
            "SessionExpiryInterval": max(1, int(options.grace)),
            "ReceiveMaximum": MOST_IN_FLIGHT,
            "MaximumPacketSize": self._client.most_octets,
        }
        self._client.connect_async(
            options.host,
            options.port,
            options.keepalive,
            properties=properties("CONNECT", **wanted),
        )
        try:
            # A thread that has just given up may still be ending.
            cause = "the attempt before is still ending" if self._client.loop_start() else ""
        except RuntimeError as error:
            cause = text_of(error)
        if cause:
            with self._changed:
                self._running, self._cause = False, cause

    def _announce(self, topic: str, payload: str) -> None:
        info = self._client.publish(topic, payload, 1, retain=True)
        self._note(("p", info.mid), _Pending(_ignore, survives=True))

    def _leave(
        self, topic: str, id_: int, ended: Callable[[PacketOutcome], object] = _ignore
    ) -> None:
        _, mid = self._client.unsubscribe(topic)
        if mid is None:
            return  # not connected: it is left once it is

        def done(outcome: PacketOutcome) -> None:
            if outcome.is_answer:
                with self._changed:
                    self._subscriptions.left(topic, id_)
            ended(outcome)

        self._note(("u", mid), _Pending(done, survives=False))

    def _subscribe(self, receiver: Receiver, qos: int) -> Any:
        wanted = SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE
        handling = wanted if receiver.retained else SubscribeOptions.RETAIN_DO_NOT_SEND
        options = SubscribeOptions(qos=qos, retainHandling=handling)
        return self._client.subscribe(
            [(receiver.topic, options)],
            properties=properties("SUBSCRIBE", SubscriptionIdentifier=receiver.id),
        )

    def _wait(
        self, kind: str, what: str, send: Callable[[], Any], seconds: float = _STEP_SECONDS
    ) -> None:
        """Send a packet and wait for its answer."""
        outcomes: list[PacketOutcome] = []
        answered = threading.Event()

        def done(outcome: PacketOutcome) -> None:
            outcomes.append(outcome)
            answered.set()

        with self._calling() as fails:
            rc, mid = send()
            if rc or mid is None:
                text = f"bridge {self.name!r}: {what}: the connection to the broker is broken"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            self._note((kind, mid), _Pending(done, survives=False), fails)
        if not answered.wait(seconds):
            raise BridgeTimeoutError(f"bridge {self.name!r}: {what}: the broker does not answer")
        (outcome,) = outcomes
        if outcome.failure:
            text = f"bridge {self.name!r}: {what}: {outcome.failure}"
            is_refused = outcome.is_answer
            reason = FailureReason.REFUSED if is_refused else FailureReason.UNAVAILABLE
            raise BridgeError(text, reason)

    def _note(self, key: tuple[str, int], pending: _Pending, fails: int | None = None) -> None:
        """Note what waits for an answer; `fails`: as `_calling` yielded, in another thread."""
        with self._changed:
            early = self._early.pop(key, None)
            if early is None and not pending.survives and fails not in {None, self._fails}:
                why = self._cause or "the connection broke"  # in between
                early = PacketOutcome(why, is_answer=False)
            if early is None:
                self._pending[key] = pending
        if early is not None:
            pending.done(early)

    def _answer(self, key: tuple[str, int], reasons: Any) -> None:
        # UNSUBACK: that there was no such subscription is what a barrier expects.
        failed = key[0] != "u" and any(reason.is_failure for reason in reasons)
        failure = f"the broker refuses: {reason_text(reasons[0])}" if failed else ""
        no_subscribers = key[0] == "p" and reasons[0].value == _NO_SUBSCRIBERS
        outcome = PacketOutcome(failure, no_subscribers=no_subscribers)
        with self._changed:
            pending = self._pending.pop(key, None)
            if pending is None:
                self._early[key] = outcome
        if pending is not None:
            pending.done(outcome)

    def _fail(self, cause: str, *, everything: bool = False) -> None:
        """Answer what the broker will not answer any more."""
        with self._changed:
            self._fails += 1
            gone = [
                key for key, pending in self._pending.items() if everything or not pending.survives
            ]
            failed = [self._pending.pop(key) for key in gone]
        for pending in failed:
            pending.done(PacketOutcome(cause, is_answer=False))

    def _on_pre_connect(self, client: Client, user: Any) -> None:
        del client, user
        self._client.show(self.options.credentials())

    def _on_connect(
        self, client: Client, user: Any, flags: ConnectFlags, reason: ReasonCode, more: object
    ) -> None:
        del client, user
        self._client.is_answered = True
        if reason.is_failure:
            self._down(f"the broker refuses: {reason_text(reason)}", final=reason.value in _FINAL)
            return
        if not flags.session_present:
            self._client.forget_unfinished()
        self._largest = getattr(more, "MaximumPacketSize", None)
        self._most_qos = getattr(more, "MaximumQoS", 2)
        self._may_retain = bool(getattr(more, "RetainAvailable", True))
        self._client.keep_within(getattr(more, "ReceiveMaximum", MOST_IN_FLIGHT))
        with self._changed:
            leaving = self._subscriptions.resume(is_same=flags.session_present)
            receivers = [
                (receiver, self._subscriptions.add(receiver)) for receiver in self._subscriptions
            ]
            senders = tuple(self._senders)
        for sender in senders:  # before paho sends again what may be refused again
            sender.passed()
        left = len(receivers) + len(leaving)

        def ready() -> None:
            # What is retained may come after the answers.
            self._lapse_at = time.monotonic() + max(self.options.grace, _STEP_SECONDS)
            with self._changed:
                self._up, self._cause = True, ""
                self._changed.notify_all()
                health = self._disconnection.up()
            if health is not None:
                self.report(health, "connected to the broker")

        def answered(outcome: PacketOutcome) -> None:
            nonlocal left
            left -= outcome.is_answer  # else it broke again
            if not left:
                ready()

        def resumed(receiver: Receiver, outcome: PacketOutcome) -> None:
            if outcome.is_answer and outcome.failure:
                receiver.refused(outcome.failure)
            answered(outcome)

        # What is not left yet takes messages from those that share it.
        for left_topic, id_ in leaving:
            self._leave(left_topic, id_, answered)
        if (said := self.options.announcement) is not None:
            self._announce(said.topic, said.online())
        for receiver, qos in receivers:
            _, mid = self._subscribe(receiver, qos)
            if mid is not None:
                pending = _Pending(partial(resumed, receiver), survives=False)
                self._note(("s", mid), pending)
        if not (receivers or leaving):
            ready()

    def _on_connect_fail(self, client: Client, user: Any) -> None:
        del client, user
        error = sys.exc_info()[1]  # paho calls this while it handles it
        why = tls_fault(error) if error else "it could not be reached"
        if isinstance(error, ConnectionResetError):  # in the handshake
            why = f"it ended before TLS was spoken: is that spoken there (`mqtts://`)? {why}"
        self._down(why)

    def _on_disconnect(
        self,
        client: Client,
        user: Any,
        flags: DisconnectFlags,
        reason: ReasonCode,
        more: Properties | None,
    ) -> None:
        del client, user, more
        by_broker = flags.is_disconnect_packet_from_server
        if by_broker:
            text = f"the broker ended the connection: {reason_text(reason)}"
            self._down(text, final=reason.value in _FINAL)
        else:
            self._down(self._client.why_broken(reason))

    def _on_ended(self, error: Exception | None) -> None:
        if error is not None:
            self._down(f"the MQTT client failed: {text_of(error)}", final=True)
        with self._changed:
            self._running = False

    def _on_message(self, client: Client, user: Any, message: MQTTMessage) -> None:
        del client, user
        payload = bytes(message.payload)
        try:
            came = ReceivedMessage(message.topic, payload, message.retain, message.properties)
        except UnicodeDecodeError:  # no broker lets such a topic through
            return
        with self._changed:
            receivers = self._subscriptions.route(came)
        for receiver in receivers:
            self._give(receiver, came)

    def _give(self, receiver: Receiver, came: ReceivedMessage) -> None:
        try:
            foreign(receiver.give, came)
        except Exception as error:  # noqa: BLE001 - a message of one topic ends no other
            text = f"{self.name}: a message on {came.topic} was not taken"
            self._records.write(logging.ERROR, text, error)

    def _lapse(self) -> None:
        """End what stood before a break and was not said again; in the thread of messages."""
        if self._lapse_at is None or time.monotonic() < self._lapse_at:
            return
        self._lapse_at = None
        with self._changed:
            lapsed = [(receiver, receiver.lapsed()) for receiver in self._subscriptions]
        for receiver, topics in lapsed:
            for topic in topics:
                self._give(receiver, ReceivedMessage(topic, b""))

    def _down(self, cause: str, *, final: bool = False) -> None:
        self._lapse_at = None
        with self._changed:
            was_up, self._up = self._up, False
            if was_up or not self._cause:  # paho reports a refusal a second time, in other words
                self._cause = cause
            self.breaks += was_up
            health = (
                None if self._closed else self._disconnection.down(time.monotonic(), final=final)
            )
            is_over = final or self._disconnection.is_over
            self._changed.notify_all()
        self._fail(cause)
        if health is not None:
            self.report(health, f"the broker at {self._where}: {cause}")
        if is_over:
            self._client.disconnect()  # ends the thread, and the attempts


def _prepare(client: Client, user: Any, opened: Any) -> None:
    """Have small packets sent at once, instead of up to 40 ms later, and no child hold the socket.

    The broker publishes the last will once no process has it.
    """
    del client, user
    close_in_children(opened)
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
