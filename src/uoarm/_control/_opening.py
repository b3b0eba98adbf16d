"""Opening a plan: every step is undone in reverse when one fails, or when the plan is killed."""

from __future__ import annotations

from collections.abc import Callable

from attrs import define, field

from uoarm._control._ends import Ends
from uoarm._control._live import LiveComponent, connection_of
from uoarm._control._live_edge import LiveEdge
from uoarm._control._pool import Pool
from uoarm._control._sender import Sender
from uoarm._dataplane import Clock, Route
from uoarm.model import Edge, Health, Plan, ValidationMode

__all__ = ["OpenPlan"]


@define(eq=False)
class OpenPlan:
    """What one connection holds open, and how to let go of it.

    Consumers are opened before their producers, so that no first message is lost, and closed
    after them.

    Args:
        plan: the plan to open.
        user: id of the connection; behind a `#`, which of its plans this is.
        pool: where components and edges are shared.
        validate: how many messages are checked.
        clock: seconds.
        beside: whether its inputs may be fed by another plan until `Pool.change_over`.
    """

    plan: Plan
    user: str
    pool: Pool
    validate: ValidationMode
    clock: Clock
    beside: bool = False
    edges: list[LiveEdge] = field(factory=list, init=False)
    _ends: Ends | None = field(default=None, init=False)
    _owns_ends: bool = field(default=False, init=False)
    _lives: dict[str, LiveComponent] = field(factory=dict, init=False)
    _undo: list[Callable[[], None]] = field(factory=list, init=False)

    @property
    def ends(self) -> Ends:
        """Where the application touches the plan, once it is being opened."""
        assert self._ends is not None, "the ends are made before anything is opened"
        return self._ends

    @property
    def components(self) -> tuple[LiveComponent, ...]:
        """The components in use."""
        return tuple(self._lives.values())

    def open(
        self, output: str | None, receive: Callable[[], Route | None], before: Ends | None = None
    ) -> None:
        """Open everything.

        Args:
            output: of the provider, whose messages the application receives.
            receive: makes the route that takes them.
            before: the ends of the plan so far, which stay where this plan has the same open
                provider; see `inherit`.

        Raises:
            UoarmError: a step failed. What was opened is still held: call `close`.
        """
        for step in reversed(self.plan.steps):
            live = self.pool.enter(step, self.user)
            self._lives[step.component.name] = live
            self._undo.append(lambda live=live: self.pool.leave(live, self.user))  # type: ignore[misc]
        provider = self._lives[self.plan.provider.component.name]
        is_same = before is not None and before.provider is provider
        ends = before if is_same and before is not None else Ends(provider, receive(), output)
        self._ends, self._owns_ends = ends, not is_same
        if self._owns_ends:
            ends.attach()
        self._open_steps(None if ends.route is None else output)
        if self._owns_ends:
            ends.feed(connection_of(self.user), self.validate, self.clock)

    def shares_ends(self, other: OpenPlan) -> bool:
        """Say whether the application touches both plans at the same provider."""
        return self._ends is not None and self._ends is other._ends

    def inherit(self, before: OpenPlan) -> None:
        """Take over the ends that the plan so far has in common with this one."""
        if self.shares_ends(before):
            before._owns_ends, self._owns_ends = False, True

    def close(self) -> None:
        """Undo every step that was done, last first. May be called by several threads."""
        if self._owns_ends:
            self.ends.close()
        while self._undo:
            try:
                undo = self._undo.pop()
            except IndexError:
                return
            undo()

    def run_out(self, timeout: float) -> None:
        """Let what is under way pass through what ends with this plan; new messages stay out.

        Waits `timeout` seconds at most for each queue and component.
        """
        for joined in self._edges_downstream():
            if set(joined.users) == {self.user}:
                joined.finish()
            if joined.consumer.users == [self.user]:
                joined.consumer.drain(timeout)

    def drain(self, timeout: float) -> None:
        """Wait until what is under way has passed every edge, `timeout` seconds for each."""
        for joined in self._edges_downstream():
            if joined.route is not None:
                joined.route.drain(timeout)
                joined.consumer.drain(timeout)

    def routes(self) -> tuple[Route | Sender, ...]:
        """Return the routes at its ends; none before it is being opened."""
        return () if self._ends is None else self._ends.routes()

    def flush(self, timeout: float) -> bool:
        """Wait until what the application sent was taken; False when time ran out."""
        return self._ends is None or self._ends.flush(timeout)

    def uses(self, live: LiveComponent) -> bool:
        """Say whether the connection depends on this open component."""
        return any(one is live for one in self._lives.values())

    def lost(self) -> frozenset[str]:
        """Return the names of its components that were lost."""
        lives = tuple(self._lives.items())
        return frozenset(name for name, one in lives if one.condition.health is Health.LOST)

    def _open_steps(self, output: str | None) -> None:
        """Open inputs, then outputs, from the provider up to the first producers."""
        incoming: dict[str, list[Edge]] = {}
        for edge in self.plan.edges:
            incoming.setdefault(edge.consumer, []).append(edge)
        wanted = {name: set[str]() for name in self._lives}
        if output is not None:
            wanted[self.ends.provider.component.name].add(output)
        for step in reversed(self.plan.steps):
            live = self._lives[step.component.name]
            for name in sorted(wanted[step.component.name]):
                live.open_output(name)
            for edge in incoming.get(step.component.name, ()):
                joined = self._join(edge, live)
                if joined.route is not None:
                    wanted[edge.producer].add(edge.output)

    def _edges_downstream(self) -> list[LiveEdge]:
        """Return its edges, those of the first producers first."""
        order = {step.component.name: n for n, step in enumerate(self.plan.steps)}
        return sorted(self.edges, key=lambda one: order[one.edge.producer])

    def _join(self, edge: Edge, consumer: LiveComponent) -> LiveEdge:
        producer = self._lives[edge.producer]
        joined = self.pool.join(
            edge,
            self.user,
            producer=producer,
            consumer=consumer,
            validate=self.validate,
            beside=self.beside,
        )
        self.edges.append(joined)
        self._undo.append(lambda: self.pool.part(joined, self.user))
        return joined
