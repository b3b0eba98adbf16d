"""Functions that are offered to the robot: as services, and as actions of ROS 2."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, ClassVar

from uoarm.bridge import Channel, Handler
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health, Message
from uoarm_rosbridge.client._channels import Report, plain
from uoarm_rosbridge.client._connection import Fields, ServerConnection
from uoarm_rosbridge.client._types import RosType, reader, writer

__all__ = ["AdvertisedAction", "AdvertisedService", "ServedTypes"]

_MOST_REQUESTS = 256
_SUCCEEDED, _CANCELED, _ABORTED = 4, 5, 6


class ServedTypes:
    """How requests are read and replies written.

    Args:
        kinds: of the request and the reply; None: the server describes them not, and anything that
            JSON has a form for passes, as the function's own structures were checked.
    """

    def __init__(self, kinds: tuple[RosType, RosType] | None) -> None:
        self.read: Callable[[Any], Message] = plain if kinds is None else reader(kinds[0])
        self.write: Callable[[Message], Any] = plain if kinds is None else writer(kinds[1])


class _Served(Channel):
    """What comes is handled a few at a time; the others wait."""

    what: ClassVar[str]
    """Of the operations: what is served."""

    def __init__(
        self,
        endpoint: Endpoint,
        connection: ServerConnection,
        name: str,
        kind: str,
        types: ServedTypes,
        handler: Handler,
        at_once: int,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self.name, self._kind = name, kind
        self._connection, self._handler, self._report = connection, handler, report
        self._types = types
        # Guards what waits, between the connection's thread and those that answer.
        self._changed = threading.Condition()
        self._waiting: deque[Fields] = deque()
        self._running: set[object] = set()  # ids of what is being handled
        self._is_ended = self._is_open = False
        self._answered = self._failed = self._refused = 0
        self._why = ""
        self._identity = connection.new_id("serve")
        key = (self.what, name)
        if key in connection.serving:
            raise BridgeError(f"{endpoint}: it is served here already", FailureReason.REFUSED)
        connection.serving[key] = self._take
        connection.on_status(self._identity, self._status)
        for _ in range(at_once):
            threading.Thread(target=self._run, name=f"uoarm-rosbridge-{name}", daemon=True).start()
        try:
            operation = f"advertise_{self.what}"
            fields = {"op": operation, "id": self._identity, self.what: name, "type": kind}
            connection.stand(fields)
            connection.rosapi("get_time")  # operations are worked through in order
        except BaseException:
            self._close()
            raise
        if self._why:
            self._close()
            text = f"{endpoint}: the server refuses to have it served: {self._why}"
            raise BridgeError(text, FailureReason.REFUSED)
        self._is_open = True

    def facts(self) -> Mapping[str, object]:
        """Return counters of requests."""
        return {
            "answered": self._answered,
            "failed": self._failed,
            "refused": self._refused,
            "waiting": len(self._waiting),
        }

    def _status(self, text: str) -> None:
        """Take note of what the server says of it: it was refused, perhaps after a break."""
        self._why = text
        if self._is_open and not self._is_ended:
            self._report(self, Health.LOST, f"{self.name}: the server says: {text}")

    def _take(self, fields: Fields) -> None:
        with self._changed:
            if not self._is_ended and len(self._waiting) < _MOST_REQUESTS:
                self._waiting.append(fields)
                self._changed.notify()
                return
            self._refused += 1
        self._fail(fields, f"{_MOST_REQUESTS} requests wait already")

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_ended)
                if self._is_ended:
                    return
                fields = self._waiting.popleft()
                self._running.add(fields.get("id"))
            try:
                values = self._types.write(
                    self._handler(self._types.read(fields.get("args") or {}))
                )
            except Exception as error:  # noqa: BLE001 - of the handler: the caller gets it
                self._failed += 1
                self._fail(fields, f"{type(error).__name__}: {error}"[:1000])
            else:
                self._answered += 1
                self._answer(fields, values)
            with self._changed:
                self._running.discard(fields.get("id"))

    @abstractmethod
    def _answer(self, fields: Fields, values: object) -> None:
        """Say that a request was answered."""

    @abstractmethod
    def _fail(self, fields: Fields, why: str) -> None:
        """Say that it was not."""

    def _say(self, fields: Fields, **answer: object) -> None:
        head = {"id": fields.get("id"), self.what: self.name}
        with suppress(BridgeError):  # who asked is gone with the connection
            self._connection.send({**answer, **head})

    def _close(self) -> None:
        connection = self._connection
        with self._changed:
            self._is_ended = True
            self._changed.notify_all()
        connection.forget_status(self._identity)
        connection.serving.pop((self.what, self.name), None)
        operation = f"unadvertise_{self.what}"
        connection.withdraw(self._identity, {"op": operation, self.what: self.name})


class AdvertisedService(_Served):
    """A function that clients of the server call."""

    what = "service"

    def _answer(self, fields: Fields, values: object) -> None:
        self._say(fields, op="service_response", values=values, result=True)

    def _fail(self, fields: Fields, why: str) -> None:
        self._say(fields, op="service_response", values=why, result=False)


class AdvertisedAction(_Served):
    """A function that answers goals of ROS 2, from rosbridge 2.1 on.

    A goal that waits ends at once when it is cancelled. One whose function runs goes on, as a
    function cannot be interrupted, and ends as canceled.
    """

    what = "action"

    def __init__(self, *given: Any) -> None:
        self._canceled: set[object] = set()  # of those that run; guarded as what waits is
        super().__init__(*given)

    def _take(self, fields: Fields) -> None:
        if fields.get("op") == "send_action_goal":
            super()._take(fields)
            return
        identity = fields.get("id")
        with self._changed:
            waiting = [goal for goal in self._waiting if goal.get("id") == identity]
            for goal in waiting:
                self._waiting.remove(goal)
            if identity in self._running:
                self._canceled.add(identity)
        for goal in waiting:
            self._finish(goal, {}, _CANCELED)

    def _answer(self, fields: Fields, values: object) -> None:
        self._finish(fields, values, _CANCELED if self._was_canceled(fields) else _SUCCEEDED)

    def _fail(self, fields: Fields, why: str) -> None:
        self._was_canceled(fields)
        # rosbridge_suite takes no text for values, and leaves a goal with one open for ever.
        values = {"error": why}
        self._say(fields, op="action_result", values=values, status=_ABORTED, result=False)

    def _was_canceled(self, fields: Fields) -> bool:
        with self._changed:
            was_canceled = fields.get("id") in self._canceled
            self._canceled.discard(fields.get("id"))
            return was_canceled

    def _finish(self, fields: Fields, values: object, status: int) -> None:
        self._say(fields, op="action_result", values=values, status=status, result=True)
