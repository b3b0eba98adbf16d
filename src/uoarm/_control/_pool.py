"""The pool: components and edges that are open, each opened once and counted by its users."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

from uoarm._control._live import LiveComponent, connection_of
from uoarm._control._live_edge import LiveEdge
from uoarm._dataplane import Clock
from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, ConnectionClosedError, FailureReason, ResolutionError
from uoarm.model import Edge, Plan, Step, ValidationMode

__all__ = ["Pool"]

_HANGING = 4


class Pool:
    """What is open now, shared between connections.

    Args:
        bridge: gives the bridge instance of a name.
        clock: seconds.
    """

    def __init__(self, bridge: Callable[[str], Bridge], clock: Clock) -> None:
        self._bridge = bridge
        self._clock = clock
        self._lock = threading.Lock()
        self._components: dict[str, LiveComponent] = {}
        self._edges: dict[tuple[str, str], LiveEdge] = {}
        self._beside: dict[tuple[str, str], LiveEdge] = {}
        self._hanging: dict[str, list[LiveComponent]] = {}

    def enter(self, step: Step, user: str) -> LiveComponent:
        """Count a user of a component; nothing is opened yet.

        Raises:
            BridgeError: threads of earlier connections hang in the component, too many to risk
                another one.
        """
        bridge = self._bridge(step.component.bridge)
        with self._lock:
            live = self._components.get(step.component.name)
            if live is None:
                self._refuse_hanging(step.component.name)
                live = self._components[step.component.name] = LiveComponent(step, bridge)
            live.users.append(user)
            return live

    def leave(self, live: LiveComponent, user: str) -> None:
        """Take one user back; the last one closes the component."""
        with self._lock:
            live.users.remove(user)
            if live.users:
                return
            if self._components.get(live.component.name) is live:
                del self._components[live.component.name]
        live.close()
        if live.is_hanging:
            with self._lock:
                self._hanging.setdefault(live.component.name, []).append(live)

    def join(
        self,
        edge: Edge,
        user: str,
        *,
        producer: LiveComponent,
        consumer: LiveComponent,
        validate: ValidationMode,
        beside: bool = False,
    ) -> LiveEdge:
        """Count a user of an edge, and open it when there was none.

        Args:
            edge: to open.
            user: who counts as its user.
            producer: the open component at its beginning.
            consumer: the open component at its end.
            validate: how many messages this user wishes to be checked.
            beside: whether another edge may feed the input still; then `change_over` comes next.

        Raises:
            ResolutionError: the input is in use, fed by another component.
            BridgeError: a bridge could not open the input.
        """
        with self._lock:
            joined = self._place(edge, producer, consumer, beside=beside)
            joined.users[user] = validate
        try:
            joined.open(self._clock)
        except BaseException:
            self.part(joined, user)
            raise
        if user not in joined.users:
            joined.close()
            key = edge.consumer
            raise ConnectionClosedError(f"{user} was given up while {key!r} was being opened")
        return joined

    def part(self, joined: LiveEdge, user: str) -> None:
        """Take one user of an edge back; the last one closes it."""
        with self._lock:
            joined.users.pop(user, None)
            if not joined.users:
                for places in (self._edges, self._beside):
                    if places.get(joined.key) is joined:
                        del places[joined.key]
        if joined.users:
            joined.renew_check()
        else:
            joined.close()

    def rivals(self, plan: Plan) -> set[str]:
        """Return the users of edges that feed what a plan would feed from elsewhere."""
        with self._lock:
            return {
                user
                for edge in plan.edges
                if (joined := self._edges.get((edge.consumer, edge.input))) is not None
                and joined.origin != (edge.producer, edge.output)
                for user in joined.users
            }

    def change_over(self, edges: Iterable[LiveEdge]) -> None:
        """Let those of the edges that are held take the places of the ones that stand there.

        What waits in a queue passes first, five seconds for each edge at most.

        Raises:
            ResolutionError: somebody else uses an edge that would end. Nothing has changed.
            BridgeError: a bridge could not link both ends of an edge.
        """
        held = [joined for joined in dict.fromkeys(edges) if joined.held]
        with self._lock:
            standing = [self._edges.get(joined.key) for joined in held]
            for joined, other in zip(held, standing, strict=True):
                left = set() if other is None else _connections(other) - _connections(joined)
                if left:
                    raise ResolutionError(
                        f"input {'.'.join(joined.key)} is fed for {', '.join(sorted(left))} by "
                        "another component still"
                    )
            for joined in held:
                del self._beside[joined.key]
                self._edges[joined.key] = joined
        for joined, other in zip(held, standing, strict=True):
            if other is not None:
                other.finish()
            joined.release(self._clock)

    def bury(self, live: LiveComponent) -> None:
        """Share a dead component no more; its users still leave it as ever.

        Its edges stop at once, so that what each of them had counted stands.
        """
        name = live.component.name
        with self._lock:
            if self._components.get(name) is not live:
                return
            del self._components[name]
            ended = [one for one in self._edges.values() if live in {one.producer, one.consumer}]
            for joined in ended:
                del self._edges[joined.key]
        for joined in ended:
            if joined.route is not None:
                joined.route.stop()

    def components(self) -> tuple[LiveComponent, ...]:
        """Return the components open now."""
        with self._lock:
            return tuple(self._components.values())

    def edges(self) -> tuple[LiveEdge, ...]:
        """Return the edges open now."""
        with self._lock:
            return tuple(self._edges.values())

    def _refuse_hanging(self, name: str) -> None:
        hanging = [live for live in self._hanging.pop(name, ()) if live.is_hanging]
        if hanging:
            self._hanging[name] = hanging
        if len(hanging) >= _HANGING:
            raise BridgeError(
                f"component {name!r} hangs: it has not let go of {len(hanging)} earlier "
                "connections; it can be opened again when it does",
                FailureReason.UNAVAILABLE,
            )

    def _place(
        self, edge: Edge, producer: LiveComponent, consumer: LiveComponent, *, beside: bool
    ) -> LiveEdge:
        """Return the edge that is there already, or a new one in its place or beside it.

        One that an opening given up has left behind is replaced.
        """
        key = edge.consumer, edge.input
        standing = self._edges.get(key)
        if standing is None or standing.is_stale:
            joined = self._edges[key] = LiveEdge(edge, producer, consumer)
            return joined
        origin = edge.producer, edge.output
        if standing.origin == origin:
            return standing
        waiting = self._beside.get(key)
        if waiting is not None and waiting.is_stale:
            waiting = None
        if not beside or (waiting is not None and waiting.origin != origin):
            raise ResolutionError(
                f"component {edge.consumer!r} is in use with its input {edge.input!r} fed by "
                f"{standing.edge.producer!r}; this plan feeds it from {edge.producer!r}"
            )
        if waiting is None:
            waiting = self._beside[key] = LiveEdge(edge, producer, consumer, held=True)
        return waiting


def _connections(joined: LiveEdge) -> set[str]:
    return {connection_of(user) for user in joined.users}
