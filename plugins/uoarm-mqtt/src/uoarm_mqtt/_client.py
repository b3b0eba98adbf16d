"""paho's client as the bridge needs it: how it ends, what it shows, and why it broke."""

from __future__ import annotations

import selectors
import ssl
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Literal

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import MessageState, MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from uoarm.bridge import foreign, tls_fault
from uoarm_mqtt._options import BrokerCredentials

MOST_IN_FLIGHT = 20
_UNSPECIFIED = 0x80
_SHORT_SECONDS = 10.0  # a connection that was up for less broke soon
_AGAIN = 3  # such connections in a row
_TAKEN = MQTTMessage()  # stands for a message until the broker lets it go
_TAKEN.qos = 2
# `select` takes no descriptor above 1,024, and is what Windows has.
_Selector = getattr(selectors, "PollSelector", selectors.SelectSelector)


class PacketTooLargeError(OSError):
    """The broker begins a packet of more octets than it was asked for at most."""


class ThreadedClient(Client):
    """paho's client, whose thread may end while it is waited for, or not begin."""

    def loop_start(self) -> MQTTErrorCode:
        """Begin the thread.

        paho's own takes one that could not begin for one that runs.

        Raises:
            RuntimeError: the system gives no more threads.
        """
        try:
            return super().loop_start()
        except RuntimeError:
            self._thread = None
            self._reset_sockets(sockpair_only=True)
            raise

    def loop_stop(self) -> MQTTErrorCode:
        """End the thread and wait for it.

        paho's own reads the attribute twice, and the thread clears it at its end.
        """
        thread = self._thread
        if thread is None:
            return MQTTErrorCode.MQTT_ERR_INVAL
        self._thread_terminate = True
        if thread is not threading.current_thread():
            thread.join()
        return MQTTErrorCode.MQTT_ERR_SUCCESS


class BrokerClient(ThreadedClient):
    """paho's client, whose thread does not end without a word."""

    when_ended: Callable[[Exception | None], None]
    when_turned: Callable[[], None]  # at least once a second, while it is connected
    is_answered: bool  # whether the broker answered the attempt that was begun last
    most_octets: int  # of a packet, as the broker was asked
    _broken_by: OSError | None
    _began = 0.0
    _short = 0  # connections in a row that broke soon
    _pause: int | None = None  # paho has it so, also of fractions
    # Of a message of QoS 2: its number, and whether it came before.
    _received: tuple[int, bool] | None = None

    def loop_forever(
        self,
        timeout: float = 1.0,
        retry_first_connection: bool = False,  # noqa: FBT001, FBT002 - paho's signature
    ) -> MQTTErrorCode:
        cause = None
        try:
            return foreign(super().loop_forever, timeout, retry_first_connection)
        except Exception as error:  # noqa: BLE001 - whatever ends the thread is reported
            cause = error
            return MQTTErrorCode.MQTT_ERR_UNKNOWN
        finally:
            self.when_ended(cause)

    def _loop(self, timeout: float = 1.0) -> MQTTErrorCode:
        """Wait for what comes or may be sent, and do it; as paho's own, which uses `select`."""
        link, waker = self._sock, self._sockpairR
        if link is None or waker is None:
            return MQTTErrorCode.MQTT_ERR_NO_CONN
        is_read = isinstance(link, ssl.SSLSocket) and link.pending()
        wanted = selectors.EVENT_WRITE if self.want_write() else 0
        with _Selector() as selector:
            try:
                selector.register(link, selectors.EVENT_READ | wanted)
            except ValueError:  # it has been closed
                return MQTTErrorCode.MQTT_ERR_CONN_LOST
            selector.register(waker, selectors.EVENT_READ)
            ready = {
                key.fileobj: events for key, events in selector.select(0 if is_read else timeout)
            }
        rc = MQTTErrorCode.MQTT_ERR_SUCCESS
        if is_read or ready.get(link, 0) & selectors.EVENT_READ:
            rc = self.loop_read()
        if waker in ready:  # something is to be sent that was not when the waiting began
            with suppress(BlockingIOError):
                waker.recv(10_000)
        if not rc and self._sock and (waker in ready or ready.get(link, 0) & selectors.EVENT_WRITE):
            rc = self.loop_write()
        if rc or self._sock is None:
            return rc
        self.when_turned()
        return self.loop_misc()

    def show(self, credentials: BrokerCredentials) -> None:
        """Show the broker these from the next connection on."""
        self.is_answered, self._broken_by, self._began = False, None, time.monotonic()
        if credentials.user:
            self.username_pw_set(credentials.user, credentials.password)
        if credentials.context is not None:
            self._ssl_context = None  # paho takes one, and no other after it
            self.tls_set_context(credentials.context)

    def why_broken(self, reason: ReasonCode) -> str:
        """Say why the connection broke: paho logs the error, and reports another for all."""
        error = self._broken_by
        why = reason_text(reason) if error is None else tls_fault(error)
        is_closed = error is None and reason.value == _UNSPECIFIED
        if is_closed:
            why = "the broker closed it and did not say why"
        is_ended = is_closed or error is not None
        if is_closed and self.is_answered and self._short >= _AGAIN:
            why += "; it does so again and again: has another client the same `client_id`?"
        if self.is_answered or not is_ended or isinstance(error, ssl.SSLError):
            return f"the connection broke: {why}"
        hint = "a certificate of the client (`tls`)" if self._ssl else "TLS (`mqtts://`)"
        return f"it ended before the broker answered: does it ask for {hint}? {why}"

    def _reconnect_wait(self) -> None:
        # After any connection paho begins with the shortest pause: also after one that the broker
        # ends as soon as it is there, each time.
        if self._reconnect_delay is None:
            is_short = time.monotonic() - self._began < _SHORT_SECONDS
            self._short = self._short + 1 if is_short else 0
            self._reconnect_delay = self._pause if is_short else None
        super()._reconnect_wait()
        self._pause = self._reconnect_delay

    def _handle_publish(self) -> MQTTErrorCode:
        try:
            ended = super()._handle_publish()
        finally:  # what could not be read to its end had one, perhaps
            received, self._received = self._received, None
        if received is not None:
            # paho keeps each message of QoS 2 until the broker lets it go. Mosquitto 2.0 sends far
            # more at once than it was asked for, so each is taken as it comes; its number is kept.
            mid, is_known = received
            with self._in_message_mutex:
                message, self._in_messages[mid] = self._in_messages[mid], _TAKEN
            if not is_known:
                self._handle_on_message(message)
        return ended

    def _send_pubrec(self, mid: int) -> MQTTErrorCode:
        self._received = mid, mid in self._in_messages
        return super()._send_pubrec(mid)

    def _handle_on_message(self, message: MQTTMessage) -> None:
        if message is not _TAKEN:
            super()._handle_on_message(message)

    def _messages_reconnect_reset_out(self) -> None:
        # paho sends all that is unfinished again at once, and a broker ends the connection for it.
        super()._messages_reconnect_reset_out()
        with self._out_message_mutex:
            for message in tuple(self._out_messages.values())[self._max_inflight_messages :]:
                message.state = MessageState.MQTT_MS_QUEUED

    def _handle_pubrec(self) -> MQTTErrorCode:
        ended = self._refused()  # of QoS 2 it is said here, and paho takes each for a yes
        return super()._handle_pubrec() if ended is None else ended

    def _handle_pubackcomp(self, cmd: Literal["PUBACK", "PUBCOMP"]) -> MQTTErrorCode:
        ended = self._refused()
        return super()._handle_pubackcomp(cmd) if ended is None else ended

    def _refused(self) -> MQTTErrorCode | None:
        """Have a message end that the broker refuses; None where it does not.

        paho breaks the connection for a reason that the standard does not give to the packet, such
        as Mosquitto's 0x95 by `message_size_limit`, and sends the message again in the next.
        """
        packet = self._in_packet["packet"]
        mid, value = int.from_bytes(packet[:2], "big"), packet[2] if packet[2:] else 0
        if value < _UNSPECIFIED:
            return None
        reason = ReasonCode(PacketTypes.PUBACK)
        reason.value = value
        with self._out_message_mutex:
            if mid not in self._out_messages:
                return MQTTErrorCode.MQTT_ERR_SUCCESS
            nothing = Properties(PacketTypes.PUBACK)  # type: ignore[no-untyped-call]
            return self._do_on_publish(mid, reason, nothing)

    def forget_unfinished(self) -> None:
        """Let messages go that the broker does not know to be under way any more."""
        with self._in_message_mutex:
            self._in_messages.clear()

    def _sock_recv(self, bufsize: int) -> bytes:
        try:
            if bufsize > self.most_octets:  # paho asks for what is left of the packet
                text = f"{bufsize:,} octets; {self.most_octets:,} are allowed (max_octets)"
                raise PacketTooLargeError(text)
            return super()._sock_recv(bufsize)
        except OSError as error:
            self._note(error)
            raise

    def _sock_send(self, buf: bytes | bytearray) -> int:
        try:
            return super()._sock_send(buf)
        except OSError as error:
            self._note(error)
            raise

    def _note(self, error: OSError) -> None:
        if not isinstance(error, BlockingIOError):
            self._broken_by = error

    def keep_within(self, most: int) -> None:
        """Have no more messages under way at once than the broker takes, which paho forgets."""
        self._max_inflight_messages = min(most, MOST_IN_FLIGHT)

    def release(self) -> None:
        """Close the sockets that wake paho's thread, which it leaves to garbage collection."""
        self._reset_sockets()


def reason_text(reason: ReasonCode) -> str:
    """Return a reason code of the broker, or of paho, in words and as a number."""
    name = next(iter(reason.names.get(reason.value, {"for a reason without a name": ()})))
    return f"{name} (reason code 0x{reason.value:02X})"


def properties(packet: str, **values: Any) -> Properties:
    """Return properties of MQTT 5 for a packet."""
    made = Properties(getattr(PacketTypes, packet))  # type: ignore[no-untyped-call]
    for name, value in values.items():
        setattr(made, name, value)
    return made
