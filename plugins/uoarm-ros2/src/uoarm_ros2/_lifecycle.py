"""What a lifecycle node is asked next, decided without asking.

    unconfigured --configure--> inactive --activate--> active --deactivate--> inactive --cleanup-->

https://design.ros2.org/articles/node_lifecycle.html; a failed callback leads by `errorprocessing`
to `unconfigured` or to `finalized`, which nothing leaves.
"""

from __future__ import annotations

from enum import IntEnum

from uoarm.model import Health

__all__ = ["Lifecycle", "Transition"]

_ACTIVE, _INACTIVE, _UNCONFIGURED = "active", "inactive", "unconfigured"
_LOST = (_UNCONFIGURED, "errorprocessing", "finalized")


class Transition(IntEnum):
    """What a node can be asked, with the numbers of lifecycle_msgs/msg/Transition."""

    CONFIGURE = 1
    CLEANUP = 2
    ACTIVATE = 3
    DEACTIVATE = 4

    def __str__(self) -> str:
        return self.name.lower()


_LEADS_TO = {
    Transition.CONFIGURE: _INACTIVE,
    Transition.CLEANUP: _UNCONFIGURED,
    Transition.ACTIVATE: _ACTIVE,
    Transition.DEACTIVATE: _INACTIVE,
}


class Lifecycle:
    """One node: the state that is wanted, the state as last seen, and our own changes to it.

    A node that was configured or active before it was wanted is left so afterwards. What another
    client changes meanwhile stays, unless the node is to be kept active; a node that failed is left
    alone, too.

    Attributes:
        state: the label that the node reported last, empty before.
        why_not: why nothing more is asked although the node is wanted and not active.
    """

    def __init__(self) -> None:
        self.state = ""
        self.why_not = ""
        self._wanted = False
        self._keep = False
        self._afterwards = ""
        self._configured = False
        self._activated = False
        self._seen_active = False

    def want(self, *, keep: bool, afterwards: str) -> None:
        """Want the node active from now on, and once more where that was given up.

        Args:
            keep: activate it again when another client deactivates it.
            afterwards: `deactivate`, `cleanup` or `leave`.
        """
        self._wanted, self._keep, self._afterwards = True, keep, afterwards
        self.why_not = ""
        self._seen_active = False

    def release(self) -> None:
        """Want it no more."""
        self._wanted = False
        self.why_not = ""

    def saw(self, state: str) -> None:
        """Take note of the state that the node reports."""
        self.state = state
        if state == _ACTIVE:
            self._seen_active = True
            return
        if state in (_INACTIVE, *_LOST):
            self._activated = False
            stays = state in _LOST or not self._keep
            if self._wanted and self._seen_active and stays and not self.why_not:
                self.why_not = "not asked for here"
        if state in _LOST:
            self._configured = False

    def next(self) -> Transition | None:
        """Return what to ask the node now, None for nothing, or while it changes."""
        if self._wanted:
            wanted = {_UNCONFIGURED: Transition.CONFIGURE, _INACTIVE: Transition.ACTIVATE}
            return None if self.why_not else wanted.get(self.state)
        if self.why_not or self._afterwards == "leave":
            return None
        if self.state == _ACTIVE and self._activated:
            return Transition.DEACTIVATE
        is_ours = self.state == _INACTIVE and self._configured
        return Transition.CLEANUP if is_ours and self._afterwards == "cleanup" else None

    def ended(self, transition: Transition, state: str) -> None:
        """Take note of the state in which something that was asked has ended."""
        succeeded = state == _LEADS_TO[transition]
        if succeeded and transition is Transition.CONFIGURE:
            self._configured = True
        elif succeeded and transition is Transition.ACTIVATE:
            self._activated = True
        elif not succeeded:
            self.why_not = f"{transition} failed"
        why_not = self.why_not
        self._seen_active = False  # our own transition is no other client's change
        self.saw(state)
        self.why_not = why_not

    def health(self) -> Health:
        """Return what the state means for the components of the node."""
        if self.state in _LOST:
            return Health.LOST
        return Health.OK if self.state == _ACTIVE else Health.DEGRADED
