"""One loop over everything that a node of ours waits for; it takes the place of an executor."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from uoarm_ros2._middleware._wait_set import Entity, EventEntity, WaitSet

__all__ = ["WaitLoop"]

_MOST_AT_ONCE = 32
_EVENT_SECONDS = 0.02
_log = logging.getLogger("uoarm.ros2")


class WaitLoop:
    """Waits for entities and takes all that is ready; one thread makes every turn.

    Its wait sets are built anew only when entities came or went. Waiting for an entity costs about
    a microsecond in each turn, and each subscription has some three events: while messages flow,
    those are looked at fifty times a second only, and at once when nothing else happens.

    Args:
        context: rclpy's context.
        quiet: whether failures need not be told any more, as while everything ends.
    """

    def __init__(self, context: Any, quiet: Callable[[], bool]) -> None:
        self._context = context
        self._quiet = quiet
        with context.handle:
            self._guard = _rclpy.GuardCondition(context.handle)
        self._lock = threading.Lock()
        self._soon: deque[Callable[[], None]] = deque()
        self._entities: tuple[Entity, ...] = ()
        self._changed = True
        self._everything: WaitSet | None = None
        self._without_events: WaitSet | None = None
        self._events_due = 0.0

    def add(self, *entities: Entity) -> None:
        """Wait for these too; from any thread."""
        with self._lock:
            self._entities += entities
            self._changed = True
        self.wake()

    def remove(self, *entities: Entity) -> None:
        """Wait for these no more; from any thread. What is taken already is still delivered."""
        for entity in entities:
            entity.removed = True
        with self._lock:
            self._entities = tuple(each for each in self._entities if not each.removed)
            self._changed = True
        self.wake()

    def wake(self) -> None:
        """End a wait at once; from any thread."""
        # After `close`, as when somebody else ended the context, there is no guard and no wait.
        with suppress(InvalidHandle), self._guard:
            self._guard.trigger_guard_condition()

    def call_soon(self, act: Callable[[], None]) -> None:
        """Have something done in the thread that makes the turns; from any thread."""
        self._soon.append(act)
        self.wake()

    def turn(self, seconds: float) -> None:
        """Wait no longer than that for anything, and hand on all that is there."""
        while self._soon:
            self._soon.popleft()()
        if self._changed:
            self._build()
        now = time.monotonic()
        early = self._events_due - now
        chosen = self._everything if early <= 0 else self._without_events
        assert chosen is not None
        ready = chosen.wait(seconds if early <= 0 else min(seconds, early))
        if chosen is self._everything and ready:
            self._events_due = time.monotonic() + _EVENT_SECONDS
        for entity in ready:
            self._take(entity)

    def close(self) -> None:
        """Let go of everything; in the thread that makes the turns."""
        for each in (self._everything, self._without_events):
            if each is not None:
                each.close()
        self._everything = self._without_events = None
        self._guard.destroy_when_not_in_use()

    def _build(self) -> None:
        with self._lock:
            entities, self._changed = self._entities, False
        before = self._everything, self._without_events
        handle, guard = self._context.handle, self._guard
        self._everything = WaitSet(handle, guard, entities)
        quick = [entity for entity in entities if not isinstance(entity, EventEntity)]
        self._without_events = WaitSet(handle, guard, quick)
        for each in before:
            if each is not None:
                each.close()

    def _take(self, entity: Entity) -> None:
        """Take what an entity has; one of which much has come gives way to the others."""
        try:
            for _ in range(_MOST_AT_ONCE):
                if entity.removed or not entity.take():
                    return
        except InvalidHandle:
            pass  # it went between the look and the taking
        except Exception as error:  # noqa: BLE001 - one failure is nobody else's
            if not self._quiet():
                _log.error("a callback of ROS 2 failed", exc_info=error)
