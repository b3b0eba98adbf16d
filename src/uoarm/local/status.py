"""The built-in bridge `status`: the health of the manager itself, as messages.

They have the shape and the type of ROS 2's `diagnostic_msgs/msg/DiagnosticArray`, so that an offer
in ROS 2 is what rqt_robot_monitor and Foxglove show; clients and other frameworks get the same.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from enum import IntEnum
from typing import Any

from attrs import frozen

from uoarm._raised import LimitedLog
from uoarm.bridge import (
    Bridge,
    BridgeType,
    Capabilities,
    Delivery,
    Description,
    Discovered,
    EndpointOptions,
    Sink,
    Source,
    hookimpl,
    option,
)
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import (
    BridgeStatus,
    ComponentStatus,
    ConnectionState,
    ConnectionStatus,
    Endpoint,
    Health,
    MachineStatus,
    Message,
    MessageStructure,
    OfferState,
    OfferStatus,
    Options,
    Role,
    RouteStatus,
    StatusMap,
    closed_object,
)

__all__ = ["DIAGNOSTICS", "DiagnosticLevel", "Diagnostics", "StatusOptions", "uoarm_bridge_types"]

_ADDRESS = ("diagnostics",)
_JOIN_SECONDS = 1.0
_MOST_CHARACTERS = 500
_NANO = 1_000_000_000
_NAME = "uoarm"
_log = logging.getLogger("uoarm")


class DiagnosticLevel(IntEnum):
    """How something is, as `diagnostic_msgs/msg/DiagnosticStatus` counts it."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


_OK, _WARN, _ERROR, _STALE = DiagnosticLevel
_WORSE = (_OK, _WARN, _STALE, _ERROR)  # of several: what failed outranks what is not known
_LEVELS = {Health.OK: _OK, Health.FINISHED: _OK, Health.DEGRADED: _WARN, Health.LOST: _ERROR}


def _record(type_name: str, **properties: Any) -> dict[str, Any]:
    return closed_object(properties, x_type=type_name)


_TEXT = {"type": "string", "maxLength": _MOST_CHARACTERS, "x-nul": False}
_STAMP = _record(
    "builtin_interfaces/msg/Time",
    sec={"type": "integer", "minimum": 0, "maximum": 2**31 - 1, "x-unit": "s"},
    nanosec={"type": "integer", "minimum": 0, "maximum": _NANO - 1, "x-unit": "ns"},
)
DIAGNOSTICS = MessageStructure(
    _record(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=_record("std_msgs/msg/Header", stamp=_STAMP, frame_id=_TEXT),
        status={
            "type": "array",
            "items": _record(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level={"type": "integer", "minimum": _OK, "maximum": _STALE},
                name=_TEXT,
                message=_TEXT,
                hardware_id=_TEXT,
                values={
                    "type": "array",
                    "items": _record("diagnostic_msgs/msg/KeyValue", key=_TEXT, value=_TEXT),
                },
            ),
        },
    ),
    native_type="diagnostic_msgs/msg/DiagnosticArray",
)


@frozen
class StatusOptions(EndpointOptions):
    """The options of an endpoint."""

    period: float = option(
        1.0,
        {"type": "number", "minimum": 0.1, "maximum": 60},
        "seconds between two messages",
        unit="s",
    )
    stale_after: float | None = option(
        None,
        {"type": "number", "exclusiveMinimum": 0},
        "seconds without a message after which a function is STALE; left out: never",
        unit="s",
    )
    hardware_id: str = option(
        "", {"type": "string", "maxLength": _MOST_CHARACTERS}, "which robot it is, in each entry"
    )


class Diagnostics:
    """Makes messages of what the manager's status is; keeps what was lost until the last one.

    Args:
        options: of the endpoint.
    """

    def __init__(self, options: StatusOptions) -> None:
        self._options = options
        self._lost: dict[str, int] = {}

    def message(self, status: StatusMap, nanoseconds: int) -> Message:
        """Return the message of a status.

        Args:
            status: of the manager.
            nanoseconds: of the system's clock.
        """
        seconds, rest = divmod(nanoseconds, _NANO)
        return {
            "header": {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": ""},
            "status": list(self._entries(status)),
        }

    def _entries(self, status: StatusMap) -> Iterator[Message]:
        absent = {
            bridge
            for machine in status.machines
            if not machine.present
            for bridge in machine.bridges
        }
        unknown = absent | {
            bridge.name for bridge in status.bridges if bridge.health is Health.LOST
        }
        yield self._manager(status)
        yield from map(self._machine, status.machines)
        for bridge in status.bridges:
            yield self._bridge(bridge, is_absent=bridge.name in absent)
        routes: dict[str, list[RouteStatus]] = defaultdict(list)
        for route in status.routes:
            routes[route.producer.partition(".")[0]].append(route)
            routes[route.consumer.partition(".")[0]].append(route)
        for component in status.components:
            yield self._component(
                component, routes[component.name], is_unknown=component.bridge in unknown
            )
        open_now = {component.name for component in status.components}
        for name, count in status.deaths:
            if name not in open_now:
                text = f"not open since it was lost, {count} times so far"
                yield self._entry(f"component {name}", _STALE, text, deaths=count)
        functions: dict[str, list[ConnectionStatus]] = defaultdict(list)
        for connection in status.connections:
            functions[connection.function].append(connection)
        takeovers = dict(status.takeovers)
        for name, connections in functions.items():
            own = [route for connection in connections for route in routes[connection.id]]
            yield self._function(name, connections, own, takeovers.get(name, 0))
        yield from map(self._offer, status.offers)

    def _manager(self, status: StatusMap) -> Message:
        level, text = _OK, "running"
        if status.held is not None:
            level, text = _WARN, f"commands are refused by an emergency stop, {status.held:.0f} s"
        return self._entry(
            "manager",
            level,
            text,
            bridges=len(status.bridges),
            components=len(status.components),
            connections=len(status.connections),
            deaths=sum(count for _, count in status.deaths),
            takeovers=sum(count for _, count in status.takeovers),
            lock_differences=len(status.lock),
        )

    def _machine(self, machine: MachineStatus) -> Message:
        level = _OK if machine.present else _ERROR
        return self._entry(
            f"machine {machine.name}",
            level,
            machine.cause or "present",
            bridges=", ".join(machine.bridges),
            clock_offset=machine.clock_offset,
            clock_error=machine.clock_error,
        )

    def _bridge(self, bridge: BridgeStatus, *, is_absent: bool) -> Message:
        level = _STALE if is_absent else _LEVELS[bridge.health]
        return self._entry(
            f"bridge {bridge.name}",
            level,
            bridge.cause or bridge.health.value,
            plugin=bridge.plugin,
            channels=bridge.open_channels,
            process=bridge.process,
            **dict(bridge.facts),
        )

    def _component(
        self, component: ComponentStatus, routes: list[RouteStatus], *, is_unknown: bool
    ) -> Message:
        level, text = _LEVELS[component.health], component.cause or component.health.value
        if is_unknown and level is not _ERROR:
            level, text = _STALE, f"bridge {component.bridge} does not report"
        given = [route for route in routes if route.producer.partition(".")[0] == component.name]
        return self._entry(
            f"component {component.name}",
            level,
            text,
            function=component.function,
            bridge=component.bridge,
            connections=", ".join(component.users),
            failed=component.failed,
            last_error=component.last_error,
            lost=component.lost,
            **_flow(given),
        )

    def _function(
        self,
        name: str,
        connections: list[ConnectionStatus],
        routes: list[RouteStatus],
        takeovers: int,
    ) -> Message:
        found = [_connection_level(connection) for connection in connections]
        ended = (route for connection in connections for route in connection.ended)
        lost = sum(connection.lost for connection in connections)
        lost += sum(count for route in (*routes, *ended) for _, count in route.dropped)
        before = self._lost.get(name, lost)
        self._lost[name] = lost
        if lost > before:
            found.append((_WARN, f"{lost - before} messages lost since the last report"))
        limit, ages = self._options.stale_after, [route.age for route in routes]
        if limit is not None and ages and all(age is None or age > limit for age in ages):
            found.append((_STALE, f"no message for {limit:g} s"))
        level, text = max(found, key=lambda item: _WORSE.index(item[0]))
        components = dict.fromkeys(
            component for connection in connections for component in connection.components
        )
        return self._entry(
            f"function {name}",
            level,
            text,
            connections=", ".join(connection.id for connection in connections),
            components=", ".join(components),
            lost=lost,
            takeovers=takeovers,
            **_flow(routes),
        )

    def _offer(self, offer: OfferStatus) -> Message:
        level = _OK if offer.state in {OfferState.OPEN, OfferState.FINISHED} else _WARN
        level = _ERROR if offer.state is OfferState.FAILED else level
        return self._entry(
            f"offer {offer.name}",
            _WARN if offer.cause and level is _OK else level,
            offer.cause or offer.state.value,
            connections=", ".join(offer.connections),
            calls=offer.calls,
            failed=offer.failed,
        )

    def _entry(self, name: str, level: DiagnosticLevel, text: str, **values: object) -> Message:
        return {
            "level": int(level),
            "name": _text(f"{_NAME}: {name}"),
            "message": _text(text),
            "hardware_id": _text(self._options.hardware_id),
            "values": [
                {"key": _text(key), "value": _text(value)}
                for key, value in values.items()
                if value is not None and value != ""
            ],
        }


def _connection_level(connection: ConnectionStatus) -> tuple[DiagnosticLevel, str]:
    if connection.state is ConnectionState.WAITING:
        return _ERROR, f"{connection.id} waits: {connection.cause}"
    return _OK, connection.state.value


def _flow(routes: Iterable[RouteStatus]) -> dict[str, object]:
    """Return what is counted of routes; native ones count nothing."""
    counted = [route for route in routes if not route.native]
    if not counted:
        return {}
    ages = [route.age for route in counted if route.age is not None]
    return {
        "received": sum(route.received for route in counted),
        "delivered": sum(route.delivered for route in counted),
        "dropped": sum(count for route in counted for _, count in route.dropped),
        "invalid": sum(route.invalid for route in counted),
        "rate": max((route.rate for route in counted if route.rate is not None), default=None),
        "age": min(ages, default=None),
    }


def _text(value: object) -> str:
    written = f"{value:.3f}" if isinstance(value, float) else str(value)
    written = written.replace("\0", "")
    if len(written) > _MOST_CHARACTERS:
        return f"{written[: _MOST_CHARACTERS - 3]}..."
    return written


class StatusBridge(Bridge):
    """Reads the status of the manager that uses it, in a thread of each source's own."""

    capabilities = Capabilities(discover=True)

    def _describe(self, endpoint: Endpoint) -> Description:
        self._reading(endpoint)
        return Description(DIAGNOSTICS)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        del structure
        return _DiagnosticsSource(endpoint, self._reading(endpoint), deliver)

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        self._reading(endpoint)
        raise BridgeError(f"{endpoint}: nothing is taken here", FailureReason.UNSUPPORTED)

    def _discover(self) -> tuple[Discovered, ...]:
        address = Endpoint(self.name, "manager", Role.OUTPUT, _ADDRESS)
        return (Discovered("manager", ((address, Description(DIAGNOSTICS)),)),)

    def _close(self) -> None:
        """Have nothing to give back: sources end their own threads."""

    def _reading(self, endpoint: Endpoint) -> Callable[[], StatusMap]:
        if endpoint.role is not Role.OUTPUT or endpoint.is_offered:
            text = f"{endpoint}: bridge {self.name!r} has the output {list(_ADDRESS)} and no other"
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        if self.status is None:
            text = (
                f"{endpoint}: bridge {self.name!r} reads the status of the manager in whose "
                "process it is: leave `host` out"
            )
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        return self.status


class _DiagnosticsSource(Source):
    """One message a period, whatever the manager does meanwhile."""

    def __init__(
        self, endpoint: Endpoint, status: Callable[[], StatusMap], deliver: Delivery
    ) -> None:
        super().__init__(endpoint)
        options = StatusOptions.of_endpoint(endpoint)
        self._period = options.period
        self._diagnostics = Diagnostics(options)
        self._status = status
        self._deliver = deliver
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="uoarm-diagnostics", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        due, records = time.monotonic(), LimitedLog(_log)
        while not self._over.is_set():
            try:
                self._deliver(self._diagnostics.message(self._status(), time.time_ns()))
            except Exception as error:  # noqa: BLE001 - the next one may be better
                text = f"{self.endpoint}: reading the manager's status failed"
                records.write(logging.ERROR, text, error)
            due = max(due + self._period, time.monotonic())
            self._over.wait(due - time.monotonic())

    def _close(self) -> None:
        self._over.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOIN_SECONDS)


def _mistake(address: tuple[str, ...], options: Options) -> str:
    del options  # each is checked by itself
    return "" if address == _ADDRESS else f"expected {list(_ADDRESS)}, got {list(address)}"


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of the manager's own health."""
    return [
        BridgeType(
            name="status",
            summary="the health of this manager, as diagnostics",
            create=StatusBridge,
            endpoint_options=StatusOptions,
            check_endpoint=_mistake,
            contract=2,
        )
    ]
