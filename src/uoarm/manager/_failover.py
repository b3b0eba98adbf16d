"""Failover: what goes on behind a connection's handle when a component dies."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable

from attrs import frozen

from uoarm import _bounded
from uoarm.errors import ConnectionClosedError, ResolutionError, UoarmError
from uoarm.flow import Clock
from uoarm.manager._board import Board
from uoarm.manager._connection import Connection
from uoarm.manager._heirs import Resolve, heir
from uoarm.manager._live import LiveComponent
from uoarm.model import ConnectionState, FailoverPolicy, Gap, Plan

__all__ = ["Death", "Failover"]

_OPEN_SECONDS = 60.0
_MINUTE = 60.0
_AGAIN_SECONDS = 0.1
_LEAST_LOOK_SECONDS = 0.05
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
        board: where changes are posted.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        policy: FailoverPolicy,
        *,
        resolve: Resolve,
        forget: Callable[[str], None],
        board: Board,
        clock: Clock,
    ) -> None:
        self._policy = policy
        self._resolve = resolve
        self._forget = forget
        self._board = board
        self._clock = clock
        self._stopped = threading.Event()
        self._lock = threading.Lock()
        self._moved: dict[str, tuple[Connection, Plan]] = {}
        self._returner: threading.Thread | None = None

    def replace(self, connections: Iterable[Connection], death: Death) -> None:
        """Have connections go on with other plans, or end them; returns at once.

        One that is still being opened ends: its application gets the cause from its request.
        """
        waiting = []
        for connection in connections:
            if self._policy.enabled and connection.state is ConnectionState.RUNNING:
                waiting.append(connection)
            else:
                _fail(connection, death.cause)
        if not waiting:
            return
        threading.Thread(
            target=self._replace_all, args=(waiting, death), name="uoarm-failover", daemon=True
        ).start()

    def close(self) -> None:
        """Replace nothing more."""
        self._stopped.set()

    def _replace_all(self, connections: list[Connection], death: Death) -> None:
        for connection in connections:
            try:
                self._replace(connection, death)
            except ConnectionClosedError:
                _log.debug("connection %s ended before it was replaced", connection.id)
            except UoarmError as error:
                _fail(connection, f"{death.cause}; nothing takes over: {error}")

    def _replace(self, connection: Connection, death: Death) -> None:
        if not any(connection.uses(live) for live in death.lives):
            return
        if not self._may_move(connection):
            text = f"its providers changed {self._policy.limit} times within a minute"
            raise ResolutionError(text)
        preferred = connection.plan
        excluded = death.excluded
        deadline = death.time + self._policy.wait
        while True:
            try:
                plan = heir(preferred, connection.output, excluded, self._resolve)
            except ResolutionError:
                if self._clock() >= deadline or self._stopped.wait(_AGAIN_SECONDS):
                    raise
                excluded = frozenset()
                for name in death.excluded:
                    self._forget(name)
                continue
            try:
                self._move(connection, plan, death, is_dead=True)
            except ConnectionClosedError:
                raise
            except UoarmError as error:
                _log.warning("connection %s: %s", connection.id, error)
                excluded |= set(_names(plan)).difference(_names(preferred)) or {_names(plan)[-1]}
            else:
                self._look_for_return(connection, preferred)
                return

    def _move(self, connection: Connection, plan: Plan, death: Death, *, is_dead: bool) -> None:
        before = connection.plan

        def gap(position: int) -> Gap:
            return Gap(
                time=self._clock(),
                position=position,
                seconds=self._clock() - death.time,
                lost=sum(live.under_way() for live in death.lives),
                before=_names(before),
                after=_names(plan),
                cause=death.cause,
            )

        opened = connection.successor(plan)
        _bounded.run(
            f"takeover of connection {connection.id}",
            _OPEN_SECONDS,
            lambda: connection.succeed(opened, gap, is_dead=is_dead),
        )
        text = f"{death.cause}; {plan.provider.component.name} goes on"
        self._board.post(f"connection {connection.id}", "replaced", text)

    def _may_move(self, connection: Connection) -> bool:
        now = self._clock()
        recent = [gap for gap in connection.gaps if now - gap.time < _MINUTE]
        return len(recent) < self._policy.limit

    def _look_for_return(self, connection: Connection, preferred: Plan) -> None:
        if self._policy.return_after is None:
            return
        with self._lock:
            self._moved.setdefault(connection.id, (connection, preferred))
            if self._returner is None:
                self._returner = threading.Thread(
                    target=self._return_all, name="uoarm-return", daemon=True
                )
                self._returner.start()

    def _return_all(self) -> None:
        """Look again and again whether the preferred plans of connections are available."""
        assert self._policy.return_after is not None, "only such a policy comes here"
        patience = self._policy.return_after
        seen: dict[str, float] = {}
        while not self._stopped.wait(max(_LEAST_LOOK_SECONDS, patience / 4)):
            with self._lock:
                moved = dict(self._moved)
                if not moved:
                    self._returner = None
                    return
            for identity, (connection, preferred) in moved.items():
                if connection.ended:
                    self._stays(identity)
                elif not self._is_available(preferred):
                    seen.pop(identity, None)
                elif self._clock() - seen.setdefault(identity, self._clock()) >= patience:
                    seen.pop(identity)
                    self._return(connection, preferred)

    def _is_available(self, preferred: Plan) -> bool:
        for name in _names(preferred):
            self._forget(name)
        try:
            return _names(self._resolve(preferred.function, frozenset())) == _names(preferred)
        except UoarmError:
            return False

    def _return(self, connection: Connection, preferred: Plan) -> None:
        self._stays(connection.id)
        back = Death((), frozenset(), "its preferred components are available again", self._clock())
        try:
            plan = heir(connection.plan, connection.output, frozenset(), self._resolve)
            self._move(connection, plan, back, is_dead=False)
        except UoarmError as error:
            _log.warning("connection %s stays where it is: %s", connection.id, error)
            if not connection.ended:
                self._look_for_return(connection, preferred)

    def _stays(self, identity: str) -> None:
        with self._lock:
            self._moved.pop(identity, None)


def _names(plan: Plan) -> tuple[str, ...]:
    return tuple(step.component.name for step in plan.steps)


def _fail(connection: Connection, cause: str) -> None:
    connection.end(ConnectionState.FAILED, cause)
