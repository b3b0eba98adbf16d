"""What is open of plans, and who uses it: components, edges, application ports; frozen values.

Whatever is open is a numbered part with its users. A component that is closed and opened again is
another part, so that a late result is never taken for one of the new instance.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from enum import Enum
from typing import Any, NamedTuple

from attrs import evolve, field, frozen
from rpds import HashTrieMap, HashTrieSet

from uoarm.model import Edge, Health, Plan, Role, Step, ValidationMode

NOTHING: HashTrieMap[Any, Any] = HashTrieMap()
NONE: HashTrieSet[Any] = HashTrieSet()
"""The empty map and the empty set, from which persistent ones begin."""

_BETTER_TO_WORSE = tuple(Health)


MESSAGES = "messages"
"""What a component raises, as a part of it of which the health is reported."""


class LinkEnd(NamedTuple):
    """One end of a native link, as a part of its component of which the health is reported.

    Attributes:
        role, port: of the component that has this end.
        peer, peer_port: the component at the other end, and its port.
    """

    role: Role
    port: str
    peer: str
    peer_port: str


@frozen
class ComponentHealth:
    """What was reported last of each part; one part that is well covers up no other.

    Attributes:
        health: the worst of all, and its `cause`; where it was just reported, the newest.
        reported: of each part that is not well.
    """

    health: Health = Health.OK
    cause: str = ""
    reported: Mapping[Hashable, tuple[Health, str]] = field(factory=dict)

    def noted(self, part: Hashable, health: Health, cause: str) -> ComponentHealth:
        """Return the health after a report about a part."""
        reported = {name: value for name, value in self.reported.items() if name != part}
        if health is not Health.OK:
            reported[part] = health, cause
        worst = max(
            reported.values(),
            key=lambda item: _BETTER_TO_WORSE.index(item[0]),
            default=(Health.OK, cause),
        )
        if worst[0] is health:
            worst = health, cause
        return evolve(self, health=worst[0], cause=worst[1], reported=reported)

    def is_news(self, before: ComponentHealth, health: Health, cause: str) -> bool:
        """Say whether a report that led here from `before` is news of the whole component.

        It is none when a worse one elsewhere covers it up, or when all was well before.
        """
        if before.health is self.health is Health.OK:
            return False
        now = self.health, self.cause
        return now == (health, cause) or now != (before.health, before.cause)


_WELL = ComponentHealth()
_STRICTNESS = tuple(ValidationMode)
_RANKS = {mode: rank for rank, mode in enumerate(_STRICTNESS)}


class Kind(Enum):
    """What a part is. Of a component, its application ports and its edges, in opening order."""

    COMPONENT = "component"
    RECEIVE = "receive"
    OUTPUT = "output"
    EDGE = "edge"
    SEND = "send"

    __hash__ = object.__hash__  # members are singletons; by name it costs ten times as much


PORTS = frozenset({Kind.RECEIVE, Kind.SEND})
"""Where the application touches a plan; these call a bridge for inputs that it feeds, only."""


# A tuple and no class of attrs, as all records that a step makes or hashes many times.
class Part(NamedTuple):
    """Something that is opened by one call into a bridge, or attached.

    Attributes:
        kind: what it is.
        id: of its component, its edge, or its application ports.
        port: the name of an output, else empty.
    """

    kind: Kind
    id: int
    port: str = ""


@frozen
class Parts:
    """Parts without a user: what is to be closed.

    Attributes:
        components, edges: ids, producers first.
        ports: ids of application ports.
    """

    components: tuple[int, ...] = ()
    edges: tuple[int, ...] = ()
    ports: tuple[int, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.components or self.edges or self.ports)


# Records of one name may be open side by side: one that serves new users, and those that died,
# were superseded or only drain. So a name identifies no instance, and nothing late is found by
# it.
class ComponentRecord(NamedTuple):
    """One instance of a component, open or on the way there.

    Attributes:
        step: of the first plan that needed it.
        users: the placements that depend on it.
        draining: how many of these only let pass what is under way.
        health: how it is doing.
        is_lost: whether it died; then it is shared no more.
        is_superseded: whether the configuration has another in its place, or none; the same.
    """

    id: int
    step: Step
    # Of a component that thousands share, one more user must not cost a copy of all of them. Who
    # has lost something is found here, and not by looking at every connection.
    users: HashTrieSet[str] = NONE
    draining: int = 0
    health: ComponentHealth = _WELL
    is_lost: bool = False
    is_superseded: bool = False

    @property
    def only_drains(self) -> bool:
        """Whether only draining plans use it."""
        return self.draining == len(self.users)

    def used_by(self, users: HashTrieSet[str]) -> ComponentRecord:
        """Return the instance with other users."""
        # Half of all changes, in a quarter of the time of `_replace`.
        return ComponentRecord(self[0], self[1], users, *self[3:])

    @property
    def name(self) -> str:
        return self.step.component.name


class EdgeRecord(NamedTuple):
    """One edge between two instances, with what each of its users wishes to be checked.

    Attributes:
        strictest: the mode that satisfies every user.
        is_held: whether messages wait for a switchover, since another edge feeds the input.
    """

    id: int
    edge: Edge
    producer: int
    consumer: int
    # The mode of each user and not the strictest: as that one leaves, the check is relaxed. How
    # many wish for each is counted, so that no change looks at all users.
    users: HashTrieMap[str, ValidationMode] = NOTHING
    counts: tuple[int, ...] = (0,) * len(_STRICTNESS)
    strictest: ValidationMode = ValidationMode.OFF
    # A held edge is in `State.beside` and no other is; it moves to `feeding` in one step with the
    # end of the one before, so that an input never has two edges that let messages through.
    is_held: bool = False

    @property
    def key(self) -> tuple[str, str]:
        return self.edge.consumer, self.edge.input

    @property
    def origin(self) -> tuple[str, str]:
        return self.edge.producer, self.edge.output

    @property
    def ends(self) -> tuple[tuple[int, LinkEnd], ...]:
        """Both instances, each with its end of the native link that the edge may be."""
        return (
            (self.producer, LinkEnd(Role.OUTPUT, self.origin[1], *self.key)),
            (self.consumer, LinkEnd(Role.INPUT, self.key[1], *self.origin)),
        )

    def used_by(self, user: str, mode: ValidationMode | None) -> EdgeRecord:
        """Return the edge with a user that wishes this mode; None: it uses it no more."""
        counts, before = list(self.counts), self.users.get(user)
        if before is not None:
            counts[_RANKS[before]] -= 1
        if mode is None:
            users = self.users.remove(user)
        else:
            counts[_RANKS[mode]] += 1
            users = self.users.insert(user, mode)
        strictest = ValidationMode.OFF
        for wished, count in zip(_STRICTNESS, counts, strict=True):
            strictest = wished if count else strictest
        return EdgeRecord(*self[:4], users, tuple(counts), strictest, self.is_held)


class Placement(NamedTuple):
    """A plan, and the parts that serve it.

    Attributes:
        user: the name under which it uses parts: the connection's id, for later plans `c1#2`.
        provider: id of the component that the application asked for.
        edges: ids, those of the first producers first.
        ports: id of the application ports.
        parts: everything it needs, in the order in which that opens.
    """

    user: str
    plan: Plan
    components: Mapping[str, int]
    provider: int
    edges: tuple[int, ...]
    # The same number as in the plan before where the provider stays: the application's inbox and
    # its inputs then go through the change untouched.
    ports: int
    # Consumers open before what feeds them, so that a first message finds its input open; the
    # application's inputs come last, when all that their messages lead to is there.
    parts: tuple[Part, ...]


class Batch(NamedTuple):
    """Parts that are being opened for a placement, in their order."""

    user: str
    parts: tuple[Part, ...]
    # Other connections that cannot go on before it is over, as they share some of it.
    waiting: HashTrieSet[str] = NONE


class DrainingPlan(NamedTuple):
    """A plan that was replaced, while what is under way in it arrives.

    Its edges are closed. Its components stay open until nothing is under way, and other plans may
    use them meanwhile: a second instance of one would get the same messages once more.

    Attributes:
        connection: whose plan it was.
        lost: ids of its components that died.
    """

    connection: str
    placement: Placement
    lost: tuple[int, ...]
