"""A node behind components: its parameters are set, and it is active while something is open."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from attrs import define, field, frozen

from uoarm.bridge import Channel
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Health, Message
from uoarm_ros2._lifecycle import Lifecycle, Transition
from uoarm_ros2._parameter_client import ParameterClient

__all__ = ["Hold", "ManagedNode", "NodeAccess", "Wish"]

_LOOK_SECONDS = 1.0
_LINGER_SECONDS = 1.0  # calls follow one another; a takeover closes before it opens
_ASK_SECONDS = 5.0
_CHANGE_SECONDS = 60.0
_GLANCE_SECONDS = 0.02
_PRIMARY = ("unconfigured", "inactive", "active", "finalized")
_log = logging.getLogger("uoarm.ros2")


@frozen
class Wish:
    """What a component asks of the node behind it.

    Attributes:
        node: its full name.
        activate: whether it is to be active while something of the component is open.
        keep: whether it is activated again when somebody else deactivates it.
        afterwards: `deactivate`, `cleanup` or `leave`.
        parameters: to be set before, by full name.
    """

    node: str
    activate: bool = False
    keep: bool = False
    afterwards: str = "deactivate"
    parameters: Mapping[str, object] = field(factory=dict, hash=False)


@frozen
class NodeAccess:
    """How a node is reached.

    Attributes:
        ask: calls a service by full name and type, within so many seconds; raises BridgeError.
        serves: whether a server of a full name is on the graph.
        listen: has something called when a node tells of a change; returns what ends that.
        report: takes changes of a component's health: the health, the cause, the component.
    """

    ask: Callable[[str, str, Message, float], Any]
    serves: Callable[[str], bool]
    listen: Callable[[str, Callable[[], None]], Callable[[], None]]
    report: Callable[[Health, str, str], None]


@define(eq=False)
class Hold:
    """Something of a component that needs the node, until its channel is closed or it is over."""

    component: str
    wish: Wish
    channel: Channel | None = None
    is_released: bool = False

    @property
    def is_over(self) -> bool:
        """Whether the node is not needed any more for this."""
        return self.is_released or (self.channel is not None and self.channel.closed)


class ManagedNode:
    """One node that components stand on; thread safe.

    A thread of its own looks after it while it is needed: a lifecycle node is asked for its state
    every second, and as soon as it tells of a change. All that asks the node takes turns.
    """

    def __init__(self, name: str, access: NodeAccess) -> None:
        self._name = name
        self._access = access
        self._turn = threading.Lock()
        self._lifecycle = Lifecycle()
        self._parameters = ParameterClient(name, self._ask)
        self._told: dict[str, tuple[Health, str]] = {}
        self._fulfilled: dict[str, Wish] = {}
        self._changed = threading.Condition()
        self._holds: list[Hold] = []
        self._idle_since = 0.0
        self._due = False
        self._closing = False
        self._is_watched = False
        self._thread: threading.Thread | None = None

    def serves(self, service: str) -> bool:
        """Whether the node is there and has a service of this name of its own."""
        return self._access.serves(f"{self._name}/{service}")

    def hold(self, component: str, wish: Wish) -> Hold:
        """Have parameters set and the node active, where that is wished, until the hold is over.

        Raises:
            BridgeError: a parameter does not fit, another component that is open has other
                values, or the node refuses or cannot be activated.
        """
        held = Hold(component, wish)
        with self._turn:
            if self._closing:
                raise BridgeError(f"node {self._name}: the bridge is closed", FailureReason.CLOSED)
            others = [item for item in self._holds if not item.is_over]
            self._check_agreement(held, others)
            if component not in {item.component for item in others}:
                self._told.pop(component, None)
            is_as_wished = self._is_as_wished(held, is_in_use=bool(others))
            with self._changed:
                self._holds.append(held)
            if not is_as_wished:
                self._fulfil(held)
        return held

    def release(self, held: Hold) -> None:
        """End a hold."""
        held.is_released = True
        self.tick()

    def state(self) -> str:
        """Ask a lifecycle node for its state.

        Raises:
            BridgeError: it is not there, or does not answer.
        """
        asked = self._ask("get_state", "lifecycle_msgs/srv/GetState", {}, _ASK_SECONDS)
        return str(asked["current_state"]["label"])

    def tick(self) -> None:
        """Take note of what was closed; never blocks."""
        with self._changed:
            needed = [held for held in self._holds if not held.is_over]
            if len(needed) != len(self._holds) and not needed:
                self._idle_since = time.monotonic()
                self._due = True
                self._changed.notify_all()
            self._holds = needed

    def hint(self) -> None:
        """Look at the node's state soon; never blocks."""
        with self._changed:
            self._due = True
            self._changed.notify_all()

    def begin_closing(self) -> None:
        """Leave the node as it was found from now on; never blocks."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def join(self, seconds: float) -> None:
        """Wait no longer than that until the node was left."""
        thread = self._thread
        if thread is not None:
            thread.join(seconds)

    def _is_as_wished(self, held: Hold, *, is_in_use: bool) -> bool:
        """Whether the same was wished a moment ago, so that a call need not ask the node again."""
        is_fresh = is_in_use or time.monotonic() - self._idle_since < _LINGER_SECONDS
        is_active = self._is_watched and self._lifecycle.state == "active"
        same = self._fulfilled.get(held.component) == held.wish
        return same and is_fresh and (is_active or not held.wish.activate)

    def _fulfil(self, held: Hold) -> None:
        self._fulfilled.pop(held.component, None)
        try:
            self._bring_up(held.wish)
        except BaseException:
            self.release(held)
            raise
        finally:
            self._look_after_it()
        self._fulfilled[held.component] = held.wish

    def _check_agreement(self, held: Hold, others: list[Hold]) -> None:
        for other in others:
            theirs, ours = other.wish.parameters, held.wish.parameters
            differs = next((n for n in ours if n in theirs and theirs[n] != ours[n]), None)
            if differs is not None and other.component != held.component:
                text = (
                    f"parameter {differs} of node {self._name} would be {ours[differs]!r} for "
                    f"{held.component}, and is {theirs[differs]!r} for {other.component}, which is "
                    "in use"
                )
                raise BridgeError(text, FailureReason.REFUSED)

    def _bring_up(self, wish: Wish) -> None:
        unset, lifecycle = dict(wish.parameters), self._lifecycle
        if wish.activate:
            lifecycle.want(keep=wish.keep, afterwards=wish.afterwards)
            lifecycle.saw(self._settled_state())
        declared_later = wish.activate and lifecycle.next() is Transition.CONFIGURE
        if unset:
            unset = self._parameters.set(unset, some_are_unknown=declared_later)
        while wish.activate and (transition := lifecycle.next()) is not None:
            if unset and transition is Transition.ACTIVATE:
                unset = self._parameters.set(unset)
            self._change(transition)
        if wish.activate and lifecycle.health() is not Health.OK:
            raise BridgeError(self._state_in_words(), FailureReason.UNAVAILABLE)

    def _change(self, transition: Transition) -> None:
        """Ask for a transition and wait for the state that it leads to.

        A node in rclpy ends when it is asked for what does not fit its state: all that is asked
        follows from a state that was just told.
        """
        request = {"transition": {"id": int(transition), "label": ""}}
        self._ask("change_state", "lifecycle_msgs/srv/ChangeState", request, _CHANGE_SECONDS)
        self._lifecycle.ended(transition, self._settled_state())

    def _settled_state(self) -> str:
        """Return the state once the node is in one that lasts."""
        deadline = time.monotonic() + _CHANGE_SECONDS
        while (state := self.state()) not in _PRIMARY and time.monotonic() < deadline:
            time.sleep(_GLANCE_SECONDS)
        return state

    def _ask(self, service: str, type_name: str, request: Message, seconds: float) -> Any:
        name = f"{self._name}/{service}"
        if not self.serves(service):
            text = f"there is no node {self._name} with a service {service} on the graph"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return self._access.ask(name, type_name, request, seconds)

    def _look_after_it(self) -> None:
        """Have a thread look after the node, unless one does or there is nothing to look at."""
        with self._changed:
            self._due = True
            if not self._is_watched and self.serves("get_state"):
                stop = self._access.listen(f"{self._name}/transition_event", self.hint)
                name = f"ros2 {self._name}"
                self._is_watched = True
                self._thread = threading.Thread(
                    target=self._watch, args=(stop,), name=name, daemon=True
                )
                self._thread.start()

    def _watch(self, stop: Callable[[], None]) -> None:
        while self._is_needed(stop):
            with self._changed:
                self._changed.wait_for(lambda: self._due or self._closing, _LOOK_SECONDS)
                self._due = False

    def _is_needed(self, stop: Callable[[], None]) -> bool:
        """Look at the node; where nothing holds it any more, leave it and say so.

        Whoever joins the thread that took the last turn knows that those before have ended theirs.
        """
        with self._turn:
            try:
                if self._holds and not self._closing:
                    self._look()
            except BridgeTimeoutError:
                pass  # it is busy: a node that says nothing has not left
            except BridgeError as error:
                self._tell(Health.LOST, str(error))
            with self._changed:
                lingers = time.monotonic() - self._idle_since < _LINGER_SECONDS
                if not self._closing and (self._holds or lingers):
                    return True
                # From here on the next hold starts another thread, which takes its turn after us.
                self._is_watched = False
            self._fulfilled.clear()
            self._leave()
            stop()
            return False

    def _look(self) -> None:
        lifecycle = self._lifecycle
        lifecycle.saw(self.state())
        self._tell_state()
        while (transition := lifecycle.next()) is not None:
            self._change(transition)
            self._tell_state()

    def _leave(self) -> None:
        """Bring the node back to where it was found, as far as that is wished."""
        lifecycle = self._lifecycle
        lifecycle.release()
        try:
            if not self._closing and not self.serves("get_state"):
                return  # it went, which was told
            if lifecycle.next() is not None:  # it was ours when last seen
                lifecycle.saw(self.state())
            while (transition := lifecycle.next()) is not None:
                self._change(transition)
        except BridgeError as error:
            _log.warning("lifecycle node %s is left as it is: %s", self._name, error)

    def _tell_state(self) -> None:
        lifecycle = self._lifecycle
        if lifecycle.state in _PRIMARY or lifecycle.health() is Health.LOST:
            self._tell(lifecycle.health(), self._state_in_words())

    def _state_in_words(self) -> str:
        why = f" ({self._lifecycle.why_not})" if self._lifecycle.why_not else ""
        return f"lifecycle node {self._name} is {self._lifecycle.state}{why}"

    def _tell(self, health: Health, cause: str) -> None:
        for component in {held.component for held in list(self._holds) if not held.is_over}:
            before = self._told.get(component, (Health.OK, ""))
            if before == (health, cause) or health is before[0] is Health.OK:
                continue
            self._told[component] = health, cause
            self._access.report(health, cause, component)
