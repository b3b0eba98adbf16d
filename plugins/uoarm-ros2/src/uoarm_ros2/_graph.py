"""What the graph shows, waited for while it forms, and the errors that say what is missing."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from difflib import get_close_matches

from attrs import frozen

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Role
from uoarm_ros2._middleware import Peer, Station
from uoarm_ros2._settings import Address, Settings

__all__ = ["Graph", "Presence", "Topic"]

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


class Presence:
    """Whether one of the servers that were seen first is still there.

    A server that was killed and started again is matched before the first one is forgotten, so that
    there is one all the time. Where the middleware does not tell who serves, all are there.
    """

    def __init__(self) -> None:
        self._first: frozenset[bytes] = frozenset()

    def holds(self, now: frozenset[bytes]) -> bool:
        """Take what `Graph.servers` tells now."""
        self._first = self._first or now
        return not self._first or not self._first.isdisjoint(now)


class Graph:
    """A station's view of the graph, which counts as formed `wait` seconds after its start.

    From then on what is missing is waited for half a second: a peer that has just started.
    """

    def __init__(self, station: Station, wait: float) -> None:
        self._station = station
        self._wait = wait
        self._formed_at = time.monotonic() + wait
        self._met: dict[bytes, float] = {}
        self._types: dict[str, list[str]] = {}
        self._types_due = 0.0

    def limit(self, settings: Settings) -> float:
        """Return how many seconds an opening channel waits for its other end."""
        return self._wait if settings.wait is None else settings.wait

    def until(self, ready: Callable[[], bool], limit: float) -> bool:
        """Wait for a condition no longer than `limit` seconds; whether it came true."""
        deadline = time.monotonic() + limit
        while not ready():
            if time.monotonic() >= deadline:
                return False
            time.sleep(_GLANCE_SECONDS)
        return True

    def tick(self) -> None:
        """Take note of the participants that are there, and of the types of all topics."""
        self._meet(self._station.publishers(_EVERY_NODE_PUBLISHES))
        now = time.monotonic()
        if now >= self._types_due:
            self._types_due = now + _TYPES_SECONDS
            self._types = self._station.topics()

    def has_other_types(self, topic: Topic) -> bool:
        """Whether a topic carried other types, too, at the last look, a second ago at most."""
        return any(kind != topic.type for kind in self._types.get(topic.name, ()))

    def other_types(self, topic: Topic) -> str:
        """Return the other types that a topic carries now, with their nodes; empty: none."""
        types = _types(self._station.ends(topic.name))
        return _listed({kind: nodes for kind, nodes in types.items() if kind != topic.type})

    def settle(self, peers: Iterable[Peer], seconds: float, given_up: Callable[[], bool]) -> None:
        """Give matched peers the time to match us in turn, which DDS does not tell.

        Those that we have known for a while need next to none: under a millisecond as measured.
        Discovery of a participant goes both ways in turn, so newcomers get half a second.
        """
        met = self._meet(peers)
        fresh = max((_FRESH_SECONDS - (time.monotonic() - at) for at in met), default=0.0)
        self.until(given_up, max(seconds, fresh))

    def greet(self, service: str, seconds: float) -> None:
        """Give servers that are newcomers the time to match us, no longer than `seconds`.

        A server that has not matched the client's reader yet drops the reply, for good.
        """
        now = time.monotonic()
        met = self._meet(self._station.servers(service))
        fresh = max((_NEWCOMER_SECONDS - (now - at) for at in met), default=0.0)
        self.until(lambda: False, min(seconds, fresh))

    def servers(self, service: str) -> frozenset[bytes]:
        """Return the identities of the servers of a full name that are there now."""
        return frozenset(peer.identity for peer in self._station.servers(service))

    def _meet(self, peers: Iterable[Peer]) -> list[float]:
        if len(self._met) > _MOST_PARTICIPANTS:
            self._met.clear()
        now = time.monotonic()
        return [self._met.setdefault(peer.participant, now) for peer in peers]

    def topic(self, address: Address, role: Role, settings: Settings) -> Topic:
        """Settle a topic's type and see that its other end is there, as far as required.

        Raises:
            BridgeError: no such topic, no peer, another type, or two types and no choice.
        """
        name = self._station.topic_name(address.name)
        sides = self._station.publishers, self._station.subscriptions
        look, look_beside = sides if role is Role.OUTPUT else reversed(sides)
        wanted = address.type
        needed = settings.peer_required or not wanted
        peers: tuple[Peer, ...] = ()

        def there() -> bool:
            nonlocal peers
            peers = look(name)
            return any(not wanted or peer.type == wanted for peer in peers)

        if not there() and needed and not self.until(there, self._patience(settings)):
            raise self._nobody(name, wanted, role, peers)
        beside = look_beside(name)
        types = _types((*peers, *beside) if role is Role.OUTPUT else (*beside, *peers))
        if not wanted and len(types) > 1:
            text = f"topic {name} carries several types: {_listed(types)}; name one in the address"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        chosen = wanted or next(iter(types))
        others = {kind: nodes for kind, nodes in types.items() if kind != chosen}
        return Topic(name, chosen, _listed(others))

    def service(self, address: Address, *, action: bool) -> tuple[str, str]:
        """Return the full name and the type of a service or action on the graph.

        Raises:
            BridgeError: the graph shows another type, or no type and none is in the address.
        """
        name = self._station.service_name(address.name)
        what = "action" if action else "service"
        listing = self._station.actions if action else self._station.services
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
        self, what: str, found: Callable[[], bool], settings: Settings, at_most: float = math.inf
    ) -> bool:
        """Wait for something that describing needs, only while the graph still forms.

        Raises:
            BridgeTimeoutError: `at_most` seconds were too few to tell that it is not there.
        """
        patience = self._patience(settings)
        if self.until(found, min(at_most, patience)):
            return True
        if at_most < patience:
            text = f"{what} was not seen within {at_most:g} s, too few to tell that there is none"
            raise BridgeTimeoutError(text)
        return False

    def absence(self, what: str, name: str, known: Iterable[str]) -> str:
        """Say that a name is not on the graph, which is near it, and where to look.

        Args:
            what: the sentence up to the graph: `topic /x is not`.
            name: the full name that is asked for.
            known: names of the same kind that are there.
        """
        near = get_close_matches(name, [text for text in known if text != name], n=1)
        meant = f"; did you mean {near[0]}?" if near else ""
        domain = self._station.domain_id
        return f"{what} on the graph of domain {domain}{meant}; `uoarm discover` lists what is"

    def servers_named(self) -> list[str]:
        """Return the names of all services and actions on the graph."""
        return [*self._station.services(), *self._station.actions()]

    def _patience(self, settings: Settings) -> float:
        if settings.wait is not None:
            return settings.wait
        return max(_GRACE_SECONDS, self._formed_at - time.monotonic())

    def _nobody(self, name: str, wanted: str, role: Role, peers: tuple[Peer, ...]) -> BridgeError:
        who = "publisher" if role is Role.OUTPUT else "subscription"
        if peers:
            text = f"topic {name} has no {who} of type {wanted}, but {_listed(_types(peers))}"
            return BridgeError(text, FailureReason.UNAVAILABLE)
        topics = self._station.topics()
        known = name in topics
        text = f"topic {name} has no {who}"
        if not known:
            text = self.absence(f"topic {name} is not", name, topics)
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
