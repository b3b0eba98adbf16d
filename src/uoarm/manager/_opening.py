"""Opening a plan: every step is undone in reverse when one fails, or when the plan is killed."""

from __future__ import annotations

from collections.abc import Callable

from attrs import define, field

from uoarm.flow import Clock, Route
from uoarm.manager._live import LiveComponent, connection_of
from uoarm.manager._pool import LiveEdge, Pool
from uoarm.manager._sender import Sender
from uoarm.model import Edge, Plan, ValidationMode

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
    """

    plan: Plan
    user: str
    pool: Pool
    validate: ValidationMode
    clock: Clock
    senders: dict[str, Sender] = field(factory=dict, init=False)
    edges: list[LiveEdge] = field(factory=list, init=False)
    _lives: dict[str, LiveComponent] = field(factory=dict, init=False)
    _undo: list[Callable[[], None]] = field(factory=list, init=False)

    @property
    def provider(self) -> LiveComponent:
        """The open component that provides the function asked for."""
        return self._lives[self.plan.provider.component.name]

    @property
    def components(self) -> tuple[LiveComponent, ...]:
        """The components in use."""
        return tuple(self._lives.values())

    def component(self, name: str) -> LiveComponent:
        """Return an open component of the plan."""
        return self._lives[name]

    def open(self, output: str | None, receive: Route | None) -> None:
        """Open everything; `receive` takes the messages of the provider's `output`.

        Raises:
            UoarmError: a step failed. What was opened is still held: call `close`.
        """
        for step in reversed(self.plan.steps):
            live = self.pool.enter(step, self.user)
            self._lives[step.component.name] = live
            self._undo.append(lambda live=live: self.pool.leave(live, self.user))  # type: ignore[misc]
        incoming: dict[str, list[Edge]] = {}
        for edge in self.plan.edges:
            incoming.setdefault(edge.consumer, []).append(edge)
        wanted = {name: set[str]() for name in self._lives}
        if output is not None and receive is not None:
            wanted[self.provider.component.name].add(output)
            self._receive(output, receive)
        for step in reversed(self.plan.steps):
            live = self._lives[step.component.name]
            for name in sorted(wanted[step.component.name]):
                live.open_output(name)
            for edge in incoming.get(step.component.name, ()):
                joined = self._join(edge, live)
                if joined.route is not None:
                    wanted[edge.producer].add(edge.output)
        for port in self.provider.component.inputs:
            if port.source is None:
                self._feed(port.name)

    def close(self) -> None:
        """Undo every step that was done, last first. May be called by several threads."""
        while self._undo:
            try:
                undo = self._undo.pop()
            except IndexError:
                return
            undo()

    def uses(self, live: LiveComponent) -> bool:
        """Say whether the connection depends on this open component."""
        return any(one is live for one in self._lives.values())

    def _feed(self, name: str) -> None:
        sender = Sender(self.provider, name, connection_of(self.user), self.validate, self.clock)
        self.senders[name] = sender
        self._undo.append(sender.close)

    def _receive(self, output: str, route: Route) -> None:
        outlet = self.provider.outlets[output]
        outlet.attach(route)

        def undo() -> None:
            outlet.detach(route)
            route.close()

        self._undo.append(undo)

    def _join(self, edge: Edge, consumer: LiveComponent) -> LiveEdge:
        producer = self._lives[edge.producer]
        joined = self.pool.join(
            edge, self.user, producer=producer, consumer=consumer, validate=self.validate
        )
        self.edges.append(joined)
        self._undo.append(lambda: self.pool.part(joined, self.user, producer))
        return joined
