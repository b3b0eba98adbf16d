"""InPorts of components as sinks: we push, at once or from a buffer, or they ask us."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from _uoarm_rtm_stubs import OpenRTM
from omniORB import CORBA

from uoarm.bridge import Sink
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Message
from uoarm_rtm._buffering import buffer_policy, push_policy
from uoarm_rtm._calls import CallGuard, calls
from uoarm_rtm._codec import BIG, LITTLE
from uoarm_rtm._connector import connector_properties
from uoarm_rtm._data_ports import INPORT_IOR, OUTPORT_IOR
from uoarm_rtm._faults import corba_text
from uoarm_rtm._orb import limit, narrowed
from uoarm_rtm._place import ConnectorHealth, RemotePort
from uoarm_rtm._publisher import PullBuffer, ThreadedPusher
from uoarm_rtm._sizes import SizeLimit

__all__ = ["InPortSink"]

_REASONS = {
    "BUFFER_FULL": "its buffer is full",
    "BUFFER_TIMEOUT": "its buffer stayed full",
    "PORT_ERROR": "it could not take the data",
    "UNKNOWN_ERROR": "it could not take the data",
}


class InPortSink(Sink):
    """One connector to an InPort.

    `send` waits for the component's answer where we push with `flush`; otherwise it puts the
    message into our buffer, whose policy may be to wait for room.

    Args:
        remote: the port.

    Raises:
        BridgeError: the port refuses or is gone; nothing stays connected.
    """

    def __init__(self, remote: RemotePort) -> None:
        super().__init__(remote.endpoint)
        self._remote = remote
        self._order = BIG if remote.options.endian == "big" else LITTLE
        self.health = ConnectorHealth(self, remote)
        self._policy = buffer_policy(remote.options.properties, "outport")
        self._buffer: PullBuffer | ThreadedPusher | None = None
        self._outlet: Any = None
        self._target: Any = None
        self._gone = ""
        self._putting = CallGuard()
        self._sizes = SizeLimit(remote.where, remote.orb.most_octets)
        waits = buffer_policy(remote.options.properties, "inport").longest_write
        self._is_released = False
        self._refused = 0
        self._longest = remote.options.timeout or remote.seconds + waits
        properties = connector_properties(remote.options, remote.codec.name)
        pulls = remote.options.flow == "pull"
        if pulls:
            self._buffer = PullBuffer(self._policy)
            self._outlet = remote.orb.serve(self._buffer)
            properties[OUTPORT_IOR] = remote.orb.text(self._outlet)
        try:
            self._connector = remote.connections.connect(remote.where, properties, remote.port)
            if not pulls:
                self._target = self._reach()
        except BridgeError:
            self._withdraw()
            raise
        if not pulls and remote.options.subscription != "flush":
            push, period = push_policy(remote.options.properties), remote.options.period
            self._buffer = ThreadedPusher(self._push, self._policy, push, period)
        self.blocking = self._buffer is None or self._policy.full == "block"

    def _send(self, message: Message) -> None:
        """Hand one message to the port.

        Raises:
            MessageError: it does not fit the data type; the text names the field.
            BridgeError: the component is gone or refuses the data, the message is larger than an
                ORB takes, our buffer is full, or the channel was closed meanwhile.
            BridgeTimeoutError: the component does not answer in time.
        """
        self._require_open()
        data = self._remote.codec.encode(message, self._order)
        if self._buffer is None:
            self._put(data)
            self.health.note_message()
        else:
            self._keep(data)

    def drain(self, timeout: float) -> bool:
        """Wait until what is in our buffer has been taken, `timeout` seconds at most."""
        return self._buffer is None or self._buffer.drain(timeout)

    def tick(self) -> None:
        """Check the connection; called about once a second by the bridge's ticker."""
        self.health.check(self._connector)

    def facts(self) -> Mapping[str, object]:
        """Return counters and the port."""
        dropped = {} if self._buffer is None else {"dropped": self._buffer.dropped}
        return {**self.health.facts(), "refused": self._refused, **dropped}

    def _require_open(self) -> None:
        if self._is_released:  # later than `closed`: what moves is stopped before it is released
            text = f"bridge {self.endpoint.bridge!r}: {self.endpoint} is closed"
            raise BridgeError(text, FailureReason.CLOSED)
        if self._gone:
            raise BridgeError(self._gone, FailureReason.UNAVAILABLE)

    def _keep(self, data: bytes) -> None:
        """Have a message wait in our buffer."""
        assert self._buffer is not None
        if self._buffer.write(data):
            if self._outlet is not None:  # what we push counts when it has been put
                self.health.note_message()
            return
        self._require_open()
        policy = self._policy
        stayed = f" and stayed so for {policy.write_seconds:g} s" if policy.full == "block" else ""
        text = f"{self._remote.where}: our buffer of {policy.length} for it is full{stayed}"
        raise BridgeError(text, FailureReason.REFUSED)

    def _push(self, data: bytes) -> None:
        """Put one message from the buffer's thread, which has no caller to take an error."""
        try:
            self._put(data)
        except BridgeTimeoutError:
            return  # it is reported; the component may be back for the next
        except BridgeError as error:
            if error.reason is FailureReason.UNAVAILABLE:
                self._gone = str(error)
            self.health.degrade(str(error))
        else:
            self.health.note_message()

    def _put(self, data: bytes) -> None:
        too_large = self._sizes.refusal(len(data))
        if too_large:
            self._refused += 1
            raise BridgeError(too_large, FailureReason.REFUSED)
        try:
            with calls, self._putting:
                status = self._target.put(data)
        except CORBA.TIMEOUT as error:
            text = f"{self._remote.where} did not take a message within its time limit"
            self.health.degrade(text)
            raise BridgeTimeoutError(text) from error
        except CORBA.Exception as error:
            self._require_open()
            too_large = self._sizes.explain(error, self._target, len(data))
            if too_large:
                self._refused += 1
                raise BridgeError(too_large, FailureReason.REFUSED) from error
            text = f"{self._remote.where} is gone ({corba_text(error)})"
            self.health.lose(text)
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        self._sizes.passed(len(data))
        if status != OpenRTM.PORT_OK:
            self._refused += 1
            reason = _REASONS.get(str(status), "it said so")
            text = f"{self._remote.where} refused a message: {status} ({reason})"
            raise BridgeError(text, FailureReason.REFUSED)

    def _reach(self) -> Any:
        remote = self._remote
        ior = self._connector.published(INPORT_IOR)
        try:
            what = f"{remote.where}: its InPortCdr"
            target = narrowed(remote.orb.reference(ior), OpenRTM.InPortCdr, remote.seconds, what)
            return limit(target, self._longest)
        except BridgeError:
            self._connector.disconnect()
            raise

    def _close(self) -> None:
        self._is_released = True
        self._withdraw()
        # A component in C++ may abort when it is disconnected while it takes a message.
        self._putting.end(self._longest)
        try:
            self._connector.disconnect()
        finally:
            self._remote.ended()

    def _withdraw(self) -> None:
        if self._buffer is not None:
            self._buffer.close()
        if self._outlet is not None:
            self._remote.orb.withdraw(self._outlet)
