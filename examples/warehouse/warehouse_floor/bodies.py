"""The bodies of the vehicles: where they are, what they carry, and what they hit.

A plain model: time comes in, nothing goes out. It stands for the physical world, so it knows
nothing of frameworks, orders or traffic, and what it counts is the truth of an experiment.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Final, TypeAlias

from attrs import define, frozen

from warehouse_floor.layout import DOCKS, HOMES, NODES, RACKS, SHELVES, node_at

__all__ = ["BASE_TIMEOUT", "RADIUS", "Body", "Floor", "Sense"]

RADIUS: Final = 0.45
BASE_TIMEOUT: Final = 0.6
"""Seconds without a command after which the controller of a base stops it by itself."""

_SOLID: Final = 0.5  # half the width of a rack, and of what stands in the way
_MOST = (1.6, 1.6, 2.5)  # metres and radians a second
_SPEED_UP, _SLOW_DOWN = (1.2, 1.2, 8.0), (2.5, 2.5, 8.0)  # the same a second squared
_BUMPER_METRES: Final = 1.45
_DRAIN, _DRAIN_METRE, _CHARGE = 0.01, 0.05, 2.0  # per cent: a second, a metre, a second at home
_STILL: Final = 0.02
_BRAKE_SECONDS: Final = 1.0

Triple: TypeAlias = tuple[float, float, float]
_NOWHERE: Final[Triple] = (0.0, 0.0, 0.0)


@frozen
class Sense:
    """What the sensors of one vehicle say.

    Attributes:
        x: metres; the last known where it is not localised.
        y: metres.
        heading: radians.
        speed: metres a second.
        battery: per cent.
        load: the box that it carries, or nothing.
        is_localised: whether it knows where it is.
        is_blocked: whether something stands in its way.
    """

    x: float
    y: float
    heading: float
    speed: float
    battery: float
    load: str
    is_localised: bool
    is_blocked: bool


@define(eq=False)
class Body:
    """One vehicle's body. `wanted` is the velocity it was commanded: forward, left, turn."""

    name: str
    is_holonomic: bool
    pose: Triple
    velocity: Triple = _NOWHERE
    wanted: Triple = _NOWHERE
    commanded: float = float("-inf")
    allowed_until: float = float("-inf")
    battery: float = 100.0
    load: str = ""
    is_localised: bool = True
    is_blocked: bool = False

    @property
    def speed(self) -> float:
        """Metres a second over the floor."""
        return math.hypot(*self.velocity[:2])

    @property
    def is_moving(self) -> bool:
        """Whether it drives or turns."""
        return any(abs(part) > _STILL for part in self.velocity)


class Floor:
    """All bodies, boxes and obstacles, and what went wrong between them.

    Attributes:
        boxes: where each box is: a shelf, a dock or a vehicle.
        deliveries: how often each box was put down at a dock.
        obstacles: nodes on which something stands.
        collisions: how often two vehicles, or a vehicle and a rack or obstacle, began to touch.
        contacts: what was so each time, with where the bodies were and how fast.
        repeats: how often a vehicle reached for a box that had been delivered.
        unauthorised: how often a vehicle began to move without a live command of its framework.
        metres: driven by all.
    """

    def __init__(self) -> None:
        self.boxes: dict[str, str] = {}
        self.deliveries: dict[str, int] = {}
        self.obstacles: set[str] = set()
        self.collisions = 0
        self.contacts: list[str] = []
        self.repeats = 0
        self.unauthorised = 0
        self.metres = 0.0
        self._bodies: dict[str, Body] = {}
        self._touching: set[tuple[str, str]] = set()
        self._roaming: set[str] = set()
        self._reaching: dict[str, str] = {}

    @property
    def bodies(self) -> Mapping[str, Body]:
        """The bodies by name."""
        return self._bodies

    def add(self, name: str, home: str, *, is_holonomic: bool = False) -> Body:
        """Put a body on the floor, facing along x; one that is there already stays as it is."""
        if name not in self._bodies:
            self._bodies[name] = Body(name, is_holonomic, (*NODES[home], 0.0))
        return self._bodies[name]

    def command(self, name: str, velocity: Triple, until: float, now: float) -> None:
        """Take a command of the base of a vehicle.

        Args:
            name: of the vehicle.
            velocity: forward and left in metres a second, turn in radians a second.
            until: when the command of its framework, which allows this, is not live any more.
            now: seconds.
        """
        body = self._bodies[name]
        forward, left, turn = velocity
        body.wanted = (forward, left if body.is_holonomic else 0.0, turn)
        body.commanded, body.allowed_until = now, max(body.allowed_until, until)

    def carry(self, name: str, box: str) -> bool:
        """Pick a box up, or put down what is carried (`box` empty); return whether it is so now.

        It happens where the vehicle stands still at the shelf of the box, or at a dock. A box that
        no one has seen before is on the shelf at which it is wanted first.
        """
        body = self._bodies[name]
        if body.load == box:
            self._reaching.pop(name, None)
            return True
        where = node_at(*body.pose[:2])
        if where is None or body.is_moving:
            return False
        if box and not body.load and where in SHELVES:
            self.deliveries.setdefault(box, 0)
            if self.boxes.setdefault(box, where) == where:
                body.load, self.boxes[box] = box, name
                return True
            if self.deliveries[box] and self._reaching.get(name) != box:
                self._reaching[name] = box
                self.repeats += 1
        if not box and where in DOCKS:
            self.boxes[body.load] = where
            self.deliveries[body.load] += 1
            body.load = ""
            return True
        return False

    def block(self, node: str, clear: float) -> bool:
        """Put an obstacle on a node, unless a vehicle is nearer than `clear` metres to it."""
        near = (math.dist(body.pose[:2], NODES[node]) < clear for body in self._bodies.values())
        if any(near):
            return False
        self.obstacles.add(node)
        return True

    def sense(self, name: str) -> Sense:
        """Return what a vehicle's sensors say."""
        body = self._bodies[name]
        battery, load = body.battery, body.load
        return Sense(*body.pose, body.speed, battery, load, body.is_localised, body.is_blocked)

    def step(self, now: float, seconds: float) -> None:
        """Move everything on by a short time, at most a tenth of a second."""
        for body in self._bodies.values():
            body.velocity = _towards(body.velocity, self._wanted(body, now), seconds)
            metres = body.speed * seconds
            body.pose = _moved(body.pose, body.velocity, seconds)
            body.is_blocked = self._is_blocked(body)
            self._charge(body, metres, seconds)
            self._authorise(body, now)
            self.metres += metres
        touching = set(self._touches())
        for pair in sorted(touching - self._touching):
            self.collisions += 1
            bodies = [self._bodies[name] for name in pair if name in self._bodies]
            where = "; ".join(f"{item.name} {_described(item, now)}" for item in bodies)
            self.contacts = [*self.contacts[-9:], f"{now:.2f}: {' and '.join(pair)}: {where}"]
        self._touching = touching

    def _wanted(self, body: Body, now: float) -> Triple:
        if now - body.commanded > BASE_TIMEOUT or not body.battery:
            return _NOWHERE
        if body.is_blocked:
            return (0.0, 0.0, body.wanted[2])
        return body.wanted

    def _is_blocked(self, body: Body) -> bool:
        """Whether its bumper sees an obstacle where it wants to drive."""
        if not (body.wanted[0] or body.wanted[1]):
            return False
        x, y, heading = body.pose
        heading += math.atan2(body.wanted[1], body.wanted[0])
        for node in self.obstacles:
            ahead, aside = NODES[node][0] - x, NODES[node][1] - y
            angle = abs(_turned(math.atan2(aside, ahead) - heading))
            if math.hypot(ahead, aside) < _BUMPER_METRES and angle < math.pi / 4:
                return True
        return False

    def _charge(self, body: Body, metres: float, seconds: float) -> None:
        home = not metres and node_at(*body.pose[:2]) in HOMES
        change = _CHARGE * seconds if home else -_DRAIN * seconds - _DRAIN_METRE * metres
        body.battery = min(100.0, max(0.0, body.battery + change))

    def _authorise(self, body: Body, now: float) -> None:
        """Count a vehicle that goes on once a command has run out and the time to brake is over."""
        if body.is_moving and now > body.allowed_until + _BRAKE_SECONDS:
            self.unauthorised += body.name not in self._roaming
            self._roaming.add(body.name)
        else:
            self._roaming.discard(body.name)

    def _touches(self) -> Iterator[tuple[str, str]]:
        for item, other in combinations(self._bodies.values(), 2):
            if math.dist(item.pose[:2], other.pose[:2]) < 2 * RADIUS:
                yield item.name, other.name
        for body in self._bodies.values():
            for centre in (*RACKS, *(NODES[node] for node in self.obstacles)):
                ahead, aside = (abs(a - b) for a, b in zip(body.pose[:2], centre, strict=True))
                if math.hypot(max(ahead - _SOLID, 0), max(aside - _SOLID, 0)) < RADIUS:
                    yield body.name, f"what stands at {centre}"


def _described(body: Body, now: float) -> str:
    x, y, heading = body.pose
    live = body.allowed_until - now
    return f"at {x:.2f}, {y:.2f}, {heading:.2f} with {body.speed:.2f} m/s, live for {live:.2f} s"


def _towards(velocity: Triple, wanted: Triple, seconds: float) -> Triple:
    """Return the velocity after a time: no base changes its own faster than it can."""
    pairs = zip(velocity, wanted, _MOST, _SPEED_UP, _SLOW_DOWN, strict=True)
    forward, left, turn = (_approach(seconds, *pair) for pair in pairs)
    return forward, left, turn


def _approach(
    seconds: float, now: float, wanted: float, most: float, faster: float, slower: float
) -> float:
    wanted = max(-most, min(most, wanted))
    change = (slower if abs(wanted) < abs(now) else faster) * seconds
    return now + max(-change, min(change, wanted - now))


def _moved(pose: Triple, velocity: Triple, seconds: float) -> Triple:
    (x, y, heading), (forward, left, turn) = pose, velocity
    cosine, sine = math.cos(heading), math.sin(heading)
    x += (forward * cosine - left * sine) * seconds
    y += (forward * sine + left * cosine) * seconds
    return x, y, _turned(heading + turn * seconds)


def _turned(angle: float) -> float:
    """Return the same direction between -pi and pi."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
