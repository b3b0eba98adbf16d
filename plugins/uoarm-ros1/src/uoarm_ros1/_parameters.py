"""Sources and sinks on parameters of the master."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import (
    Channel,
    ReceiveQueue,
    Sink,
    Source,
    did_you_mean,
    foreign,
    on_failure,
    text_of,
)
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import (
    Deliver,
    Endpoint,
    Health,
    Message,
    MessageStructure,
    array_as_lists,
    plain_copy,
)
from uoarm_ros1._node import Node
from uoarm_ros1._options import Ros1Address
from uoarm_ros1._xmlrpc import encode_call

_INTEGER = {"type": "integer", "minimum": -(2**31), "maximum": 2**31 - 1}
_ABSENT: Any = {}
_LOOK: Any = object()
_DEEP = 16


def parameter_structure(
    node: Node, endpoint: Endpoint, address: Ros1Address
) -> MessageStructure | None:
    """Return what the value of a parameter is like now.

    Raises:
        BridgeError: it is not set.
    """
    name = node.resolve(address.name)
    try:
        value = node.master.call("getParam", name)
    except BridgeError as error:
        if error.reason is not FailureReason.REFUSED:
            raise
        names = node.master.call("getParamNames")
        meant = did_you_mean(name, map(str, names)) if isinstance(names, list) else ""
        text = f"{endpoint}: the parameter {name} is not set{meant}"
        raise BridgeError(text, FailureReason.NOT_FOUND) from error
    return MessageStructure(_schema(value, _DEEP), native_type="parameter")


def _schema(value: Any, depth: int) -> Any:
    if isinstance(value, bool):
        return {"type": "boolean"}
    if isinstance(value, int):
        return dict(_INTEGER)
    if isinstance(value, float):
        return {"type": "number"}
    if isinstance(value, str):
        return {"type": "string"}
    if isinstance(value, bytes):
        octet = {"type": "integer", "minimum": 0, "maximum": 255}
        return {"type": "array", "items": octet, "x-octets": True}
    if isinstance(value, list):
        kinds = [_schema(item, depth - 1) for item in value] if depth else []
        same = bool(kinds) and all(kind == kinds[0] for kind in kinds)
        return {"type": "array", "items": kinds[0]} if same else {"type": "array"}
    if isinstance(value, dict) and depth:
        return {
            "type": "object",
            "properties": {key: _schema(item, depth - 1) for key, item in value.items()},
            "required": sorted(value),
        }
    return True


class Ros1ParameterSource(Source):
    """The value of a parameter as it is, and each time that it is set.

    While it is not set any more, since it was deleted or the master was started again without it,
    or has a value that is more than is read, the channel is degraded.
    """

    latched = True

    def __init__(
        self,
        node: Node,
        endpoint: Endpoint,
        address: Ros1Address,
        deliver: Deliver,
        report: Callable[[Channel, Health, str], None],
    ) -> None:
        super().__init__(endpoint)
        self._node, self._deliver, self._report = node, deliver, report
        self._name = node.resolve(address.name)
        self._received = 0
        self._is_gone = self._is_looking = False
        # Guards the last value: what the master answers comes in one thread, changes in the loop's.
        self._lock = threading.Lock()
        self._last: Any = _ABSENT
        # Only the newest matter to who is slow.
        self._queue: ReceiveQueue[Any] = ReceiveQueue(f"uoarm-ros1-{self._name}", self._hand_on, 2)
        with on_failure(self._queue.close):
            value = node.watch_parameter(self._name, self._take)
        if value == _ABSENT:
            self._close()
            text = f"{endpoint}: the parameter {self._name} is not set"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        self._take(self._name, value, is_set=False)

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"received": self._received, "under_way": len(self._queue)}

    def _take(self, key: str, value: Any, *, is_set: bool) -> None:
        """Take a value that was set, or that is what a registration found, at first or again."""
        with self._lock:
            if key != self._name:  # one within it: the whole is asked for
                value = _ABSENT
            # A new master that has none reports the next one: whether it has come meanwhile is
            # looked at, and not delivered, or both would bring it.
            elif not is_set and value == _ABSENT:
                if not self._is_looking:
                    self._is_looking = True
                    self._queue.put(_LOOK)
                return
            # The bridge's look at the master may register anew between the entry in the node's
            # table and the first registration: both find the same value, which was set once.
            elif not is_set and value == self._last:
                return
            self._last = value
            self._queue.put(value)

    def _hand_on(self, value: Any) -> None:
        is_look = value is _LOOK
        if is_look:
            self._is_looking = False
        if is_look or value == _ABSENT:
            try:
                value = self._node.master.call("getParam", self._name)
            except BridgeError as error:
                if error.reason is FailureReason.REFUSED:
                    self._note_gone("is not set any more")
                elif error.reason is FailureReason.BAD_MESSAGE:
                    self._note_gone(f"cannot be read: {error}")
                return  # or the master is away: it is looked at again when it is back
        if is_look:
            return
        if self._is_gone:
            self._is_gone = False
            self._report(self, Health.OK, f"the parameter {self._name} is set again")
        self._received += 1
        self._deliver(value)

    def _note_gone(self, why: str) -> None:
        with self._lock:
            self._last = _ABSENT  # the value that it had is news when it is found again
        if not self._is_gone:
            self._is_gone = True
            self._report(self, Health.DEGRADED, f"the parameter {self._name} {why}")

    def _close(self) -> None:
        self._queue.close()
        self._node.unwatch_parameter(self._name, self._take)


class Ros1ParameterSink(Sink):
    """Sets a parameter; waits for the master to take it."""

    def __init__(self, node: Node, endpoint: Endpoint, address: Ros1Address) -> None:
        super().__init__(endpoint)
        self._node, self._name = node, node.resolve(address.name)
        self._sent = 0

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"sent": self._sent}

    def _send(self, message: Message) -> None:
        value = value_for(self._name, message)
        self._node.master.call("setParam", self._name, value)
        self._sent += 1
        self._node.parameter_changed(self._name, value)

    def _close(self) -> None:
        """Nothing is held."""


def value_for(name: str, message: Message) -> Any:
    """Return a message as the value of a parameter, which XML-RPC can say.

    Raises:
        MessageError: it cannot.
    """
    try:
        value = foreign(plain_copy, message, array_as_lists)
        foreign(encode_call, "setParam", (name, value))
    except Exception as error:  # of a value's own methods, say
        raise MessageError(f"{name}: {text_of(error)}") from error
    return value
