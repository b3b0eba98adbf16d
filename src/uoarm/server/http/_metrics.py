"""Figures of the server in Prometheus' text format, read when they are asked for."""

from __future__ import annotations

import re
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress

from attrs import define, frozen
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from uoarm.model import StatusMap
from uoarm.server.session import ConnectedClient, SessionStore
from uoarm.server.streams import FeedRegistry

__all__ = ["Metrics", "Totals", "status_metrics", "thread_metrics"]

_NUMBERED = re.compile(r"^Thread-\d+")


@define
class Totals:
    """Counts over the server's whole life, clients that have gone included."""

    clients: int = 0
    refused: int = 0
    cut_off: int = 0
    received: int = 0
    sent: int = 0
    sent_bytes: int = 0

    def refuse(self) -> None:
        """Count a client that was not let in."""
        self.refused += 1

    def add(self, client: ConnectedClient) -> None:
        """Keep the counts of a client that goes."""
        self.received += client.received
        self.sent += client.outbox.sent
        self.sent_bytes += client.outbox.sent_bytes
        self.cut_off += client.is_cut


class Metrics:
    """Collects from the living objects; holds no counts of its own.

    Args:
        registry: feeds and workers.
        totals: of clients that have gone.
        clients: those connected now.
        store: sessions that are kept.
    """

    def __init__(
        self,
        registry: FeedRegistry,
        totals: Totals,
        clients: Callable[[], Iterable[ConnectedClient]],
        store: SessionStore,
    ) -> None:
        self._store = store
        self._registry = registry
        self._totals = totals
        self._clients = clients

    async def text(self) -> bytes:
        """Return everything in the text format, version 0.0.4.

        What is of the robot is collected beside the loop, once for all who ask meanwhile.
        """
        robot = await self._registry.views.get(self._of_robot, "")
        return _written(self._of_server()) + robot

    def _of_robot(self, questions: Collection[str]) -> dict[str, bytes]:
        status = status_metrics(self._registry.robot.status())
        written = _written((*status, thread_metrics()))
        return dict.fromkeys(questions, written)

    def _of_server(self) -> Iterator[Metric]:
        connected, waiting = tuple(self._clients()), self._store.waiting
        clients = connected + waiting
        totals = self._totals
        yield _gauge("clients", "clients connected", len(connected))
        yield _gauge("kept_sessions", "sessions that wait for their client", len(waiting))
        yield _count("arrivals", "clients that connected", totals.clients)
        yield _count("refused", "handshakes that were refused", totals.refused)
        yield _count("cut_off", "clients that were cut off", totals.cut_off)
        received = totals.received + sum(client.received for client in clients)
        yield _count("received_messages", "messages from clients", received)
        sent = totals.sent + sum(client.outbox.sent for client in clients)
        yield _count("sent_messages", "messages to clients", sent)
        octets = totals.sent_bytes + sum(client.outbox.sent_bytes for client in clients)
        yield _count("sent_bytes", "bytes of messages to clients", octets)
        waiting_bytes = sum(client.outbox.waiting_bytes for client in clients)
        yield _gauge("waiting_bytes", "bytes that wait for clients", waiting_bytes)
        held = GaugeMetricFamily(
            "uoarm_serve_held_bytes", "memory held for clients, by kind", labels=["kind"]
        )
        for kind, octets in self._registry.memory.kinds.items():
            held.add_metric([kind.value], octets)
        yield held
        unread = sum(client.unread_octets for client in clients)
        yield _gauge("unread_bytes", "bytes that arrived and were not read yet", unread)
        largest = self._registry.memory.largest
        yield _gauge("held_bytes_largest", "memory held for the client that has most", largest)
        dropped = sum(client.outbox.dropped for client in clients)
        yield _gauge("dropped_messages", "messages lost to slow clients not yet gone", dropped)
        yield _gauge(
            "workers_busy", "requests that wait for the robot", self._registry.workers.busy
        )
        feeds = self._registry.feeds
        yield _gauge("feeds", "functions that clients have open", len(feeds))
        lost = sum(feed.lost for feed in feeds)
        yield _gauge("feed_lost", "messages lost before the loop got to them", lost)


@frozen(eq=False)
class _Figures:
    """What the writer of the text format asks for its figures."""

    metrics: Iterable[Metric]

    def collect(self) -> Iterable[Metric]:
        """Return the figures."""
        return self.metrics


def _written(metrics: Iterable[Metric]) -> bytes:
    collectors = CollectorRegistry(auto_describe=False)
    collectors.register(_Figures(metrics))
    return generate_latest(collectors)


def thread_metrics() -> Metric:
    """Return the processor time of living threads, by name: one that turns for nothing shows.

    Linux; elsewhere there are no figures.
    """
    seconds: dict[str, float] = {}
    for thread in threading.enumerate() if sys.platform == "linux" else ():
        if thread.native_id is None:
            continue
        # The clock of a thread by its number: one that has ended is refused, not followed.
        with suppress(OSError):
            taken = time.clock_gettime(~thread.native_id << 3 | 6)
            name = _NUMBERED.sub("Thread", thread.name)
            seconds[name] = seconds.get(name, 0.0) + taken
    metric = GaugeMetricFamily(
        "uoarm_thread_seconds", "processor time of living threads, by name", labels=["thread"]
    )
    for name, taken in sorted(seconds.items()):
        metric.add_metric([name], taken)
    return metric


def status_metrics(status: StatusMap) -> Iterator[Metric]:
    """Yield the figures of a status map."""
    yield from _routes(status)
    yield from _health(status)
    yield from _channels(status)


def _routes(status: StatusMap) -> Iterator[Metric]:
    labels = ["producer", "consumer"]
    received = CounterMetricFamily("uoarm_route_received", "messages that arrived", labels=labels)
    delivered = CounterMetricFamily("uoarm_route_delivered", "messages taken", labels=labels)
    dropped = CounterMetricFamily(
        "uoarm_route_dropped", "messages lost", labels=[*labels, "reason"]
    )
    for route in status.routes:
        ends = [route.producer, route.consumer]
        received.add_metric(ends, route.received)
        delivered.add_metric(ends, route.delivered)
        for reason, count in route.dropped:
            dropped.add_metric([*ends, reason], count)
    yield from (received, delivered, dropped)


def _health(status: StatusMap) -> Iterator[Metric]:
    """Yield who is how, 1 for the health of this moment, and what has failed so far."""
    bridges = GaugeMetricFamily("uoarm_bridge_health", "how it is", labels=["bridge", "health"])
    facts = GaugeMetricFamily(
        "uoarm_bridge_fact", "what it knows of its own work", labels=["bridge", "fact"]
    )
    for bridge in status.bridges:
        bridges.add_metric([bridge.name, bridge.health.value], 1)
        for fact, value in bridge.facts:
            if isinstance(value, int | float):
                facts.add_metric([bridge.name, fact], value)
    labels = ["component", "function"]
    components = GaugeMetricFamily(
        "uoarm_component_health", "how it is", labels=[*labels, "health"]
    )
    failed = CounterMetricFamily(
        "uoarm_component_failed", "messages and calls that it raised on", labels=labels
    )
    for component in status.components:
        names = [component.name, component.function]
        components.add_metric([*names, component.health.value], 1)
        failed.add_metric(names, component.failed)
    deaths = CounterMetricFamily(
        "uoarm_component_deaths", "how often it was lost", labels=["component"]
    )
    for name, count in status.deaths:
        deaths.add_metric([name], count)
    takeovers = CounterMetricFamily(
        "uoarm_takeovers", "how often another plan took over", labels=["function"]
    )
    for name, count in status.takeovers:
        takeovers.add_metric([name], count)
    states = GaugeMetricFamily("uoarm_connections", "connections, by state", labels=["state"])
    for state, count in Counter(
        connection.state.value for connection in status.connections
    ).items():
        states.add_metric([state], count)
    yield from (bridges, facts, components, failed, deaths, takeovers, states)


def _channels(status: StatusMap) -> Iterator[Metric]:
    """Yield what is known of open channels: each fact that is a number."""
    labels = ["component", "port"]
    lost = CounterMetricFamily(
        "uoarm_channel_lost", "messages that will never arrive", labels=labels
    )
    facts = GaugeMetricFamily(
        "uoarm_channel_fact", "what its framework reports", labels=[*labels, "fact"]
    )
    for component in status.components:
        for channel in component.channels:
            ends = [component.name, channel.port]
            lost.add_metric(ends, channel.lost)
            for fact, value in channel.facts:
                if isinstance(value, int | float):
                    facts.add_metric([*ends, fact], value)
    yield from (lost, facts)


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(f"uoarm_serve_{name}", text, value=value)


def _count(name: str, text: str, value: float) -> Metric:
    return CounterMetricFamily(f"uoarm_serve_{name}", text, value=value)
