"""Services both ways: calling a server of ROS, and being one."""

from __future__ import annotations

import logging
import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any

from uoarm.bridge import Channel, Description, Handler
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Endpoint, Health, Message
from uoarm_ros2._agreement import Agreement
from uoarm_ros2._graph import Graph, Presence
from uoarm_ros2._middleware import Station
from uoarm_ros2._read import reader
from uoarm_ros2._schema import structure_of
from uoarm_ros2._shape import Record, shape_of
from uoarm_ros2._types import import_type
from uoarm_ros2._write import writer

__all__ = ["Caller", "Server", "Workers", "answered", "described", "require_agreement"]

_FIRST_GLANCE_SECONDS = 0.005
_GLANCE_SECONDS = 0.25
_MOST_WAITING = 256
_log = logging.getLogger("uoarm.ros2")


def described(type_name: str) -> Description:
    """Return the request and reply structures of a service type."""
    request, reply = _records(import_type(type_name), type_name)
    return Description(request=structure_of(request), reply=structure_of(reply))


def _records(native: type, name: str) -> tuple[Record, Record]:
    request: type = native.Request  # type: ignore[attr-defined]  # generated
    reply: type = native.Response  # type: ignore[attr-defined]  # generated
    return shape_of(request, f"{name}_Request"), shape_of(reply, f"{name}_Response")


def answered(future: Any, deadline: float, there: Callable[[], bool], what: str) -> Any:
    """Wait for a future's result while its server is there.

    Raises:
        BridgeTimeoutError: the deadline passed.
        BridgeError: the server went away before it answered.
    """
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    glance = _FIRST_GLANCE_SECONDS  # what is answered at once costs no look at the graph
    while not done.wait(max(0.0, min(glance, deadline - time.monotonic()))):
        if time.monotonic() >= deadline:
            raise BridgeTimeoutError(f"{what} did not answer in time")
        if not there():
            raise BridgeError(f"{what} went away in mid-call", FailureReason.UNAVAILABLE)
        glance = _GLANCE_SECONDS
    return future.result()


def require_agreement(agreement: Agreement) -> None:
    """Raise BridgeError where all who serve mean something else."""
    found = agreement.look()
    if found.is_everybody:
        raise BridgeError(found.text, FailureReason.UNAVAILABLE)


def _named(error: BridgeTimeoutError, agreement: Agreement) -> BridgeTimeoutError:
    """Add who of those that serve means something else, of whom one may have been asked."""
    found = agreement.look().text
    return BridgeTimeoutError(f"{error}; {found}") if found else error


class Caller:
    """A client of one service, shared by all calls to it; calls may overlap.

    Attributes:
        agreement: whether those who serve it have our type.
    """

    def __init__(self, station: Station, graph: Graph, name: str, type_name: str) -> None:
        native = import_type(type_name)
        request, reply = _records(native, type_name)
        self._what = f"service {name}"
        self._name = name
        self._greeted = False
        self._graph = graph
        self._write = writer(request)
        self._read = reader(reply)
        self._client = station.client(native, name)
        self._station = station
        self.agreement = Agreement(station, self._what, [name])

    def close(self) -> None:
        """Put the client away; nobody calls any more."""
        self._station.discard(self._client)

    def ready(self) -> bool:
        """Whether a server is matched."""
        return bool(self._client.service_is_ready())

    def call(self, message: Message, timeout: float, wait: float) -> Message:
        """Send a request and return the reply.

        Raises:
            MessageError: the request does not fit its native type.
            BridgeTimeoutError: no reply within `timeout` seconds.
            BridgeError: no server within `wait` seconds, or none that has our definition of the
                type, or it went away in mid-call, or the bridge was closed.
        """
        deadline = time.monotonic() + timeout
        request = self._write(message)
        with self._station.calling(self._what):
            if not (self._greeted and self.ready()):
                self._meet(timeout, wait)
            require_agreement(self.agreement)
            first = Presence()
            future = self._client.call_async(request)

            def there() -> bool:
                return self.ready() and first.holds(self._graph.servers(self._name))

            try:
                return self._read(answered(future, deadline, there, self._what))
            except BridgeTimeoutError as error:
                raise _named(error, self.agreement) from None
            finally:
                self._client.remove_pending_request(future)

    def _meet(self, timeout: float, wait: float) -> None:
        """Wait for a server, and until it has met us too."""
        if not self._graph.until(self.ready, min(wait, timeout)):
            raise BridgeError(f"{self._what} has no server", FailureReason.UNAVAILABLE)
        self._graph.greet(self._name, timeout / 2)
        self._greeted = True


class Workers(Channel):
    """What is asked of a function, handled by several threads at once; the rest waits.

    Must implement: `_reply` and `_refuse`, which are called by any thread.

    Args:
        endpoint: as it was configured.
        name: the full name.
        handler: called by `at_once` threads at most.
        at_once: how many.
        report: takes changes of health.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        name: str,
        handler: Handler,
        at_once: int,
        report: Callable[[Channel, Health, str], None],
    ) -> None:
        super().__init__(endpoint)
        self._name = name
        self._handler = handler
        self._at_once = at_once
        self._report = report
        self._lock = threading.Lock()
        self._waiting: deque[tuple[Any, Message]] = deque()
        self._working = 0
        self._failing = False
        self.failures = 0
        self.count = 0

    @abstractmethod
    def _reply(self, asked: Any, reply: Message) -> None:
        """Tell who asked; raises MessageError for a reply that does not fit."""

    @abstractmethod
    def _refuse(self, asked: Any, error: Exception) -> None:
        """Tell who asked that there is no reply."""

    def facts(self) -> dict[str, object]:
        """Return how many requests came, how many wait, and how many the handler failed."""
        waiting = len(self._waiting)
        return {"requests": self.count, "waiting": waiting, "failures": self.failures}

    @property
    def is_full(self) -> bool:
        """Whether as much waits as may."""
        return len(self._waiting) >= _MOST_WAITING

    def _take(self, asked: Any, message: Message) -> None:
        """Have a request handled; in the station's thread alone."""
        with self._lock:
            self.count += 1
            is_full = self.is_full
            if not is_full:
                self._waiting.append((asked, message))
            starts = not is_full and self._working < self._at_once
            self._working += starts
        if is_full:
            self._failed(asked, RuntimeError(f"{_MOST_WAITING} requests wait already"))
        elif starts:
            threading.Thread(target=self._work, name=f"serves {self._name}", daemon=True).start()

    def _work(self) -> None:
        """Handle requests until none waits."""
        while True:
            with self._lock:
                if not self._waiting:
                    self._working -= 1
                    return
                asked, message = self._waiting.popleft()
            try:
                self._reply(asked, self._handler(message))
            except Exception as error:  # noqa: BLE001 - reported, and told to the client if it can be
                self._failed(asked, error)
                continue
            if self._failing:
                self._failing = False
                self._report(self, Health.OK, f"serving {self._name} works again")

    def _forget_waiting(self) -> None:
        """Handle no more of what waits; a handler that is at work may be what closes."""
        with self._lock:
            self._waiting.clear()

    def _failed(self, asked: Any, error: Exception) -> None:
        with self._lock:
            self.failures += 1
            self._failing = True
        cause = f"serving {self._name} failed: {type(error).__name__}: {error}"
        _log.warning("%s", cause)
        self._report(self, Health.DEGRADED, cause)
        try:
            self._refuse(asked, error)
        except Exception as another:  # noqa: BLE001 - rclpy's; the thread has more to handle
            _log.warning("a client of %s could not be refused: %s", self._name, another)


class Server(Workers):
    """A service offered to ROS.

    When the handler fails, a reply type with `success` and `message` says so; any other client is
    left without a reply, since ROS 2 has no other way to refuse, and the channel is degraded. The
    same happens to requests for which there is no room.

    Args:
        station: where it is offered.
        endpoint: as it was configured.
        name: the full name.
        type_name: the service's type.
        handler: called by `at_once` threads at most.
        at_once: how many.
        report: takes changes of health.
    """

    def __init__(
        self,
        station: Station,
        endpoint: Endpoint,
        name: str,
        type_name: str,
        handler: Handler,
        at_once: int,
        report: Callable[[Channel, Health, str], None],
    ) -> None:
        super().__init__(endpoint, name, handler, at_once, report)
        native: Any = import_type(type_name)
        request, reply = _records(native, type_name)
        read = reader(request)
        self._native = native
        self._write = writer(reply)
        self._refusable = {"success", "message"} <= {field.name for field in reply.fields}
        self._station = station
        self._service = station.server(
            native, name, lambda asked, answer: self._take(answer, read(asked))
        )

    def _close(self) -> None:
        self._forget_waiting()
        self._station.discard(self._service)

    def _reply(self, asked: Any, reply: Message) -> None:
        self._send(asked, self._write(reply))

    def _refuse(self, asked: Any, error: Exception) -> None:
        if self._refusable:
            self._send(asked, self._native.Response(success=False, message=str(error)))

    def _send(self, answer: Callable[[Any], None], native: Any) -> None:
        """Send a reply; a client that is gone, or a channel that was closed, gets none."""
        try:
            answer(native)
        except Exception as error:  # noqa: BLE001 - rclpy's, of several kinds
            if not self._closed:
                _log.warning("a reply of %s could not be sent: %s", self._name, error)
