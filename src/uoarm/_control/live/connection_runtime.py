"""What the manager holds of one connection beside its record: its inbox, its ports, its losses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from uoarm._control.live.application_ports import ApplicationPorts, OutputReceiver
from uoarm._control.live.losses import LossAccount
from uoarm._control.reconciler.actions import HandOver
from uoarm._control.reconciler.state import ConnectionRecord, names
from uoarm.model import Gap, QueuePolicy, RouteStatus

__all__ = ["ConnectionRuntime"]


class ConnectionRuntime:
    """One connection, as the threads see it that move messages and those that read its handle.

    Args:
        identity: of the connection.
        queue: what to do when the application is slower than the messages.
        on_raised: told what a callback of the application raised first.

    Attributes:
        record: the connection as it was published last; None while its request is being resolved.
        receiver: what the application reads.
        ports: where the application touches the plan that runs.
        losses: what is accounted for.
        handle: the `Connection` that the application holds; None before it has it, and at its end.
        context: of its request, to which spans of other threads belong.
    """

    def __init__(self, identity: str, queue: QueuePolicy, on_raised: Callable[[str], None]) -> None:
        self.id = identity
        self.record: ConnectionRecord | None = None
        self.receiver = OutputReceiver(queue, on_raised)
        self.losses = LossAccount()
        self.ports: ApplicationPorts | None = None
        self.handle: Any = None
        self.context: Any = None
        self._uncounted: dict[str, Gap] = {}

    def publish(self, record: ConnectionRecord, *, is_over: bool) -> None:
        """Show the connection as it is now; at its end, its inbox closes."""
        self.record = record
        if is_over:
            self.receiver.inbox.close(discard=record.is_killed)
            self.handle = None  # which refers to this

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of the routes that belong to this connection alone."""
        ports = self.ports
        return () if ports is None else tuple(route.status() for route in ports.routes())

    def hand_over(self, action: HandOver, ports: ApplicationPorts) -> None:
        """Hear the next plan and no other, and note the gap, whose losses are not counted yet.

        Whoever sees the gap sees the plan behind it.

        Args:
            action: which plan takes over from which, when and why.
            ports: where the application touches the next one.
        """
        before, after = action.before, action.after
        self.ports = ports
        self.receiver.hear(ports.route, ports.outlet)
        stays = before.ports == after.ports
        gap = Gap(
            time=action.time,
            position=self.receiver.arrived if stays else self.receiver.began,
            seconds=action.time - action.since,
            lost=0,
            before=names(before.plan),
            after=names(after.plan),
            cause=action.cause,
            counted=False,
        )
        self._uncounted[before.user] = gap
        if action.is_heard:  # else it was published before
            self.record = action.record
        self.losses.add(gap)

    def take_gap(self, before: str) -> Gap | None:
        """Return the gap in which the plan of this user ended, once; None: it never ran."""
        return self._uncounted.pop(before, None)
