"""Functions that are offered to the robot: as services, and as actions of ROS 2."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, ClassVar

from attrs import define

from uoarm.bridge import Channel, Handler, ServedRequests, on_failure, text_of
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health, Message
from uoarm_rosbridge.client._channels import Report
from uoarm_rosbridge.client._connection import Fields, ServerConnection
from uoarm_rosbridge.client._types import RosType, reader, writer

_SUCCEEDED, _CANCELED, _ABORTED = 4, 5, 6


class ServedTypes:
    """How requests are read and replies written.

    Args:
        kinds: of the request and the reply; None: the server describes them not.
    """

    def __init__(self, kinds: tuple[RosType, RosType] | None) -> None:
        self.read: Callable[[Any], Message] = writer(None) if kinds is None else reader(kinds[0])
        self.write = writer(kinds and kinds[1])


@define(eq=False)
class ServedRequest:
    """What a client asks, and whether it has cancelled it."""

    fields: Fields
    is_canceled: bool = False


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
        self.name, self._types = name, types
        self._connection, self._handler, self._report = connection, handler, report
        self._requests: ServedRequests[ServedRequest] = ServedRequests(
            f"{self.what} {name}", self._handle, self._refuse, at_once, partial(report, self)
        )
        self._is_open = False
        self._why = ""
        self._identity = connection.new_id("serve")
        key = (self.what, name)
        if key in connection.serving:
            raise BridgeError(f"{endpoint}: it is served here already", FailureReason.REFUSED)
        connection.serving[key] = self._take
        connection.on_status(self._identity, self._status)
        with on_failure(self._close):
            operation = f"advertise_{self.what}"
            fields = {"op": operation, "id": self._identity, self.what: name, "type": kind}
            connection.stand(fields)
            connection.settle()
        if self._why:
            self._close()
            text = f"{endpoint}: the server refuses to have it served: {self._why}"
            raise BridgeError(text, FailureReason.REFUSED)
        self._is_open = True

    def facts(self) -> Mapping[str, object]:
        """Return counters of requests."""
        return self._requests.facts()

    def _status(self, text: str) -> None:
        """Take note of what the server says of it: it was refused, perhaps after a break."""
        self._why = text
        if self._is_open and not self.closed:
            self._report(self, Health.LOST, f"{self.name}: the server says: {text}")

    def _take(self, fields: Fields) -> None:
        self._requests.put(ServedRequest(fields))

    def _handle(self, request: ServedRequest) -> None:
        arguments = self._types.read(request.fields.get("args") or {})
        self._answer(request, self._types.write(self._handler(arguments)))

    def _refuse(self, request: ServedRequest, error: Exception) -> None:
        named = text_of(error)
        self._fail(request, str(error) if isinstance(error, BridgeError) else named)

    @abstractmethod
    def _answer(self, request: ServedRequest, values: object) -> None:
        """Say that a request was answered."""

    @abstractmethod
    def _fail(self, request: ServedRequest, why: str) -> None:
        """Say that it was not."""

    def _say(self, request: ServedRequest, **answer: object) -> None:
        head = {"id": request.fields.get("id"), self.what: self.name}
        with suppress(BridgeError):  # who asked is gone with the connection
            self._connection.send({**answer, **head})

    def _close(self) -> None:
        connection = self._connection
        self._requests.close()
        connection.forget_status(self._identity)
        connection.serving.pop((self.what, self.name), None)
        operation = f"unadvertise_{self.what}"
        connection.withdraw(self._identity, {"op": operation, self.what: self.name})


class AdvertisedService(_Served):
    """A function that clients of the server call."""

    what = "service"

    def _answer(self, request: ServedRequest, values: object) -> None:
        self._say(request, op="service_response", values=values, result=True)

    def _fail(self, request: ServedRequest, why: str) -> None:
        self._say(request, op="service_response", values=why, result=False)


class AdvertisedAction(_Served):
    """A function that answers goals of ROS 2, from rosbridge 2.1 on.

    A goal that waits ends at once when it is cancelled. One whose function runs goes on, as a
    function cannot be interrupted, and ends as canceled.
    """

    what = "action"

    def _take(self, fields: Fields) -> None:
        if fields.get("op") == "send_action_goal":
            super()._take(fields)
            return
        identity = fields.get("id")
        waiting, running = self._requests.withdraw(lambda goal: goal.fields.get("id") == identity)
        for goal in running:
            goal.is_canceled = True
        for goal in waiting:
            self._finish(goal, {}, _CANCELED)

    def _answer(self, request: ServedRequest, values: object) -> None:
        self._finish(request, values, _CANCELED if request.is_canceled else _SUCCEEDED)

    def _fail(self, request: ServedRequest, why: str) -> None:
        # rosbridge_suite takes no text for values, and leaves a goal with one open for ever.
        values = {"error": why}
        self._say(request, op="action_result", values=values, status=_ABORTED, result=False)

    def _finish(self, request: ServedRequest, values: object, status: int) -> None:
        self._say(request, op="action_result", values=values, status=status, result=True)
