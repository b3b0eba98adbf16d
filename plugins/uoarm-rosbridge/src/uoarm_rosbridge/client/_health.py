"""Whether what stands behind a server is there: who publishes, what was lost, who is silent."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any
from weakref import WeakSet

from uoarm.bridge import Channel, LimitedLog
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Health, Role
from uoarm_rosbridge.client._channels import ParameterSource, TopicSink, TopicSource
from uoarm_rosbridge.client._connection import ServerConnection
from uoarm_rosbridge.client._options import address_of, port_of
from uoarm_rosbridge.client._types import RosType

_JOIN_SECONDS = 1.0


class PeerWatch:
    """Looks at the peers of what is open, and for what was lost, now and then in its own thread.

    Args:
        connection: to the server; while it is not up, nothing is looked at.
        check: seconds from one look to the next.
        peers: returns the nodes behind an endpoint.
        is_same: says whether a type is the same in what may be another server than before.
    """

    def __init__(
        self,
        name: str,
        connection: ServerConnection,
        check: float,
        peers: Callable[[Endpoint], frozenset[str]],
        is_same: Callable[[RosType], bool],
        report: Callable[..., Any],
    ) -> None:
        self._connection, self._check = connection, check
        self._peers, self._is_same, self._report = peers, is_same, report
        # Guards what is open and what was lost, between steps, the connection and the watch.
        self._lock = threading.Lock()
        self._channels: WeakSet[Channel] = WeakSet()
        # Whose types were not compared since the last break, in the watch alone.
        self._unverified: WeakSet[Channel] = WeakSet()
        self._lost: dict[str, tuple[Endpoint, frozenset[str]]] = {}
        self._closing, self._poked = threading.Event(), threading.Event()
        self._is_new = self._is_asked = False
        self._records = LimitedLog("uoarm.rosbridge")
        self._thread = threading.Thread(
            target=self._run, name=f"uoarm-rosbridge-watch-{name}", daemon=True
        )
        self._thread.start()

    def keep(self, channel: Channel) -> None:
        """Watch a channel, as long as it is open and in use."""
        with self._lock:
            self._lost.pop(channel.endpoint.component, None)
            self._channels.add(channel)
        self._poked.set()  # its silence may be due before what is waited for

    def remember(self, endpoint: Endpoint, *, is_silent: bool = False) -> None:
        """Look from now on whether what stands behind an endpoint is back.

        What was there and said nothing for too long is back when others are there.
        """
        if endpoint.is_offered:
            return
        before = frozenset[str]()
        with suppress(BridgeError):
            if is_silent:
                before = self._peers(endpoint)
        with self._lock:
            self._lost[endpoint.component] = (endpoint, before)

    def look_anew(self) -> None:
        """Look now: the connection is another one, perhaps to another server."""
        self._is_new = self._is_asked = True
        self._poked.set()

    def stop(self) -> None:
        """Begin to end; `close` comes next."""
        self._closing.set()
        self._poked.set()

    def close(self) -> None:
        """End; waits for a look that is under way, so long as it does not take long."""
        self.stop()
        self._thread.join(_JOIN_SECONDS)

    def _run(self) -> None:
        """Watch who publishes, what was lost, and the silence of sources, until the close."""
        next_look = due = time.monotonic() + self._check
        while not self._closing.is_set():
            self._poked.wait(max(0.0, due - time.monotonic()))
            self._poked.clear()
            if self._is_asked or time.monotonic() >= next_look:
                self._is_asked = False
                next_look = time.monotonic() + self._check
                if self._connection.is_up and not self._closing.is_set():
                    with self._passed_over():
                        self._look()
            due = min(next_look, self._tick())

    def _tick(self) -> float:
        """Judge the silence of sources; returns when the next one may be too long."""
        # Apart from what waits: its frame would keep the last channel, closed or not.
        due = math.inf
        with self._lock:
            channels = tuple(self._channels)
        for channel in channels:
            if isinstance(channel, TopicSource) and not channel.closed:
                channel.health.tick()
                wake_at = channel.health.wake_at()
                due = due if wake_at is None else min(due, wake_at)
        return due

    def _look(self) -> None:
        """Look at all that is open, and for all that was lost; one that fails hinders no other."""
        with self._lock:
            channels, lost = tuple(self._channels), dict(self._lost)
        if self._is_new:
            self._is_new = False
            self._unverified.update(channels)
        with suppress(BridgeError):
            self._connection.ask_again()
        for channel in channels:
            if not channel.closed:
                for look in self._looks(channel):
                    with self._passed_over():
                        look()
        for component, (endpoint, before) in lost.items():
            now = frozenset[str]()
            with self._passed_over():
                now = self._peers(endpoint)
            if now and now != before:
                with self._lock:
                    self._lost.pop(component, None)
                name = address_of(endpoint).name
                self._report(Health.OK, f"{name} is there again", component=component)

    @contextmanager
    def _passed_over(self) -> Iterator[None]:
        """Go on with what comes next where the robot refuses, or answers as no robot should."""
        try:
            yield
        except BridgeError:
            return
        except Exception as error:  # noqa: BLE001 - of one answer
            self._records.write(logging.WARNING, "an answer of rosapi cannot be read", error)

    def _looks(self, channel: Channel) -> Iterator[Callable[[], None]]:
        """Return the looks at a channel; one that the robot refuses hinders no other."""
        if isinstance(channel, ParameterSource | TopicSink):
            yield channel.look
        if isinstance(channel, TopicSource | TopicSink):
            yield partial(self._look_at_peers, channel)
            if channel in self._unverified:
                yield partial(self._look_at_type, channel)

    def _look_at_type(self, channel: TopicSource | TopicSink) -> None:
        if not self._is_same(channel.made):
            channel.health.refused("it has another type since the break", final=True)
        self._unverified.discard(channel)

    def _look_at_peers(self, channel: TopicSource | TopicSink) -> None:
        endpoint, role = channel.endpoint, channel.endpoint.role
        if time.monotonic() < self._connection.patient_until:
            return  # nodes come back one by one, as the connection did
        if port_of(endpoint).peer_required and not self._peers(endpoint):
            does = "publishes" if role is Role.OUTPUT else "subscribes to"
            channel.health.connected(0, f"no node {does} it")
