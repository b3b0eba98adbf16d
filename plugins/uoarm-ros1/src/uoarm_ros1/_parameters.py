"""Parameters of the master: outputs that say each new value, and inputs that set one."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from uoarm.bridge import Sink, Source
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Deliver, Endpoint, Message, MessageStructure
from uoarm_ros1._node import Node
from uoarm_ros1._options import Address

__all__ = ["ParameterSink", "ParameterSource", "parameter_structure"]

_INTEGER = {"type": "integer", "minimum": -(2**31), "maximum": 2**31 - 1}
_ABSENT: Any = {}
_DEEP = 16


def parameter_structure(
    node: Node, endpoint: Endpoint, address: Address
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
        text = f"{endpoint}: the parameter {name} is not set"
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


class ParameterSource(Source):
    """The value of a parameter as it is, and each time that it is set."""

    latched = True

    def __init__(self, node: Node, endpoint: Endpoint, address: Address, deliver: Deliver) -> None:
        super().__init__(endpoint)
        self._node, self._deliver = node, deliver
        self._name = node.resolve(address.name)
        self._received = 0
        # Guards the order of values: what the master answers comes in one thread, changes in the
        # loop's. They are handed over in one of its own, so that no receiver holds up the loop.
        self._changed = threading.Condition()
        self._waiting: list[Any] = []
        self._is_ended = False
        self._last: Any = _ABSENT
        self._thread = threading.Thread(
            target=self._run, name=f"uoarm-ros1-{self._name}", daemon=True
        )
        value = node.watch_parameter(self._name, self._take)
        if value == _ABSENT:
            node.unwatch_parameter(self._name, self._take)
            text = f"{endpoint}: the parameter {self._name} is not set"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        self._thread.start()
        self._take(self._name, value, is_set=False)

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"received": self._received, "under_way": len(self._waiting)}

    def _take(self, key: str, value: Any, *, is_set: bool) -> None:
        """Take a value that was set, or that is what a registration found, at first or again."""
        with self._changed:
            if key != self._name:  # one within it: the whole is asked for
                value = _ABSENT
            # The bridge's look at the master may register anew between the entry in the node's
            # table and the first registration: both find the same value, which was set once.
            elif not is_set and value == self._last:
                return
            self._last = value
            # Only the newest matters to who is slow.
            self._waiting[1:] = []
            self._waiting.append(value)
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_ended)
                if self._is_ended:
                    return
                value = self._waiting.pop(0)
            if value == _ABSENT:
                try:
                    value = self._node.master.call("getParam", self._name)
                except BridgeError:
                    continue  # it was deleted, or the master is away: the next change will say
            self._received += 1
            self._deliver(value)

    def _close(self) -> None:
        with self._changed:
            self._is_ended = True
            self._changed.notify_all()
        self._node.unwatch_parameter(self._name, self._take)


class ParameterSink(Sink):
    """Sets a parameter; waits for the master to take it."""

    def __init__(self, node: Node, endpoint: Endpoint, address: Address) -> None:
        super().__init__(endpoint)
        self._node, self._name = node, node.resolve(address.name)
        self._sent = 0

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"sent": self._sent}

    def _send(self, message: Message) -> None:
        value = plain(message)
        try:
            self._node.master.call("setParam", self._name, value)
        except ValueError as error:
            raise MessageError(f"{self._name}: {error}") from error
        self._sent += 1
        self._node.parameter_changed(self._name, value)

    def _close(self) -> None:
        """Nothing is held."""


def plain(value: Any) -> Any:
    """Return a message without arrays of numpy, which XML-RPC does not know."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist") and not isinstance(value, memoryview):
        return value.tolist()
    return value
