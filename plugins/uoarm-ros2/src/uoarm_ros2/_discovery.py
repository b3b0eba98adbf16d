"""The graph of ROS 2: its nodes as components with endpoints, and its topics, services and types.

What is missing is waited for while the graph forms; errors say what is missing, and what is near.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable
from typing import Any

from attrs import define, field, frozen

from uoarm.bridge import Description, Discovered, did_you_mean
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Endpoint, Health, MessageStructure, Role
from uoarm_ros2._middleware import NodeRunner, Peer, rclpy_errors
from uoarm_ros2._options import Ros2Address, Ros2Options
from uoarm_ros2._types import (
    ACTION,
    MESSAGE,
    describe_action,
    describe_service,
    kind_of,
    of_type,
    type_mistake,
)

_HIDDEN = "/_action/"
_OF_EVERY_NODE = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
_FEEDBACK = "/_action/feedback"
_EVERYWHERE = {"/parameter_events", "/rosout"}


@frozen
class _Node:
    """The public topics, services and actions of one node: (name, type) each."""

    publishes: tuple[tuple[str, str], ...]
    subscribes: tuple[tuple[str, str], ...]
    serves: tuple[tuple[str, str], ...]
    acts: tuple[tuple[str, str], ...]


def discovered(
    bridge: str,
    node: Any,
    own: frozenset[str],
    structure: Callable[[str, str], MessageStructure],
) -> tuple[Discovered, ...]:
    """Return every node that is not our own as a component.

    `structure` is given a message type and a topic that carries it. Endpoints whose type is not
    known have no structures; `detail` says why, once for all types of a package.
    """
    found = []
    with rclpy_errors("looking for nodes"):
        names = sorted(set(node.get_node_names_and_namespaces()))
    for name, namespace in names:
        full = f"{namespace.rstrip('/')}/{name}"
        if full in own:
            continue
        try:
            seen = _look(node, name, namespace)
        except Exception:  # noqa: BLE001, S112 - rclpy's NodeNameNonExistentError: it has just left
            continue
        found.append(_component(bridge, full, seen, structure))
    return tuple(found)


def _look(node: Any, name: str, namespace: str) -> _Node:
    publishes = node.get_publisher_names_and_types_by_node(name, namespace)
    subscribes = node.get_subscriber_names_and_types_by_node(name, namespace)
    serves = node.get_service_names_and_types_by_node(name, namespace)
    actions = [
        (topic.removesuffix(_FEEDBACK), [kind.removesuffix("_FeedbackMessage") for kind in kinds])
        for topic, kinds in publishes
        if topic.endswith(_FEEDBACK)
    ]
    return _Node(_pairs(publishes), _pairs(subscribes), _pairs(serves), _pairs(actions))


def _pairs(listing: Iterable[tuple[str, list[str]]]) -> tuple[tuple[str, str], ...]:
    return tuple(
        (name, kind)
        for name, kinds in listing
        for kind in kinds
        if _HIDDEN not in name and name not in _EVERYWHERE and not kind.startswith(_OF_EVERY_NODE)
    )


def _component(
    bridge: str, name: str, seen: _Node, structure: Callable[[str, str], MessageStructure]
) -> Discovered:
    endpoints: list[tuple[Endpoint, Description]] = []
    missing: dict[str, None] = {}
    for role, addresses in (
        (Role.OUTPUT, seen.publishes),
        (Role.INPUT, seen.subscribes),
        (Role.SERVICE, seen.serves),
        (Role.SERVICE, seen.acts),
    ):
        for address in addresses:
            try:
                description = _description(*address, structure)
            except BridgeError as error:
                description = Description()
                # Without the type: its port has that, and one package lacks many of them.
                reason = str(error).removeprefix(of_type(address[1]))
                missing.update(dict.fromkeys(reason.split("; ")))
            port = address[0].strip("/").replace("/", "_")
            endpoints.append((Endpoint(bridge, name, role, address, port=port), description))
    return Discovered(name, tuple(endpoints), "; ".join(missing))


def _description(
    name: str, type_name: str, structure: Callable[[str, str], MessageStructure]
) -> Description:
    """Return the structures behind a name.

    Raises:
        BridgeError: the type is not known, or none of ROS, as a program on bare DDS may have.
    """
    if mistake := type_mistake(type_name):
        raise BridgeError(mistake, FailureReason.UNSUPPORTED)
    if kind_of(type_name) == MESSAGE:
        return Description(message=structure(type_name, name))
    return (describe_action if kind_of(type_name) == ACTION else describe_service)(type_name)


@define(eq=False)
class NodePresence:
    """Which nodes are on the graph, compared with the last look."""

    _node: Any
    _own: Callable[[], frozenset[str]]
    _report: Callable[[Health, str, str], None]
    _present: set[str] | None = field(default=None, init=False)

    def tick(self) -> None:
        """Report the nodes that came or went since the last look; the first look reports none."""
        now = set(self._node.get_fully_qualified_node_names()) - self._own()
        before, self._present = self._present, now
        if before is None:
            return
        for name in sorted(before - now):
            self._report(Health.LOST, f"node {name} left the graph", name)
        for name in sorted(now - before):
            self._report(Health.OK, f"node {name} appeared on the graph", name)


_GLANCE_SECONDS = 0.004
_GRACE_SECONDS = 0.5
_FRESH_SECONDS = 0.5
_NEWCOMER_SECONDS = 1.0
_TYPES_SECONDS = 1.0
_EVERY_NODE_PUBLISHES = "/parameter_events"
_MOST_PARTICIPANTS = 10_000


@frozen
class Topic:
    """A topic with the type that was settled for it.

    `others` says which other types live on the same name, empty when none do.
    """

    name: str
    type: str
    others: str = ""


class ServerPresence:
    """Whether one of the servers that were seen first is still there.

    A server that was killed and started again is matched before the first one is forgotten, so that
    there is one all the time. Where the middleware does not name servers, all count as present.
    """

    def __init__(self) -> None:
        self._first: frozenset[bytes] = frozenset()

    def holds(self, now: frozenset[bytes]) -> bool:
        """Compare the first servers with those that `Ros2Graph.servers` returned now."""
        self._first = self._first or now
        return not self._first or not self._first.isdisjoint(now)


class Ros2Graph:
    """A node's view of the graph, which counts as formed `wait` seconds after its start.

    From then on what is missing is waited for half a second: a peer that has just started.
    """

    def __init__(self, runner: NodeRunner, wait: float) -> None:
        self._runner = runner
        self._wait = wait
        self._formed_at = time.monotonic() + wait
        self._seen_since: dict[bytes, float] = {}
        self._types: dict[str, list[str]] = {}
        self._types_due = 0.0

    def limit(self, options: Ros2Options) -> float:
        """Return how many seconds an opening channel waits for its other end."""
        return self._wait if options.wait is None else options.wait

    def until(self, ready: Callable[[], bool], limit: float) -> bool:
        """Wait for a condition no longer than `limit` seconds; whether it came true."""
        deadline = time.monotonic() + limit
        while not ready():
            if time.monotonic() >= deadline:
                return False
            time.sleep(_GLANCE_SECONDS)
        return True

    def wait_until_formed(self) -> None:
        """Wait until the graph counts as formed, half a second at least."""
        time.sleep(max(_GRACE_SECONDS, self._formed_at - time.monotonic()))

    def tick(self) -> None:
        """Take note of the participants that are there, and of the types of all topics."""
        self._first_seen(self._runner.publishers(_EVERY_NODE_PUBLISHES))
        now = time.monotonic()
        if now >= self._types_due:
            self._types_due = now + _TYPES_SECONDS
            self._types = self._runner.topics()

    def has_other_types(self, topic: Topic) -> bool:
        """Whether a topic carried other types, too, at the last look, a second ago at most."""
        return any(kind != topic.type for kind in self._types.get(topic.name, ()))

    def other_types(self, topic: Topic) -> str:
        """Return the other types that a topic carries now, with their nodes; empty: none."""
        types = _types(self._runner.ends(topic.name))
        return _listed({kind: nodes for kind, nodes in types.items() if kind != topic.type})

    def settle(self, peers: Iterable[Peer], seconds: float, given_up: Callable[[], bool]) -> None:
        """Give matched peers the time to match us in turn, which DDS does not report.

        Those that we have known for a while need next to none: under a millisecond as measured.
        Discovery of a participant goes both ways in turn, so newcomers get half a second.
        """
        seen_since = self._first_seen(peers)
        fresh = max((_FRESH_SECONDS - (time.monotonic() - at) for at in seen_since), default=0.0)
        self.until(given_up, max(seconds, fresh))

    def await_match(self, service: str, seconds: float) -> None:
        """Give servers that are newcomers the time to match us, no longer than `seconds`.

        A server that has not matched the client's reader yet drops the reply, for good.
        """
        now = time.monotonic()
        seen_since = self._first_seen(self._runner.servers(service))
        fresh = max((_NEWCOMER_SECONDS - (now - at) for at in seen_since), default=0.0)
        time.sleep(max(0.0, min(seconds, fresh)))

    def servers(self, service: str) -> frozenset[bytes]:
        """Return the identities of the servers of a full name that are there now."""
        return frozenset(peer.identity for peer in self._runner.servers(service))

    def _first_seen(self, peers: Iterable[Peer]) -> list[float]:
        if len(self._seen_since) > _MOST_PARTICIPANTS:
            self._seen_since.clear()
        now = time.monotonic()
        return [self._seen_since.setdefault(peer.participant, now) for peer in peers]

    def topic(self, address: Ros2Address, role: Role, options: Ros2Options) -> Topic:
        """Settle a topic's type and see that its other end is there, as far as required.

        Raises:
            BridgeError: no such topic, no peer, another type, or two types and no choice.
        """
        name = self._runner.topic_name(address.name)
        sides = self._runner.publishers, self._runner.subscriptions
        look, look_beside = sides if role is Role.OUTPUT else reversed(sides)
        wanted = address.type
        needed = options.peer_required or not wanted
        peers: tuple[Peer, ...] = ()

        def there() -> bool:
            nonlocal peers
            peers = look(name)
            return any(not wanted or peer.type == wanted for peer in peers)

        if not there() and needed and not self.until(there, self._patience(options)):
            raise self._missing_peer(name, wanted, role, peers, look_beside(name))
        beside = look_beside(name)
        types = _types((*peers, *beside) if role is Role.OUTPUT else (*beside, *peers))
        if not wanted and len(types) > 1:
            text = f"topic {name} carries several types: {_listed(types)}; name one in the address"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        chosen = wanted or next(iter(types))
        others = {kind: nodes for kind, nodes in types.items() if kind != chosen}
        return Topic(name, chosen, _listed(others))

    def service(self, address: Ros2Address, *, action: bool) -> tuple[str, str]:
        """Return the full name and the type of a service or action on the graph.

        Raises:
            BridgeError: the graph shows another type, or no type and none is in the address.
        """
        name = self._runner.service_name(address.name)
        what = "action" if action else "service"
        listing = self._runner.actions if action else self._runner.services
        types = listing().get(name, [])
        if address.type and types and address.type not in types:
            text = f"{what} {name} has type {', '.join(types)}, not {address.type}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        if not address.type and len(types) != 1:
            seen = f"{what} {name} has several types: {', '.join(types)}"
            if not types:
                seen = self.absence(f"{what} {name} has no server", name, self.servers_named())
            text = f"{seen}; name its type in the address"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return name, address.type or types[0]

    def settled(
        self, what: str, found: Callable[[], bool], options: Ros2Options, at_most: float = math.inf
    ) -> bool:
        """Wait for something that describing needs, only while the graph still forms.

        Raises:
            BridgeTimeoutError: `at_most` seconds were too short to know that it is not there.
        """
        patience = self._patience(options)
        if self.until(found, min(at_most, patience)):
            return True
        if at_most < patience:
            text = f"{what} was not seen within {at_most:g} s, too short to know that there is none"
            raise BridgeTimeoutError(text)
        return False

    def absence(self, what: str, name: str, known: Collection[str]) -> str:
        """Say that a name is not on the graph, which is near it, and where to look.

        Args:
            what: the sentence up to the graph: `topic /x is not`.
            name: the full name that is asked for.
            known: names of the same kind that are there.
        """
        meant = self._other_kind(name, known) or did_you_mean(name, known)
        domain = self._runner.domain_id
        return f"{what} on the graph of domain {domain}{meant}; `uoarm discover` lists what is"

    def _other_kind(self, name: str, known: Collection[str]) -> str:
        """Say that something of another kind has a name, with its type; empty: nothing has it."""
        if name in known:
            return ""
        listings = {
            "a topic": self._runner.topics,
            "a service": self._runner.services,
            "an action": self._runner.actions,
        }
        for kind, listing in listings.items():
            if types := listing().get(name):
                return f"; there is {kind} of that name, of type {', '.join(types)}"
        return ""

    def servers_named(self) -> list[str]:
        """Return the names of all services and actions on the graph."""
        return [*self._runner.services(), *self._runner.actions()]

    def _patience(self, options: Ros2Options) -> float:
        if options.wait is not None:
            return options.wait
        return max(_GRACE_SECONDS, self._formed_at - time.monotonic())

    def _missing_peer(
        self,
        name: str,
        wanted: str,
        role: Role,
        peers: tuple[Peer, ...],
        beside: tuple[Peer, ...],
    ) -> BridgeError:
        who, others = "publisher", "subscriptions"
        if role is Role.INPUT:
            who, others = "subscription", "publishers"
        if peers:
            text = f"topic {name} has no {who} of type {wanted}, but {_listed(_types(peers))}"
            return BridgeError(text, FailureReason.UNAVAILABLE)
        topics = self._runner.topics()
        known = name in topics
        text = f"topic {name} has no {who}"
        if not known:
            text = self.absence(f"topic {name} is not", name, topics)
        elif wanted and all(peer.type != wanted for peer in beside):
            text += f" of type {wanted}, and {others} of type {_listed(_types(beside))}"
        if role is Role.INPUT:
            text += "; to publish without a subscription set option peer: optional"
        return BridgeError(text, FailureReason.UNAVAILABLE if known else FailureReason.NOT_FOUND)


def _types(peers: Iterable[Peer]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for peer in peers:
        nodes = found.setdefault(peer.type, [])
        if peer.node not in nodes:
            nodes.append(peer.node)
    return found


def _listed(types: dict[str, list[str]]) -> str:
    return "; ".join(f"{kind} ({', '.join(nodes)})" for kind, nodes in sorted(types.items()))
