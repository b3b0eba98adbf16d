"""Nodes behind components: their parameters are set, and they are active while they are used.

What a lifecycle node is asked next is decided without asking it, by `Lifecycle`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import IntEnum
from typing import Any, TypeVar

from attrs import define, evolve, field, frozen

from uoarm.bridge import Channel, Log, on_failure, reading_endpoint
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Endpoint, Health, Message
from uoarm_ros2._discovery import Ros2Graph
from uoarm_ros2._options import Ros2Options, node_of
from uoarm_ros2._parameters import ParameterClient, flattened

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


_LOOK_SECONDS = 1.0
_LINGER_SECONDS = 1.0  # calls follow one another; a takeover closes before it opens
_ASK_SECONDS = 5.0
_CHANGE_SECONDS = 60.0
_GLANCE_SECONDS = 0.02
_WELL = Health.OK, ""
_PRIMARY = ("unconfigured", "inactive", "active", "finalized")
_log = Log("uoarm.ros2")


@frozen
class NodeRequirement:
    """What a component asks of the node behind it.

    Attributes:
        node: its full name.
        activate: whether it is to be active while something of the component is open.
        keep: whether it is activated again when another client deactivates it.
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
        listen: calls a function when a node reports a change; returns a function that ends that.
        report: takes changes of a component's health: the health, the cause, the component.
    """

    ask: Callable[[str, str, Message, float], Any]
    serves: Callable[[str], bool]
    listen: Callable[[str, Callable[[], None]], Callable[[], None]]
    report: Callable[[Health, str, str], None]


@define(eq=False)
class NodeLease:
    """A component's need of its node, until its channel is closed or the lease is released."""

    component: str
    requirement: NodeRequirement
    channel: Channel | None = None
    is_released: bool = False

    @property
    def is_over(self) -> bool:
        """Whether the node is not needed any more for this."""
        # One that is being closed needs it still, for its stop message.
        return self.is_released or (self.channel is not None and not self.channel.is_in_use)


class ManagedNode:
    """One node that components stand on; thread safe.

    A thread of its own looks after it while it is needed: a lifecycle node is asked for its state
    every second, and as soon as it reports a change. All calls of the node take turns.
    """

    def __init__(self, name: str, access: NodeAccess) -> None:
        self._name = name
        self._access = access
        self._turn = threading.Lock()  # one caller at a time asks or changes the node
        self._lifecycle = Lifecycle()
        self._parameters = ParameterClient(name, self._ask)
        self._reported: dict[str, tuple[Health, str]] = {}
        self._fulfilled: dict[str, NodeRequirement] = {}
        # Guards leases, `_due`, `_closing` and `_is_watched`, and wakes the watching thread. Never
        # held while the node is asked, so that `tick` and `hint` do not block the runner's thread.
        # Taken within `_turn`, never the other way round.
        self._changed = threading.Condition()
        self._leases: list[NodeLease] = []
        self._idle_since = 0.0
        self._due = False
        self._closing = False
        self._is_watched = False
        self._thread: threading.Thread | None = None

    def serves(self, service: str) -> bool:
        """Whether the node is there and has a service of this name of its own."""
        return self._access.serves(f"{self._name}/{service}")

    def acquire(self, component: str, requirement: NodeRequirement) -> NodeLease:
        """Have parameters set and the node active, where that is required, until the lease is over.

        Raises:
            BridgeError: a parameter does not fit, another component that is open has other
                values, or the node refuses or cannot be activated.
        """
        lease = NodeLease(component, requirement)
        with self._turn:
            if self._closing:
                raise BridgeError(f"node {self._name}: the bridge is closed", FailureReason.CLOSED)
            leases = [item for item in self._leases if not item.is_over]
            self._require_same_parameters(lease, leases)
            is_first = component not in {item.component for item in leases}
            is_fulfilled = self._is_fulfilled(lease, is_in_use=bool(leases))
            with self._changed:
                self._leases.append(lease)
            if not is_fulfilled:
                self._fulfil(lease)
            # What was reported in one call of a service stands until the next one.
            if is_first and self._reported.pop(component, _WELL)[0] is not Health.OK:
                self._access.report(Health.OK, f"node {self._name} is as required", component)
        return lease

    def release(self, lease: NodeLease) -> None:
        """End a lease."""
        lease.is_released = True
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
            needed = [lease for lease in self._leases if not lease.is_over]
            if len(needed) != len(self._leases) and not needed:
                self._idle_since = time.monotonic()
                self._due = True
                self._changed.notify_all()
            self._leases = needed

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

    def _is_fulfilled(self, lease: NodeLease, *, is_in_use: bool) -> bool:
        """Whether the same was required a moment ago, so that the node is not asked again."""
        is_fresh = is_in_use or time.monotonic() - self._idle_since < _LINGER_SECONDS
        is_active = self._is_watched and self._lifecycle.state == "active"
        same = self._fulfilled.get(lease.component) == lease.requirement
        return same and is_fresh and (is_active or not lease.requirement.activate)

    def _fulfil(self, lease: NodeLease) -> None:
        self._fulfilled.pop(lease.component, None)
        try:
            with on_failure(self.release, lease):
                self._bring_up(lease.requirement)
        finally:
            self._start_watching()
        self._fulfilled[lease.component] = lease.requirement

    def _require_same_parameters(self, lease: NodeLease, leases: list[NodeLease]) -> None:
        for other in leases:
            theirs, ours = other.requirement.parameters, lease.requirement.parameters
            differing = next((n for n in ours if n in theirs and theirs[n] != ours[n]), None)
            if differing is not None and other.component != lease.component:
                text = (
                    f"parameter {differing} of node {self._name} would be {ours[differing]!r} for "
                    f"{lease.component}, and is {theirs[differing]!r} for {other.component}, "
                    "which is in use"
                )
                raise BridgeError(text, FailureReason.REFUSED)

    def _bring_up(self, requirement: NodeRequirement) -> None:
        unset, lifecycle = dict(requirement.parameters), self._lifecycle
        if requirement.activate:
            lifecycle.want(keep=requirement.keep, afterwards=requirement.afterwards)
            lifecycle.saw(self._settled_state())
        declared_later = requirement.activate and lifecycle.next() is Transition.CONFIGURE
        if unset:
            unset = self._parameters.set(unset, some_are_unknown=declared_later)
        while requirement.activate and (transition := lifecycle.next()) is not None:
            if unset and transition is Transition.ACTIVATE:
                unset = self._parameters.set(unset)
            self._change(transition)
        if requirement.activate and lifecycle.health() is not Health.OK:
            raise BridgeError(self._state_text(), FailureReason.UNAVAILABLE)

    def _change(self, transition: Transition) -> None:
        """Ask for a transition and wait for the state that it leads to.

        A node in rclpy ends when it is asked for what does not fit its state: all that is asked
        follows from a state that was just reported.
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

    def _start_watching(self) -> None:
        """Have a thread look after the node, unless one does or there is nothing to look at."""
        with self._changed:
            self._due = True
            if not self._is_watched and self.serves("get_state"):
                stop = self._access.listen(f"{self._name}/transition_event", self.hint)
                name = f"ros2 {self._name}"
                thread = threading.Thread(target=self._watch, args=(stop,), name=name, daemon=True)
                with on_failure(stop):  # the system gives no more threads
                    thread.start()
                self._is_watched, self._thread = True, thread

    def _watch(self, stop: Callable[[], None]) -> None:
        while self._is_needed(stop):
            with self._changed:
                self._changed.wait_for(lambda: self._due or self._closing, _LOOK_SECONDS)
                self._due = False

    def _is_needed(self, stop: Callable[[], None]) -> bool:
        """Look at the node; where nothing holds it any more, leave it and say so.

        Joining the thread that took the last turn waits for all turns before it, too.
        """
        with self._turn:
            try:
                if self._leases and not self._closing:
                    self._look()
            except BridgeTimeoutError:
                pass  # it is busy: a node that says nothing has not left
            except BridgeError as error:
                self._report(Health.LOST, str(error))
            with self._changed:
                lingers = time.monotonic() - self._idle_since < _LINGER_SECONDS
                if not self._closing and (self._leases or lingers):
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
        self._report_state()
        while (transition := lifecycle.next()) is not None:
            self._change(transition)
            self._report_state()

    def _leave(self) -> None:
        """Bring the node back to where it was found, as far as that is required."""
        lifecycle = self._lifecycle
        lifecycle.release()
        try:
            if not self._closing and not self.serves("get_state"):
                return  # it went, which was reported
            if lifecycle.next() is not None:  # it was ours when last seen
                lifecycle.saw(self.state())
            while (transition := lifecycle.next()) is not None:
                self._change(transition)
        except BridgeError as error:
            _log.warning("lifecycle node %s is left as it is: %s", self._name, error)

    def _report_state(self) -> None:
        lifecycle = self._lifecycle
        if lifecycle.state in _PRIMARY or lifecycle.health() is Health.LOST:
            self._report(lifecycle.health(), self._state_text())

    def _state_text(self) -> str:
        why = f" ({self._lifecycle.why_not})" if self._lifecycle.why_not else ""
        return f"lifecycle node {self._name} is {self._lifecycle.state}{why}"

    def _report(self, health: Health, cause: str) -> None:
        for component in {lease.component for lease in list(self._leases) if not lease.is_over}:
            before = self._reported.get(component, _WELL)
            if before == (health, cause) or health is before[0] is Health.OK:
                continue
            self._reported[component] = health, cause
            self._access.report(health, cause, component)


Open = TypeVar("Open", bound=Channel)


@frozen
class LeasedNode:
    """A node as its component wants it; `options` say how to open something at it."""

    options: Ros2Options
    _lease: NodeLease | None

    def until_closed(self, channel: Open) -> Open:
        """Have the node stay so until a channel is closed; returns the channel."""
        if self._lease is not None:
            self._lease.channel = channel
        return channel


class ManagedNodes:
    """All nodes that components of one bridge stand on; thread safe.

    Args:
        resolve: makes a full name of one that may be relative.
    """

    def __init__(self, access: NodeAccess, graph: Ros2Graph, resolve: Callable[[str], str]) -> None:
        self._access = access
        self._graph = graph
        self._resolve = resolve
        self._lock = threading.Lock()  # two components of one node get the same ManagedNode
        self._nodes: dict[str, ManagedNode] = {}

    def described(self, endpoint: Endpoint, options: Ros2Options) -> Ros2Options:
        """Return the settings with which an endpoint is described, once its node is there.

        The topics of a node that is not configured yet are not on the graph.

        Raises:
            BridgeError: the node is not there, or is a lifecycle node that has ended.
        """
        requirement = self._requirement(endpoint, options)
        if requirement is None:
            return options
        node = self._found(requirement, options)
        if not requirement.activate:
            return options
        state = node.state()
        if state == "finalized":
            text = (
                f"lifecycle node {requirement.node} is finalized, which only a restart of it ends"
            )
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if state == "unconfigured" and len(endpoint.address) == 1:
            text = (
                f"lifecycle node {requirement.node} is unconfigured and shows no topics yet: "
                f"name the type of {endpoint.address[0]} in the address"
            )
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return options if state == "active" else evolve(options, peer="optional")

    @contextmanager
    def leased(self, endpoint: Endpoint, options: Ros2Options) -> Iterator[LeasedNode]:
        """Have the node as its component wants it for the length of a block, or longer.

        Raises:
            BridgeError: the node is not there, refuses, or cannot be activated.
        """
        requirement = self._requirement(endpoint, options)
        if requirement is None:
            yield LeasedNode(options, None)
            return
        node = self._found(requirement, options)
        lease = node.acquire(endpoint.component, requirement)
        if requirement.activate:  # what it makes as it is configured is seen a moment later
            options = evolve(options, wait=self._graph.limit(options))
        try:
            yield LeasedNode(options, lease)
        finally:
            if lease.channel is None:
                node.release(lease)

    def tick(self) -> None:
        """Take note of what was closed; never blocks."""
        for node in list(self._nodes.values()):
            node.tick()

    def close(self, seconds: float) -> None:
        """Leave all nodes as they were found, within so many seconds as far as they let."""
        deadline = time.monotonic() + seconds
        nodes = list(self._nodes.values())
        for node in nodes:
            node.begin_closing()
        for node in nodes:
            node.join(max(0.0, deadline - time.monotonic()))

    def _requirement(self, endpoint: Endpoint, options: Ros2Options) -> NodeRequirement | None:
        with reading_endpoint(endpoint):
            name = node_of(endpoint, options)
            if not name:
                return None
            parameters = flattened(endpoint.parameters)
        return NodeRequirement(
            self._resolve(name),
            bool(options.activate),
            options.activate == "keep",
            options.afterwards,
            parameters,
        )

    def _found(self, requirement: NodeRequirement, options: Ros2Options) -> ManagedNode:
        """Return a node once it has the services that are needed."""
        with self._lock:
            node = self._nodes.setdefault(
                requirement.node, ManagedNode(requirement.node, self._access)
            )
        needed = ["get_state"] if requirement.activate else []
        needed += ["set_parameters_atomically"] if requirement.parameters else []
        missing: list[str] = []

        def there() -> bool:
            missing[:] = [word for word in needed if not node.serves(word)]
            return not missing

        if not self._graph.settled(f"node {requirement.node}", there, options):
            services = (name.rpartition("/") for name in self._graph.servers_named())
            nodes = {node for node, _, service in services if service == missing[0]}
            what = f"there is no node {requirement.node} with a service {missing[0]}"
            text = self._graph.absence(what, requirement.node, nodes)
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return node
