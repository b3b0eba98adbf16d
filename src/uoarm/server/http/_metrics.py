"""Figures of the server in Prometheus' text format, read when they are asked for."""

from __future__ import annotations

import re
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress

from attrs import define, frozen
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from uoarm._figures import status_figures
from uoarm.model import StatusMap
from uoarm.server.session import ConnectedClient, SessionStore
from uoarm.server.streams import FeedRegistry

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


@define(eq=False)
class Metrics:
    """Collects from the living objects; holds no counts of its own.

    Args:
        totals: of clients that have gone.
        clients: those connected now.
        store: sessions that are kept.
    """

    _registry: FeedRegistry
    _totals: Totals
    _clients: Callable[[], Iterable[ConnectedClient]]
    _store: SessionStore

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
    for figure in status_figures(status):
        family = CounterMetricFamily if figure.is_counter else GaugeMetricFamily
        metric = family(f"uoarm_{figure.name}", figure.text, labels=figure.labels)
        for labels, value in figure.values.items():
            metric.add_metric(labels, value)
        yield metric


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(f"uoarm_serve_{name}", text, value=value)


def _count(name: str, text: str, value: float) -> Metric:
    return CounterMetricFamily(f"uoarm_serve_{name}", text, value=value)
