"""Failback: the return of connections to better plans, once those have been there for a while."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import ExitStack

from uoarm import _bounded
from uoarm._control._board import Board
from uoarm._control._connection import Connection
from uoarm._control._heirs import Resolve, heir, names
from uoarm._control._ledger import Ledger
from uoarm._control._live import connection_of
from uoarm._control._pool import Pool
from uoarm._control._succession import Succession
from uoarm._dataplane import Clock
from uoarm.errors import ConnectionClosedError, UoarmError
from uoarm.model import ConnectionState, Plan

__all__ = ["Failback"]

_LEAST_LOOK_SECONDS = 0.05
_OPEN_SECONDS = 60.0
_CAUSE = "its preferred components are available again"
_log = logging.getLogger("uoarm")


class Failback:
    """Looks again and again whether the preferred plans of connections are available.

    Args:
        patience: seconds that a better plan must have been available without a break.
        resolve: finds plans.
        forget: told the name of a component whose structures must be asked for again.
        pool: where plans share components and edges.
        ledger: of the connections that are open.
        board: where changes are posted.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        patience: float,
        *,
        resolve: Resolve,
        forget: Callable[[str], None],
        pool: Pool,
        ledger: Ledger,
        board: Board,
        clock: Clock,
    ) -> None:
        self._patience = patience
        self._resolve = resolve
        self._forget = forget
        self._pool = pool
        self._ledger = ledger
        self._board = board
        self._clock = clock
        self._stopped = threading.Event()
        self._lock = threading.Lock()
        self._moved: dict[str, tuple[Connection, Plan]] = {}
        self._seen: dict[str, float] = {}
        self._thread: threading.Thread | None = None

    def look_for(self, connection: Connection, preferred: Plan) -> None:
        """Have a connection return to a plan; the first one that it lost counts."""
        with self._lock:
            self._moved.setdefault(connection.id, (connection, preferred))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="uoarm-return", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """Return nothing more."""
        self._stopped.set()

    def look(self) -> bool:
        """Return what can return now; False when nothing is left to look for."""
        with self._lock:
            moved = dict(self._moved)
            if not moved:
                self._thread = None
                return False
        for identity, (connection, preferred) in moved.items():
            if connection.ended:
                self._settle(identity)
            elif not self._is_available(preferred):
                self._seen.pop(identity, None)
            elif self._clock() - self._seen.setdefault(identity, self._clock()) >= self._patience:
                self._seen.pop(identity)
                self._return(connection)
        return True

    def _run(self) -> None:
        pause = max(_LEAST_LOOK_SECONDS, self._patience / 4)
        while not self._stopped.wait(pause) and self.look():
            pass

    def _is_available(self, preferred: Plan) -> bool:
        for name in names(preferred):
            self._forget(name)
        try:
            return names(self._resolve(preferred.function, frozenset())) == names(preferred)
        except UoarmError:
            return False

    def _return(self, connection: Connection) -> None:
        begun = self._clock()
        try:
            together = self._companions(connection)
            step = f"return of connection {', '.join(one.id for one in together)}"
            _bounded.run(step, _OPEN_SECONDS, lambda: self._move(together, begun))
        except UoarmError as error:
            _log.warning("connection %s stays where it is: %s", connection.id, error)
            return
        for one in together:
            self._settle(one.id)

    def _companions(self, first: Connection) -> dict[Connection, Plan]:
        """Return what must return at once, since an input has one producer for all its users.

        Raises:
            ResolutionError: one of them has no better plan that fits.
        """
        running = {one.id: one for one in self._ledger.all()}
        found: dict[Connection, Plan] = {}
        waiting = [first]
        while waiting:
            one = waiting.pop()
            if one in found or one.state is not ConnectionState.RUNNING:
                continue
            found[one] = heir(one.plan, one.output, frozenset(), self._resolve)
            users = {connection_of(user) for user in self._pool.rivals(found[one])}
            waiting += [running[user] for user in sorted(users) if user in running]
        return found

    def _move(self, plans: dict[Connection, Plan], begun: float) -> None:
        """Open all the better plans beside the present ones, then change over at once."""
        successions = [
            Succession(connection.course, plan, self._clock) for connection, plan in plans.items()
        ]
        with ExitStack() as stack:
            for succession in successions:
                stack.enter_context(succession)
            self._pool.change_over(
                joined for succession in successions for joined in succession.opened.edges
            )
            taken = [one for one in successions if self._take(one, begun)]
        for succession in taken:
            text = f"{_CAUSE}; {succession.newcomers()} goes on"
            self._board.post(f"connection {succession.course.id}", "replaced", text)
        for succession in taken:
            succession.finish()

    def _take(self, succession: Succession, begun: float) -> bool:
        try:
            succession.take(begun, _CAUSE)
        except ConnectionClosedError as error:
            _log.debug("%s", error)
            return False
        return True

    def _settle(self, identity: str) -> None:
        with self._lock:
            self._moved.pop(identity, None)
            self._seen.pop(identity, None)
