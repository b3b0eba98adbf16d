"""What the manager does when a bridge reports that something changed, died or finished."""

from __future__ import annotations

import threading
from collections.abc import Callable

from uoarm._control._board import Board
from uoarm._control._bridges import BridgeSet
from uoarm._control._connection import Connection
from uoarm._control._failover import Death, Failover
from uoarm._control._ledger import Ledger
from uoarm._control._live import LiveComponent
from uoarm._control._pool import Pool
from uoarm._dataplane import Clock
from uoarm.bridge import HealthEvent
from uoarm.model import Component, ConnectionState, Health, Robot

__all__ = ["HealthDesk"]

_DRAIN_SECONDS = 30.0


class HealthDesk:
    """Turns health events into the ends of the connections that they concern.

    Args:
        forget: told the name of a component whose structures must be asked for again.
        bridges: of which one that is lost is retired; the next request starts a new one.
        failover: replaces the plans of connections that use what was lost.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        pool: Pool,
        ledger: Ledger,
        board: Board,
        robot: Robot,
        *,
        forget: Callable[[str], None],
        bridges: BridgeSet,
        failover: Failover,
        clock: Clock,
    ) -> None:
        self._pool = pool
        self._ledger = ledger
        self._board = board
        self._robot = robot
        self._forget = forget
        self._bridges = bridges
        self._failover = failover
        self._clock = clock

    def noticed(self, event: HealthEvent) -> None:
        """Take an event in the bridge's thread; everything else happens in the board's."""
        self._board.react(lambda: self._handle(event))

    def _handle(self, event: HealthEvent) -> None:
        if event.channel is not None and event.channel.closed:
            return
        for component in self._robot.components():
            if _concerns(event, component):
                self._forget(component.name)
        whole_bridge = event.channel is None and event.component is None
        bridge_lost = whole_bridge and event.health is Health.LOST
        if whole_bridge:
            self._board.post(f"bridge {event.bridge}", event.health.value, event.cause)
        lost: list[LiveComponent] = []
        for live in self._pool.components():
            if not _concerns(event, live.component):
                continue
            if bridge_lost and self._bridges.is_in_use(live.bridge):
                continue  # it was opened since then, at the bridge that followed
            if live.condition.note(event):
                subject = f"component {live.component.name}"
                self._board.post(subject, live.condition.health.value, live.condition.cause)
            if event.health is Health.FINISHED:
                self._finish(live)
            elif event.health is Health.LOST:
                lost.append(live)
        if lost:
            self._lose(lost, event)
        if bridge_lost:
            self._bridges.retire(event.bridge)

    def _lose(self, lost: list[LiveComponent], event: HealthEvent) -> None:
        now = self._clock()
        users = {one.id: one for live in lost for one in self._ledger.users_of(live)}
        for live in lost:
            self._pool.bury(live)
        names = ", ".join(repr(live.component.name) for live in lost)
        were = f"components {names} were" if len(lost) > 1 else f"component {names} was"
        concerned = (one.name for one in self._robot.components() if _concerns(event, one))
        death = Death(tuple(lost), frozenset(concerned), f"{were} lost: {event.cause}", now)
        self._failover.replace(users.values(), death)

    def _finish(self, live: LiveComponent) -> None:
        """Let what is under way arrive, without holding up other events meanwhile."""
        for connection in self._ledger.users_of(live):
            threading.Thread(
                target=_finish_one,
                args=(connection, f"component {live.component.name!r} finished"),
                name=f"uoarm-finish-{connection.id}",
                daemon=True,
            ).start()


def _concerns(event: HealthEvent, component: Component) -> bool:
    """Whether an event is about a component.

    A channel is found by its endpoint: it may report before its opening has returned.
    """
    name = event.component if event.channel is None else event.channel.endpoint.component
    return component.bridge == event.bridge and name in {None, component.name}


def _finish_one(connection: Connection, cause: str) -> None:
    connection.course.drain(_DRAIN_SECONDS)
    connection.course.end(ConnectionState.CLOSED, cause)
