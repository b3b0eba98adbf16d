"""The figures of a manager's status: the same names in Prometheus and in OpenTelemetry."""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from attrs import field, frozen

from uoarm._version import __version__
from uoarm.model import StatusMap

_KEPT_SECONDS = 0.2


@frozen
class Figure:
    """One figure.

    Attributes:
        name: without the prefix `uoarm_`, and without `_total`.
        text: what it counts.
        labels: by which its values are distinguished.
        is_counter: whether it only grows.
        values: by the values of the labels.
    """

    name: str
    text: str
    labels: tuple[str, ...]
    is_counter: bool = False
    values: dict[tuple[str, ...], float] = field(factory=dict)

    def add(self, value: float, *labels: str) -> None:
        """Add to what belongs to these labels."""
        self.values[labels] = self.values.get(labels, 0) + value


def status_figures(status: StatusMap) -> tuple[Figure, ...]:
    """Return the figures of a status: always all of them, those without a value too."""
    return (*_routes(status), *_health(status), *_channels(status), *_places(status))


def _routes(status: StatusMap) -> Iterator[Figure]:
    ends = ("producer", "consumer")
    received = Figure("route_received", "messages that arrived", ends, is_counter=True)
    delivered = Figure("route_delivered", "messages taken", ends, is_counter=True)
    dropped = Figure("route_dropped", "messages lost", (*ends, "reason"), is_counter=True)
    invalid = Figure("route_invalid", "messages that did not match", ends, is_counter=True)
    copies = Figure("route_copies", "messages another route got, too", ends, is_counter=True)
    for route in status.routes:
        received.add(route.received, route.producer, route.consumer)
        delivered.add(route.delivered, route.producer, route.consumer)
        for reason, count in route.dropped:
            dropped.add(count, route.producer, route.consumer, reason)
        invalid.add(route.invalid, route.producer, route.consumer)
        copies.add(route.copies, route.producer, route.consumer)
    yield from (received, delivered, dropped, invalid, copies)


def _health(status: StatusMap) -> Iterator[Figure]:
    """Yield who is how, 1 for the health of this moment, and what has failed so far."""
    bridges = Figure("bridge_health", "how it is", ("bridge", "health"))
    facts = Figure("bridge_fact", "what it knows of its own work", ("bridge", "fact"))
    for bridge in status.bridges:
        bridges.add(1, bridge.name, bridge.health.value)
        for fact, value in bridge.facts:
            if isinstance(value, int | float):
                facts.add(value, bridge.name, fact)
    labels = ("component", "function")
    components = Figure("component_health", "how it is", (*labels, "health"))
    failed = Figure(
        "component_failed", "messages and calls that it raised on", labels, is_counter=True
    )
    for component in status.components:
        components.add(1, component.name, component.function, component.health.value)
        failed.add(component.failed, component.name, component.function)
    # What is open begins at 0: Prometheus sees an increase only of a value that was there before.
    deaths = Figure("component_deaths", "how often it was lost", ("component",), is_counter=True)
    for name, count in (*((part.name, 0) for part in status.components), *status.deaths):
        deaths.add(count, name)
    takeovers = Figure(
        "takeovers", "how often another plan took over", ("function",), is_counter=True
    )
    open_functions = ((connection.function, 0) for connection in status.connections)
    for name, count in (*open_functions, *status.takeovers):
        takeovers.add(count, name)
    states = Figure("connections", "connections, by state", ("state",))
    for state, count in Counter(
        connection.state.value for connection in status.connections
    ).items():
        states.add(count, state)
    yield from (bridges, facts, components, failed, deaths, takeovers, states)


def _channels(status: StatusMap) -> Iterator[Figure]:
    """Yield what is known of open channels: each fact that is a number."""
    labels = ("component", "port")
    lost = Figure("channel_lost", "messages that will never arrive", labels, is_counter=True)
    facts = Figure("channel_fact", "what its framework reports", (*labels, "fact"))
    for component in status.components:
        for channel in component.channels:
            lost.add(channel.lost, component.name, channel.port)
            for fact, value in channel.facts:
                if isinstance(value, int | float):
                    facts.add(value, component.name, channel.port, fact)
    yield from (lost, facts)


def _places(status: StatusMap) -> Iterator[Figure]:
    """Yield what is offered in frameworks, which machines are there, and what holds all of it."""
    labels = ("offer", "function")
    states = Figure("offer_state", "how it is", (*labels, "state"))
    calls = Figure("offer_calls", "calls of its service that were answered", labels, True)
    failed = Figure("offer_failed", "calls of its service that were not answered", labels, True)
    for offer in status.offers:
        states.add(1, offer.name, offer.function, offer.state.value)
        calls.add(offer.calls, offer.name, offer.function)
        failed.add(offer.failed, offer.name, offer.function)
    present = Figure("machine_present", "whether its hosts have joined", ("machine",))
    offset = Figure("machine_clock_offset_seconds", "how far its clock is ahead", ("machine",))
    for machine in status.machines:
        present.add(machine.present, machine.name)
        if machine.clock_offset is not None:
            offset.add(machine.clock_offset, machine.name)
    stopped = Figure("emergency_stop", "whether commands are refused by one", ())
    stopped.add(status.held is not None)
    differences = Figure("lock_differences", "what is not as it was locked", ())
    differences.add(len(status.lock))
    yield from (states, calls, failed, present, offset, stopped, differences)


class _ObservedManagers:
    """The managers of this process, whose figures OpenTelemetry collects when it wants to.

    OpenTelemetry has one meter for the whole process and never forgets an instrument, so that the
    instruments are declared once and ask the managers that there are.
    """

    def __init__(self) -> None:
        # Guards the managers and the figures kept: each instrument is asked in the thread of a
        # reader of metrics, while applications make and close managers.
        self._lock = threading.Lock()
        self._managers: dict[str, Callable[[], StatusMap]] = {}
        self._is_declared = False
        self._kept: dict[str, list[tuple[float, dict[str, str]]]] = {}
        self._at = 0.0

    def add(self, identity: str, status: Callable[[], StatusMap]) -> None:
        metrics = sys.modules.get("opentelemetry.metrics")
        get_meter = getattr(metrics, "get_meter", None)
        if get_meter is None:  # not imported, or another thread is at it
            return
        with self._lock:
            self._managers[identity] = status
            is_declared, self._is_declared = self._is_declared, True
        if not is_declared:
            self._declare(get_meter("uoarm", __version__), metrics)

    def remove(self, identity: str) -> None:
        with self._lock:
            self._managers.pop(identity, None)

    def _declare(self, meter: Any, metrics: Any) -> None:
        for figure in status_figures(StatusMap()):
            kind = "counter" if figure.is_counter else "gauge"
            create = getattr(meter, f"create_observable_{kind}")
            name = f"uoarm_{figure.name}"
            observed = partial(self._observed, figure.name, metrics.Observation)
            create(name, callbacks=[observed], description=figure.text)

    def _observed(self, name: str, observation: Callable[..., Any], _: object) -> Iterable[Any]:
        with self._lock:
            if time.monotonic() > self._at + _KEPT_SECONDS:  # one status for all instruments
                self._kept = self._collected()
                self._at = time.monotonic()
            found = self._kept.get(name, [])
        return [observation(value, attributes) for value, attributes in found]

    def _collected(self) -> dict[str, list[tuple[float, dict[str, str]]]]:
        collected: dict[str, list[tuple[float, dict[str, str]]]] = {}
        for identity, status in self._managers.items():
            which = {"manager": identity} if len(self._managers) > 1 else {}
            for figure in status_figures(status()):
                for labels, value in figure.values.items():
                    attributes = dict(zip(figure.labels, labels, strict=True))
                    collected.setdefault(figure.name, []).append((value, {**attributes, **which}))
        return collected


_observed_managers = _ObservedManagers()


def observe(identity: str, status: Callable[[], StatusMap]) -> Callable[[], None]:
    """Have OpenTelemetry collect a manager's figures; returns what ends that.

    Nothing is imported here: where `opentelemetry.metrics` was not, nothing happens.

    Args:
        identity: of the manager; an attribute where there are several in the process.
        status: returns its status, from any thread.
    """
    _observed_managers.add(identity, status)
    return partial(_observed_managers.remove, identity)
