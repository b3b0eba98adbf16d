"""One node of rclpy with a thread of its own."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

from rclpy.action import ActionClient
from rclpy.action.graph import get_action_names_and_types
from rclpy.event_handler import (
    PublisherEventCallbacks,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from uoarm_ros2._middleware._executor import new_executor
from uoarm_ros2._middleware._peer import Peer, read_peer
from uoarm_ros2._middleware._profile import new_profile
from uoarm_ros2._qos import Policies

__all__ = ["Station"]

_SPIN_SECONDS = 0.2
_PERFORM_SECONDS = 2.0
_DISCARD_SECONDS = 0.1
T = TypeVar("T")
_log = logging.getLogger("uoarm.ros2")


class Station:
    """One node, its executor and the thread that spins it.

    `stop` returns within its limit whatever a callback does; the thread itself puts everything
    away when it ends, and `done` is called last. `tick` is called a few times a second, `cut_off`
    once if the context is shut down from outside; both in the thread.
    """

    def __init__(
        self, context: Any, name: str, namespace: str, executor: str, done: Callable[[], None]
    ) -> None:
        self._executor = new_executor(executor, context)
        # The events executor crashes when entities come or go beside it in other threads, and when
        # one goes whose event is still in its queue (it drops Python objects without the lock).
        self._alone = self.without_events = executor != "standard"
        self.node = Node(
            name,
            context=context,
            namespace=namespace or None,
            cli_args=[],
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self.tick: Callable[[], None] = _nothing
        self.cut_off: Callable[[], None] = _nothing
        self._context = context
        self._executor.add_node(self.node)
        self._stopping = False
        self._done = done
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"ros2 {name}", daemon=True)
        self._thread.start()

    def stop(self, limit: float) -> bool:
        """End the thread; whether it ended within `limit` seconds."""
        self._stopping = True
        with suppress(Exception):  # it may have put itself away already
            self._executor.create_task(_nothing)  # work, which ends a spin at once; wake() does not
        return threading.current_thread() is self._thread or self._ended.wait(limit)

    def _run(self) -> None:
        due = time.monotonic() + _SPIN_SECONDS
        try:
            while not self._stopping:
                try:
                    self._executor.spin_once(timeout_sec=_SPIN_SECONDS)
                    if time.monotonic() >= due:
                        due = time.monotonic() + _SPIN_SECONDS
                        self.tick()
                except InvalidHandle:
                    pass  # an entity went between its event and our look at it
                except Exception as error:  # noqa: BLE001 - one failure is nobody else's
                    self._failed(error)
                if not self._context.ok():
                    break
            if not self._stopping:
                self.cut_off()
        finally:
            self._put_away()

    def _failed(self, error: Exception) -> None:
        if not self._stopping and self._context.ok():
            _log.error("a callback of ROS 2 failed", exc_info=error)

    def _put_away(self) -> None:
        try:
            self._executor.remove_node(self.node)
            self.node.destroy_node()
            self._executor.shutdown(timeout_sec=0)
        except Exception:  # noqa: BLE001 - the context must go all the same
            _log.exception("putting away a ROS 2 node failed")
        finally:
            self._done()
            self._ended.set()

    def discard(self, entity: Any) -> None:
        """Destroy a publisher or subscription; does not wait for a thread that is held up."""
        if isinstance(entity, Publisher):
            self._perform(lambda: self.node.destroy_publisher(entity), needed=False)
        else:
            self._perform(lambda: self.node.destroy_subscription(entity), needed=False)

    def _perform(self, action: Callable[[], T], *, needed: bool = True) -> T | None:
        """Create or destroy an entity in the thread in which this executor can bear it."""
        if not self._alone or threading.current_thread() is self._thread:
            return action()
        made: list[T] = []
        failed: list[Exception] = []
        done = threading.Event()

        def perform() -> None:
            try:
                made.append(action())
            except Exception as error:  # noqa: BLE001 - raised again in the caller's thread
                failed.append(error)
            done.set()

        self._executor.create_task(perform)
        if not done.wait(_PERFORM_SECONDS if needed else _DISCARD_SECONDS) and needed:
            raise RuntimeError("the thread of the events executor is held up by a delivery")
        if failed and needed:
            raise failed[0]
        return made[0] if made else None

    def _with_events(
        self,
        create: Callable[..., Any],
        kind: type,
        events: dict[str, Callable[[Any], None]],
    ) -> Any:
        for callbacks in _fewer({} if self.without_events else events):
            with suppress(UnsupportedEventTypeError):
                known = kind(use_default_callbacks=False, **callbacks)
                return self._perform(partial(create, event_callbacks=known))
        raise AssertionError("an end without event callbacks is always supported")

    def subscribe(
        self,
        native: type,
        topic: str,
        policies: Policies,
        take: Callable[[Any], None],
        *,
        raw: bool,
        events: dict[str, Callable[[Any], None]],
    ) -> Any:
        """Create a subscription; events that rmw or executor cannot bear are left out."""
        create = partial(
            self.node.create_subscription, native, topic, take, new_profile(policies), raw=raw
        )
        return self._with_events(create, SubscriptionEventCallbacks, events)

    def advertise(
        self,
        native: type,
        topic: str,
        policies: Policies,
        *,
        events: dict[str, Callable[[Any], None]],
    ) -> Any:
        """Create a publisher; events that rmw or executor cannot bear are left out."""
        create = partial(self.node.create_publisher, native, topic, new_profile(policies))
        return self._with_events(create, PublisherEventCallbacks, events)

    def action_client(self, native: type, name: str) -> Any:
        """Create an action client; its callbacks run in this station's thread."""
        return self._perform(lambda: ActionClient(self.node, native, name))

    def client(self, native: type, name: str) -> Any:
        """Create a service client; its replies arrive in this station's thread."""
        return self._perform(lambda: self.node.create_client(native, name))

    def server(self, native: type, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Create a service whose requests are answered in this station's thread."""
        self._perform(lambda: self.node.create_service(native, name, answer))

    def publishers(self, topic: str) -> tuple[Peer, ...]:
        """Return the publishers of a topic that are on the graph now."""
        return tuple(map(read_peer, self.node.get_publishers_info_by_topic(topic)))

    def subscriptions(self, topic: str) -> tuple[Peer, ...]:
        """Return the subscriptions of a topic that are on the graph now."""
        return tuple(map(read_peer, self.node.get_subscriptions_info_by_topic(topic)))

    def own_definition(self, topic: str, type_name: str) -> str:
        """Return the hash of our definition of a type, as our own end of a topic tells it."""
        node = self.node.get_fully_qualified_name()
        ends = (*self.publishers(topic), *self.subscriptions(topic))
        own = (end for end in ends if (end.node, end.type) == (node, type_name))
        return next((end.definition for end in own), "")

    def has_server(self, service: str) -> bool:
        """Whether a server of this full name is on the graph; clients do not count."""
        return bool(self.node.count_services(service))

    def servers(self, service: str) -> tuple[Peer, ...]:
        """Return the servers of a full name, as their reply topics show them.

        Empty where the middleware names these topics otherwise than DDS does in ROS 2:
        https://design.ros2.org/articles/topic_and_service_names.html
        """
        found = self.node.get_publishers_info_by_topic(f"rr{service}Reply", no_mangle=True)
        return tuple(map(read_peer, found))

    def services(self) -> dict[str, list[str]]:
        """Return the services on the graph now, with their types."""
        return dict(self.node.get_service_names_and_types())

    def actions(self) -> dict[str, list[str]]:
        """Return the actions on the graph now, with their types."""
        return dict(get_action_names_and_types(self.node))


def _nothing() -> None:
    pass


def _fewer(
    events: dict[str, Callable[[Any], None]],
) -> Iterator[dict[str, Callable[[Any], None]]]:
    """Yield the callbacks, then only those that every rmw has, then none."""
    yield events
    yield {name: each for name, each in events.items() if name == "incompatible_qos"}
    yield {}
