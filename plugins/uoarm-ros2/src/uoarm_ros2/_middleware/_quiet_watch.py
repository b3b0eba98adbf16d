"""Waits for what is seldom ready in a thread of its own, so that the busy one need not."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from uoarm_ros2._middleware._wait_set import Entity, TurnCounter, Turns, WaitSet

__all__ = ["QuietWatch"]

_WAIT_SECONDS = 10.0
_CALM_SECONDS = 0.5
_END_SECONDS = 2.0
_log = logging.getLogger("uoarm.ros2")


class QuietWatch:
    """Tells when one of many entities is ready, then rests until it is told what to watch next.

    It takes nothing from them: what is ready stays so, and would be told again and again.

    Args:
        context: rclpy's context.
        name: of the thread.
        tell: takes what is ready, in this thread; must not block.
    """

    def __init__(self, context: Any, name: str, tell: Callable[[list[Entity]], None]) -> None:
        self._counter = TurnCounter()
        self._context = context
        self._name = name
        self._tell = tell
        with context.handle:
            self._guard = _rclpy.GuardCondition(context.handle)
        self._go_on = threading.Event()
        self._lock = threading.Lock()
        self._wanted: Sequence[Entity] = ()
        self._changed = False
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def turns(self) -> Turns:
        """How often its thread has turned, and how often for nothing."""
        return self._counter.turns

    def watch(self, entities: Sequence[Entity]) -> None:
        """Wait for these, and for no others, from now on; its thread starts with the first."""
        with self._lock:
            self._wanted, self._changed = entities, True
            if entities and self._thread is None and not self._closing.is_set():
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()
        self._wake()

    def go_on(self) -> None:
        """Wait for the same again, now that what was ready has been taken."""
        self._go_on.set()

    def close(self) -> None:
        """End the thread and let go of everything."""
        self._closing.set()
        self._wake()
        if self._thread is not None:
            self._thread.join(_END_SECONDS)
        # A handle that anybody keeps, keeps its context with all that belongs to that.
        self._wanted = ()
        self._guard.destroy_when_not_in_use()

    def _wake(self) -> None:
        self._go_on.set()
        # Where somebody else ended the context, there is no guard and no wait.
        with suppress(InvalidHandle), self._guard:
            self._guard.trigger_guard_condition()

    def _run(self) -> None:
        wait_set: WaitSet | None = None
        try:
            while not self._closing.is_set() and self._context.ok():
                # Before the look at what changed: what comes after it ends the rest at once.
                self._go_on.clear()
                with self._lock:
                    entities, changed = self._wanted, self._changed
                    self._changed = False
                try:
                    if changed or wait_set is None:
                        if wait_set is not None:
                            wait_set.close()
                            wait_set = None  # none stands where making another fails
                        wait_set = WaitSet(self._context.handle, self._guard, entities)
                    ready = wait_set.wait(_WAIT_SECONDS)
                except Exception as error:  # noqa: BLE001 - rclpy's, of several kinds
                    if not self._closing.is_set() and self._context.ok():
                        _log.error("waiting for what is seldom ready failed", exc_info=error)
                        self._go_on.wait(_CALM_SECONDS)
                    continue
                rest = self._counter.add(empty=wait_set.ended_early)
                if rest:
                    self._go_on.wait(rest)
                if ready and not self._closing.is_set():
                    self._tell(ready)
                    self._go_on.wait()
        finally:
            if wait_set is not None:
                wait_set.close()
