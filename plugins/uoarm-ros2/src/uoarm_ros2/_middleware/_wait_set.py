"""What rclpy can wait for, and the wait sets that it stands in.

A wait set of ROS 2 forgets what was not ready each time, so that everything is added again before
each wait. Nothing more is done for an entity that is not ready.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from uoarm_ros2._middleware._native import take_with_writer

_CLOCK_SECONDS = 0.0001  # by which the middleware's clock may differ from ours
_KINDS = ("subscription", "client", "service")


class Entity(ABC):
    """Something that a wait set waits for.

    Attributes:
        kind: how wait sets call it; empty for what joins and looks by itself.
        at_once: how often `take` may be called after one wait.
        handle: rclpy's handle, which no other thread frees while a wait set holds it.
        removed: set when it is taken out; nothing is taken from it any more.
        is_quiet: whether it is waited for apart, as it is seldom ready.
    """

    kind = ""
    at_once = 32
    is_quiet = False

    def __init__(self, handle: Any) -> None:
        self.handle = handle
        self.removed = False

    @abstractmethod
    def take(self) -> bool:
        """Take one message and hand it on; False: there was none."""


class SubscriptionEntity(Entity):
    """A subscription; messages go to `deliver`, serialised as they are.

    With `names_writers` the identity of the publisher goes with them.

    Attributes:
        active_at: when it last had a message, or began to.
    """

    kind = "subscription"

    def __init__(
        self, handle: Any, native: type, deliver: Callable[..., None], *, names_writers: bool
    ) -> None:
        super().__init__(handle)
        self._names_writers = names_writers
        self._native = native
        self._deliver = deliver
        self.active_at = time.monotonic()

    def take(self) -> bool:
        """Deliver one message, if there is one."""
        if self._names_writers:
            named = take_with_writer(self.handle)
            if named is not None:
                self._deliver(*named)
            return named is not None
        taken = self.handle.take_message(self._native, True)
        if taken is None:
            return False
        self._deliver(taken[0])
        return True


class ReplyEntity(Entity):
    """A client of a service; replies end its pending requests."""

    kind = "client"

    def __init__(self, client: Any) -> None:
        super().__init__(client.handle)
        self._client = client

    def take(self) -> bool:
        """Give a pending request its reply; one that was given up is thrown away."""
        header, reply = self.handle.take_response(self._client.srv_type.Response)
        if header is None:
            return False
        try:
            future = self._client.get_pending_request(header.request_id.sequence_number)
        except KeyError:
            return True
        future.set_result(reply)
        return True


class RequestEntity(Entity):
    """A server of a service; `answer` takes each request and a function for its reply."""

    kind = "service"

    def __init__(self, service: Any, answer: Callable[[Any, Callable[[Any], None]], None]) -> None:
        super().__init__(service.handle)
        self._service = service
        self._answer = answer

    def take(self) -> bool:
        """Hand on one request, if there is one."""
        request, header = self.handle.service_take_request(self._service.srv_type.Request)
        if header is None:
            return False
        self._answer(request, lambda reply: self._service.send_response(reply, header))
        return True


class EventEntity(Entity):
    """An event of a publisher or a subscription, such as a peer that was matched.

    One of a subscription is as quiet as it is: Fast DDS ends a wait for its events with a message.
    """

    kind = "event"
    at_once = 1

    def __init__(
        self, handle: Any, notify: Callable[[Any], None], of: SubscriptionEntity | None = None
    ) -> None:
        super().__init__(handle)
        self._notify = notify
        self._of = of

    @property
    def is_quiet(self) -> bool:  # type: ignore[override]  # set for a subscription, followed here
        """Whether it is one of a publisher, or of a quiet subscription."""
        return self._of is None or self._of.is_quiet

    def take(self) -> bool:
        """Hand on what happened since the last time, as one event."""
        info = self.handle.take_event()
        if info:
            self._notify(info)
        return bool(info)


class WaitableEntity(Entity):
    """An action's client, which is several entities under one name."""

    at_once = 1  # what it takes is what the last wait found

    def take(self) -> bool:
        """Hand on what the last look found ready."""
        with suppress(StopIteration):  # as coroutines end that wait for nothing
            self.handle.execute(self.handle.take_data()).send(None)
        return True


class WaitSet:
    """One wait set of ROS 2, for as long as the same entities stand in it.

    It keeps their handles from being freed until `close`; an entity that is gone is left out.

    Attributes:
        ended_early: whether the last wait ended before its time, not by the guard, and found
            nothing ready: what ended it is still there, and would end the next wait, too.
    """

    def __init__(self, context: Any, guard: Any, entities: Iterable[Entity]) -> None:
        self.ended_early = False
        self._held: list[Any] = []  # no ExitStack, which takes longer than all else here
        self._guard = guard
        self._by_kind: dict[str, list[Entity]] = {"": [], "event": [], **{k: [] for k in _KINDS}}
        for entity in entities:
            try:
                self._hold(entity.handle)
            except InvalidHandle:
                continue
            self._by_kind[entity.kind].append(entity)
        self._by_pointer = {
            (kind, entity.handle.pointer): entity
            for kind in _KINDS
            for entity in self._by_kind[kind]
        }
        subscriptions, clients, services = (len(self._by_kind[kind]) for kind in _KINDS)
        guards, timers, events = 1, 0, len(self._by_kind["event"])
        for entity in self._by_kind[""]:
            more = entity.handle.get_num_entities()
            subscriptions += more.num_subscriptions
            guards += more.num_guard_conditions
            timers += more.num_timers
            clients += more.num_clients
            services += more.num_services
            events += more.num_events
        self._hold(context)
        self._wait_set = _rclpy.WaitSet(
            subscriptions, guards, timers, clients, services, events, context
        )
        add = self._wait_set
        # As flat as can be: they are gone through in every turn.
        self._adders: list[tuple[Callable[[Any], Any], Any]] = [
            (join, entity.handle)
            for kind, join in (
                ("subscription", add.add_subscription),
                ("client", add.add_client),
                ("service", add.add_service),
                ("event", add.add_event),
            )
            for entity in self._by_kind[kind]
        ]
        self._events, self._joining = self._by_kind["event"], self._by_kind[""]
        self._kinds = [kind for kind in _KINDS if self._by_kind[kind]]

    def wait(self, seconds: float) -> list[Entity]:
        """Return what is ready, as soon as something is; empty when the time is over.

        Events come first: a publisher is matched before its first message.
        """
        wait_set = self._wait_set
        wait_set.clear_entities()
        guard = wait_set.add_guard_condition(self._guard)
        for add, handle in self._adders:
            add(handle)
        for entity in self._joining:
            entity.handle.add_to_wait_set(wait_set)
        until = time.monotonic() + seconds - _CLOCK_SECONDS
        wait_set.wait(round(seconds * 1e9))
        ready: list[Entity] = []
        for place, entity in enumerate(self._events):
            if wait_set.is_ready("event", place):
                ready.append(entity)
        if self._joining:
            ready += [entity for entity in self._joining if entity.handle.is_ready(wait_set)]
        for kind in self._kinds:
            for pointer in wait_set.get_ready_entities(kind):
                found = self._by_pointer.get((kind, pointer))
                if found is not None:
                    ready.append(found)
        self.ended_early = (
            not ready
            and time.monotonic() < until
            and not wait_set.is_ready("guard_condition", guard)
        )
        return ready

    def close(self) -> None:
        """Let go of all entities; those that were destroyed meanwhile are freed here."""
        self._wait_set.destroy_when_not_in_use()
        while self._held:
            self._held.pop().__exit__(None, None, None)

    def _hold(self, handle: Any) -> None:
        handle.__enter__()
        self._held.append(handle)
