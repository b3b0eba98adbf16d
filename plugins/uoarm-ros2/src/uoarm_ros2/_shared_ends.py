"""The clients of services and actions, and the servers of offered actions: each is made once."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from attrs import define

from uoarm.model import Message
from uoarm_ros2._actions import Action
from uoarm_ros2._graph import Graph
from uoarm_ros2._middleware import Station
from uoarm_ros2._offered_action import OfferedAction
from uoarm_ros2._services import Caller

__all__ = ["SharedEnds"]

_ASKED_SECONDS = 10.0
_Key = tuple[str, str]
Opened = TypeVar("Opened")


@define(eq=False)
class _Asked:
    """The client of a node's service, how many use it now, and when it was last used."""

    caller: Caller
    users: int = 0
    last: float = 0.0


class SharedEnds:
    """Ends that the calls and the channels of a bridge share, by full name and type.

    Replies, results and feedback arrive in a station of their own, which starts with the first end
    that needs it. All methods may be called from any thread, `tick` in that of the first station.

    Args:
        station: where goals of offered actions come, as messages of topics do, so that whoever
            takes one may call.
        graph: what is there.
        start_replies: starts the other station.
    """

    def __init__(
        self, station: Station, graph: Graph, start_replies: Callable[[], Station]
    ) -> None:
        self._station = station
        self._graph = graph
        self._start_replies = start_replies
        self._making = threading.RLock()
        self._replies: Station | None = None
        self._callers: dict[_Key, Caller] = {}
        self._asked: dict[_Key, _Asked] = {}
        self._actions: dict[_Key, Action] = {}
        self._offered: dict[_Key, OfferedAction] = {}

    def replies(self) -> Station:
        """Return the station in which replies arrive."""
        with self._making:
            if self._replies is None:
                self._replies = self._start_replies()
            return self._replies

    def caller(self, name: str, type_name: str) -> Caller:
        """Return the client of a service."""
        with self._making:
            caller = self._callers.get((name, type_name))
            if caller is None:
                caller = Caller(self.replies(), self._graph, name, type_name)
                self._callers[name, type_name] = caller
            return caller

    def ask(self, name: str, type_name: str, request: Message, seconds: float) -> Message:
        """Call a service of a node; its client goes when nobody has asked for a while.

        Nodes with names that are never seen again come and go.

        Raises:
            BridgeError: as `Caller.call`.
        """
        with self._making:
            asked = self._asked.get((name, type_name))
            if asked is None:
                asked = _Asked(Caller(self.replies(), self._graph, name, type_name))
                self._asked[name, type_name] = asked
            asked.users += 1
        try:
            return asked.caller.call(request, seconds, seconds)
        finally:
            with self._making:
                asked.users -= 1
                asked.last = time.monotonic()

    def action(self, name: str, type_name: str) -> Action:
        """Return the client of an action."""
        with self._making:
            action = self._actions.get((name, type_name))
            if action is None:
                action = Action(self.replies(), self._graph, name, type_name)
                self._actions[name, type_name] = action
            return action

    def with_offered(
        self, name: str, type_name: str, open_: Callable[[OfferedAction], Opened]
    ) -> Opened:
        """Open something at the server of an action, which does not go meanwhile."""
        with self._making:
            offered = self._offered.get((name, type_name))
            if offered is None:
                offered = OfferedAction(self._station, name, type_name)
                self._offered[name, type_name] = offered
            return open_(offered)

    def tick(self) -> None:
        """Look after them a few times a second; what nobody uses any more goes."""
        self._forget_asked()
        for action in list(self._actions.values()):
            action.tick()
        for key, offered in list(self._offered.items()):
            offered.tick()
            with self._making:
                if offered.is_unused:
                    del self._offered[key]
                    offered.destroy()

    def _forget_asked(self) -> None:
        now = time.monotonic()
        for key, asked in list(self._asked.items()):
            with self._making:
                if not asked.users and now - asked.last > _ASKED_SECONDS:
                    del self._asked[key]
                    asked.caller.close()

    def close(self) -> None:
        """End the goals that are offered."""
        for offered in list(self._offered.values()):
            offered.destroy()
