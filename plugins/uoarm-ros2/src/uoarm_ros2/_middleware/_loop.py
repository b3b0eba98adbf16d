"""One loop over everything that a node of ours waits for; it takes the place of an executor."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from uoarm.bridge import LimitedLog, TurnCounter, Turns
from uoarm_ros2._middleware._wait_set import (
    Entity,
    EventEntity,
    SubscriptionEntity,
    WaitSet,
)

_WAIT_SECONDS = 10.0
_CALM_SECONDS = 0.5
_END_SECONDS = 2.0


class QuietWatch:
    """Notifies when one of many entities is ready, then rests until it is set to watch again.

    It takes nothing from them: what is ready stays so, and would be notified again and again.

    Args:
        notify: takes what is ready, in this thread; must not block.
    """

    def __init__(self, context: Any, name: str, notify: Callable[[list[Entity]], None]) -> None:
        self._records = LimitedLog(_log)
        self._counter = TurnCounter()
        self._context = context
        self._name = name
        self._notify = notify
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
                thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                thread.start()
                self._thread = thread
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
        # A handle that is kept keeps its context, with all that belongs to that.
        self._wanted = ()
        self._guard.destroy_when_not_in_use()

    def _wake(self) -> None:
        self._go_on.set()
        # Where the context was ended from outside, there is no guard and no wait.
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
                        text = "waiting for what is seldom ready failed"
                        self._records.write(logging.ERROR, text, error)
                        self._go_on.wait(_CALM_SECONDS)
                    continue
                rest = self._counter.add(empty=wait_set.ended_early)
                if rest:
                    self._go_on.wait(rest)
                if ready and not self._closing.is_set():
                    self._notify(ready)
                    self._go_on.wait()
        finally:
            if wait_set is not None:
                wait_set.close()


_EVENT_SECONDS = 0.02
_FEW = 8
_QUIET_SECONDS = 2.0
_SWEEP_SECONDS = 1.0
_SELDOM_SECONDS = 0.0005
_BETWEEN_BUILDS = 3  # times as long as a build took
_log = logging.getLogger("uoarm.ros2")


class WaitLoop:
    """Waits for entities and takes all that is ready; one thread makes every turn.

    Its wait sets are built anew only when entities came or went, once for many that do. Waiting for
    an entity costs a few microseconds in each turn. So of many subscriptions those that had no
    message for a while are quiet: a `QuietWatch` waits for them and their events, until one is
    ready. And the some three events of each of the others are looked at fifty times a second only
    while messages flow, and at once when nothing else happens, or when a wait without them ends
    with nothing: an event that was not taken keeps its subscription's condition set, which ends
    every wait for its messages.

    Args:
        name: of what it belongs to, for threads.
        quiet: whether failures need no report any more, as while everything ends.
    """

    def __init__(self, context: Any, name: str, quiet: Callable[[], bool]) -> None:
        self._records = LimitedLog(_log)
        self._counter = TurnCounter()
        self._context = context
        self._quiet = quiet
        with context.handle:
            self._guard = _rclpy.GuardCondition(context.handle)
        self._lock = threading.Lock()
        self._soon: deque[Callable[[], None]] = deque()
        self._quiet_watch = QuietWatch(context, f"ros2 {name} quiet", self._quiet_ready)
        self._quiet_entities: deque[list[Entity]] = deque()
        self._sweep_due = 0.0
        self._entities: tuple[Entity, ...] = ()
        self._changed = True
        self._build_due = 0.0
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
            self._entities = tuple(item for item in self._entities if not item.removed)
            self._changed = True
        self.wake()

    def wake(self) -> None:
        """End a wait at once; from any thread."""
        # After `close`, as when the context was ended from outside, there is no guard and no wait.
        with suppress(InvalidHandle), self._guard:
            self._guard.trigger_guard_condition()

    def call_soon(self, act: Callable[[], None]) -> None:
        """Have something done in the thread that makes the turns; from any thread."""
        self._soon.append(act)
        self.wake()

    def turn(self, seconds: float) -> bool:
        """Wait no longer than that for anything, and hand on what is there; was there anything?"""
        while self._soon:
            self._soon.popleft()()
        now, worked = time.monotonic(), False
        quiet: list[Entity] = []
        while self._quiet_entities:
            quiet += self._quiet_entities.popleft()
        if quiet:
            worked = self._take_quiet(quiet, now)
        if now >= self._sweep_due:
            self._sweep(now)
        if self._changed and now >= self._build_due:
            self._build()
            # However many come one after the other, it is mostly not building.
            begun, now = now, time.monotonic()
            self._build_due = now + _BETWEEN_BUILDS * (now - begun)
        elif quiet:
            self._quiet_watch.go_on()
        if self._changed:
            seconds = min(seconds, max(0.0, self._build_due - now))
        early = self._events_due - now
        chosen = self._everything if early <= 0 else self._without_events
        assert chosen is not None
        ready = chosen.wait(seconds if early <= 0 else min(seconds, early))
        now = time.monotonic()
        for entity in ready:
            at_once = entity.at_once
            if isinstance(entity, SubscriptionEntity):
                # Of what comes seldom there is one: a look for more costs as much as taking it.
                at_once = 1 if now - entity.active_at > _SELDOM_SECONDS else at_once
                entity.active_at = now
            worked |= self._take(entity, at_once)
        empty = chosen.ended_early or (bool(quiet or ready) and not worked)
        if empty or not ready:
            self._events_due = 0.0
        elif chosen is self._everything:
            self._events_due = now + _EVENT_SECONDS
        rest = self._counter.add(empty=empty, complete=chosen is self._everything)
        if rest:
            time.sleep(rest)
        return worked

    @property
    def turns(self) -> Turns:
        """How often it and its watch over quiet entities have turned, and how often for nothing."""
        ours, quiet = self._counter.turns, self._quiet_watch.turns
        return Turns(ours.all + quiet.all, ours.empty + quiet.empty)

    def close(self) -> None:
        """Let go of everything; in the thread that makes the turns."""
        self._quiet_watch.close()
        for wait_set in (self._everything, self._without_events):
            if wait_set is not None:
                wait_set.close()
        self._everything = self._without_events = None
        self._quiet_entities.clear()
        self._guard.destroy_when_not_in_use()

    def _quiet_ready(self, ready: list[Entity]) -> None:
        """Note that quiet entities have something; in the thread of their watch."""
        self._quiet_entities.append(ready)
        self.wake()

    def _take_quiet(self, quiet: list[Entity], now: float) -> bool:
        """Take what quiet entities have; subscriptions are not quiet any more."""
        for entity in quiet:
            if isinstance(entity, SubscriptionEntity) and entity.is_quiet:
                entity.is_quiet, entity.active_at = False, now
                self._changed = True
        taken = [self._take(entity, entity.at_once) for entity in quiet]
        return any(taken)

    def _sweep(self, now: float) -> None:
        """Have subscriptions without a message for a while waited for apart, where there are many.

        One that comes to be so and has a message again costs two new wait sets.
        """
        self._sweep_due = now + _SWEEP_SECONDS
        loud = [
            entity
            for entity in self._entities
            if isinstance(entity, SubscriptionEntity) and not entity.is_quiet
        ]
        if len(loud) <= _FEW:
            return
        for entity in loud:
            if now - entity.active_at > _QUIET_SECONDS:
                entity.is_quiet = self._changed = True

    def _build(self) -> None:
        with self._lock:
            every, self._changed = self._entities, False
        entities = [entity for entity in every if not entity.is_quiet]
        before = self._everything, self._without_events
        handle, guard = self._context.handle, self._guard
        self._everything = WaitSet(handle, guard, entities)
        quick = [entity for entity in entities if not isinstance(entity, EventEntity)]
        self._without_events = WaitSet(handle, guard, quick)
        for wait_set in before:
            if wait_set is not None:
                wait_set.close()
        try:
            self._quiet_watch.watch([entity for entity in every if entity.is_quiet])
        except RuntimeError:  # the system gives no more threads: it is tried again
            self._changed, self._build_due = True, time.monotonic() + _CALM_SECONDS
            raise

    def _take(self, entity: Entity, most: int) -> bool:
        """Take what an entity has, so much at most, so that the others have their turn.

        Returns whether it had anything, or is waited for no more.
        """
        taken = 0
        try:
            while taken < most and not entity.removed and entity.take():
                taken += 1
        except InvalidHandle:
            pass  # it went between the look and the taking
        except Exception as error:  # noqa: BLE001 - one failure ends no other entity
            if not self._quiet():
                self._records.write(logging.ERROR, "a callback of ROS 2 failed", error)
        return taken > 0 or entity.removed
