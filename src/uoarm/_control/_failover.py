"""Failover: what goes on behind a connection's handle when a component dies."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable

from attrs import frozen

from uoarm import _bounded
from uoarm._control._board import Board
from uoarm._control._connection import Connection
from uoarm._control._failback import Failback
from uoarm._control._heirs import Resolve, heir, names
from uoarm._control._ledger import Ledger
from uoarm._control._life import GOING_ON
from uoarm._control._live import LiveComponent
from uoarm._control._pool import Pool
from uoarm._control._succession import Succession
from uoarm._dataplane import Clock
from uoarm.errors import (
    BridgeTimeoutError,
    ConnectionClosedError,
    ResolutionError,
    UoarmError,
)
from uoarm.model import ConnectionState, FailoverPolicy, Plan

__all__ = ["Death", "Failover"]

_OPEN_SECONDS = 60.0
_MINUTE = 60.0
_AGAIN_SECONDS = 0.1
_REMEMBERED_SECONDS = 300.0
_log = logging.getLogger("uoarm")


@frozen(eq=False)
class Death:
    """One or more components that died at once.

    Attributes:
        lives: what was open of them.
        excluded: names of components that cannot take over: the dead, and all of a dead bridge.
        cause: of the death.
        time: when it was noticed, on the manager's clock.
    """

    lives: tuple[LiveComponent, ...]
    excluded: frozenset[str]
    cause: str
    time: float


class Failover:
    """Replaces the plans of connections, each death in a thread of its own.

    Args:
        policy: whether, how often, and whether to return.
        resolve: finds plans.
        forget: told the name of a component whose structures must be asked for again.
        pool: where plans share components and edges.
        ledger: of the connections that are open.
        board: where changes are posted.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        policy: FailoverPolicy,
        *,
        resolve: Resolve,
        forget: Callable[[str], None],
        pool: Pool,
        ledger: Ledger,
        board: Board,
        clock: Clock,
    ) -> None:
        self._policy = policy
        self._resolve = resolve
        self._forget = forget
        self.failback: Failback | None = None
        if policy.return_after is not None:
            self.failback = Failback(
                policy.return_after,
                resolve=resolve,
                forget=forget,
                pool=pool,
                ledger=ledger,
                board=board,
                clock=clock,
            )
        self._board = board
        self._clock = clock
        self._stopped = threading.Event()
        self._failed: dict[str, float] = {}  # when a component failed last, longest ago first

    def replace(self, connections: Iterable[Connection], death: Death) -> None:
        """Have connections go on with other plans, or end them; returns at once.

        One that is still being opened ends: its application gets the cause from its request.
        """
        for name in {live.component.name for live in death.lives}:
            self._failed.pop(name, None)
            self._failed[name] = death.time
        concerned = list(connections)
        if concerned:
            threading.Thread(
                target=self._replace_all,
                args=(concerned, death),
                name="uoarm-failover",
                daemon=True,
            ).start()

    def close(self) -> None:
        """Replace nothing more."""
        self._stopped.set()
        if self.failback is not None:
            self.failback.close()

    def _replace_all(self, connections: list[Connection], death: Death) -> None:
        """Let everything go on first, then clear away what died."""
        taken = []
        for connection in connections:
            if not self._policy.enabled or connection.state not in GOING_ON:
                _fail(connection, death.cause, death)
                continue
            try:
                succession = self._replace(connection, death)
            except ConnectionClosedError:
                _log.debug("connection %s ended before it was replaced", connection.id)
            except UoarmError as error:
                _fail(connection, f"{death.cause}; nothing takes over: {error}", death)
            else:
                if succession is not None:
                    taken.append(succession)
        for succession in taken:
            succession.finish()

    def _replace(self, connection: Connection, death: Death) -> Succession | None:
        """Have one connection go on; None when it does not depend on the dead any more."""
        excluded = death.excluded
        deadline = death.time + self._policy.wait
        while not connection.ended and any(map(connection.course.uses, death.lives)):
            if not self._may_move(connection):
                text = f"its providers changed {self._policy.limit} times within a minute"
                raise ResolutionError(text)
            preferred = connection.plan
            try:
                plan = self._heir(preferred, connection.output, excluded)
            except ResolutionError:
                if self._clock() >= deadline:
                    raise
                connection.course.wait(death.cause)
                if self._stopped.wait(_AGAIN_SECONDS):
                    raise
                excluded = frozenset()
                for name in death.excluded:
                    self._forget(name)
                continue
            succession = Succession(connection.course, plan, self._clock, death.lives)
            try:
                self._take(connection, succession, death)
            except ConnectionClosedError:
                raise
            except UoarmError as error:
                _log.warning("connection %s: %s", connection.id, error)
                excluded |= set(names(plan)).difference(names(preferred)) or {names(plan)[-1]}
            else:
                return succession
        return None

    def _heir(self, dead: Plan, output: str | None, excluded: frozenset[str]) -> Plan:
        """Return what goes on: what failed lately only where there is nothing else.

        Of that, what failed longest ago comes first. A bridge may well find a component that does
        not do what is expected of it, so that being there again does not mean being well.

        Raises:
            ResolutionError: nothing can go on.
        """
        since = self._clock() - _REMEMBERED_SECONDS
        failed = [name for name, time in self._failed.copy().items() if time >= since]
        while True:
            try:
                return heir(dead, output, excluded.union(failed), self._resolve)
            except ResolutionError:
                if not failed:
                    raise
                del failed[0]

    def _take(self, connection: Connection, succession: Succession, death: Death) -> None:
        """Open a plan and let it take over.

        Raises:
            UoarmError: it could not be opened, or not in time; then it takes over no more.
        """
        preferred, identity = connection.plan, connection.id

        def take() -> None:
            with succession:
                if self.failback is not None:
                    self.failback.look_for(connection, preferred)
                succession.take(death.time, death.cause)

        try:
            _bounded.run(f"takeover of connection {identity}", _OPEN_SECONDS, take)
        except BridgeTimeoutError:
            if succession.withdraw():
                raise
        goes_on = succession.newcomers(frozenset(live.component.name for live in death.lives))
        self._board.post(f"connection {identity}", "replaced", f"{death.cause}; {goes_on} goes on")

    def _may_move(self, connection: Connection) -> bool:
        now = self._clock()
        recent = [gap for gap in connection.gaps if now - gap.time < _MINUTE]
        return len(recent) < self._policy.limit


def _fail(connection: Connection, cause: str, death: Death) -> None:
    connection.course.end(ConnectionState.FAILED, cause, death.lives)
