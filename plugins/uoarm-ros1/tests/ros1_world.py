"""The world of the conformance kit: topics through a real master, and nodes of rospy."""

from __future__ import annotations

import base64
import itertools
import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

from peers import Master, Peer
from uoarm_ros1._types import TypeStore

from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing import patience
from uoarm.testing.conformance import LinkVictim, Pair, Retained, Served, Victim, World

KINDS = {
    "scalars": "rosgraph_msgs/Log",
    "arrays": "sensor_msgs/LaserScan",
    "image": "sensor_msgs/Image",
    "nested": "sensor_msgs/CameraInfo",
    "echoed": "geometry_msgs/Inertia",  # by way of a node in another process
}
NAMES = itertools.count()
ROLES = (Role.OUTPUT, Role.INPUT)
TYPES = TypeStore(())


class Ros1World(World):
    """Topics of its own on a master that lasts longer than a test.

    Args:
        master: of the graph.
        lasting: a node that serves every test; None: one is started.
    """

    def __init__(self, master: Master, lasting: Peer | None) -> None:
        self.master = master
        self._lasting = lasting
        self.at = f"/world{next(NAMES)}"
        self._started: list[Peer] = []

    @property
    def lasting(self) -> Peer:
        if self._lasting is None:
            self._lasting = self.start()
        return self._lasting

    def spec(self) -> BridgeSpec:
        return BridgeSpec(
            "ros", "ros1", {"master": self.master.uri, "check": 0.2, "wait": min(patience(), 60)}
        )

    def endpoint(self, name: str, role: Role, native: str = "", **options: object) -> Endpoint:
        address = (f"{self.at}/{name}", native) if native else (f"{self.at}/{name}",)
        return Endpoint("ros", f"{name} component", role, address, options=options)

    def pair(self, kind: str) -> Pair:
        native = KINDS[kind]
        if kind == "echoed":
            if not self._has_echo():
                topics = [f"{self.at}/{name}" for name in ("asked", "echoed")]
                self.lasting.do("echo", topic=topics[0], to=topics[1], type=native)
            return Pair(
                self.endpoint("asked", Role.INPUT, wait=patience()),
                self.endpoint("echoed", Role.OUTPUT, wait=patience()),
            )
        return Pair(
            self.endpoint(kind, Role.INPUT, native, peer="optional", queue=1000),
            self.endpoint(kind, Role.OUTPUT, native, peer="optional"),
        )

    def _has_echo(self) -> bool:
        before, self._echoes = getattr(self, "_echoes", False), True
        return before

    def missing(self) -> Endpoint:
        return self.endpoint("nowhere", Role.OUTPUT)

    def carried(self, kind: str, message: Message) -> Message:
        return rounded(KINDS[kind], message)

    def samples(self, kind: str) -> Sequence[Message]:
        if kind == "image":
            return [large_image()]
        if kind == "arrays":
            return [scan(value) for value in (math.nan, math.inf, -math.inf, 0.1)]
        return [zero(KINDS[kind])]

    def victims(self) -> Sequence[Victim]:
        made = []
        for name in ("first", "second"):
            peer = self.start()
            topic = f"{self.at}/{name}"
            peer.do("advertise", topic=topic, type="std_msgs/Int64")
            source = self.endpoint(name, Role.OUTPUT, "std_msgs/Int64", wait=patience())
            made.append(Victim(source, peer.kill))
        return made

    def broken(self) -> bool:
        self.master.kill()
        return True

    def mended(self) -> None:
        self.master.start()

    def unreadable(self, kind: str) -> Callable[[], object]:
        peer, topic, native = self.lasting, f"{self.at}/{kind}", KINDS[kind]
        peer.do("advertise_octets", topic=topic, type=native)
        octets = base64.b64encode(b"\1\2\3").decode()

        def emit() -> None:
            peer.wait_for("connections", lambda count: count > 0, topic=topic)
            peer.do("publish_octets", topic=topic, octets=octets)

        return emit

    def retained(self) -> Retained:
        peer, topic, native = self.lasting, f"{self.at}/retained", "std_msgs/Int64"
        peer.do("advertise", topic=topic, type=native, latch=True)
        message = {"data": 7}

        def emit() -> Message:
            peer.do("publish", topic=topic, type=native, values=message)
            return message

        return Retained(self.endpoint("retained", Role.OUTPUT, wait=patience()), emit)

    def served(self) -> Served:
        peer = self.lasting
        for name, how in (("set", "ok"), ("failing", "fail"), ("silent", "silent")):
            peer.do("serve", service=f"{self.at}/{name}", type="std_srvs/SetBool", how=how)
        endpoints = [self.endpoint(name, Role.SERVICE) for name in ("set", "failing", "silent")]
        more = [
            ({"data": data}, {"success": data, "message": f"data is {data}"})
            for data in (True, False, True)
        ]
        request, reply = more[0]
        peer.do("serve", service=f"{self.at}/level", type="roscpp/SetLoggerLevel", how="ok")
        text = self.endpoint("level", Role.SERVICE), {"logger": "rosout", "level": "info"}
        return Served(endpoints[0], request, reply, endpoints[1], endpoints[2], more, text)

    def servable(self) -> tuple[Endpoint, Endpoint]:
        offered = self.endpoint("offered", Role.SERVICE, "std_srvs/SetBool")
        called = self.endpoint("offered", Role.SERVICE, "std_srvs/SetBool")
        return offered, called

    def linkable(self) -> Pair:
        native, options = KINDS["image"], {"peer": "optional", "wait": 0}
        return Pair(
            self.endpoint("linked", Role.INPUT, native, **options),
            self.endpoint("from", Role.OUTPUT, native, **options),
        )

    def link_victims(self) -> list[LinkVictim]:
        """Between two topics, and of one topic, which ROS 1 connects by itself."""
        return [
            self._link_victim(dies, *topics)
            for topics in (("from", "to"), ("shared", "shared"))
            for dies in ROLES
        ]

    def _link_victim(self, dies: Role, *topics: str) -> LinkVictim:
        native, mortal, ends = "std_msgs/Int64", self.start(), []
        for role, do, topic in zip(ROLES, ("advertise", "subscribe"), topics, strict=True):
            name = f"{self.at}/{dies.value}/{topic}"
            (mortal if role is dies else self.lasting).do(do, topic=name, type=native)
            options = {"wait": patience()}
            component = f"{name}_{role.value}"
            ends.append(Endpoint("ros", component, role, (name, native), options=options))
        source, sink = ends
        dead = source if dies is Role.OUTPUT else sink
        return LinkVictim(Pair(sink, source), dead, mortal.kill)

    def start(self) -> Peer:
        self._started.append(self.master.peer(f"peer{next(NAMES)}"))
        return self._started[-1]

    def close(self) -> None:
        for peer in self._started:
            peer.kill()


def zero(native: str) -> Any:
    """Return a message in which everything is zero or empty."""
    from uoarm_ros1._actions import _zero

    return _zero(TYPES.require(native).schema)


def scan(value: float) -> Message:
    return {**zero("sensor_msgs/LaserScan"), "range_max": value, "ranges": [value, 1.0]}


def large_image() -> Message:
    pixels = bytes(range(256)) * 8192
    size = {"height": 2048, "width": 1024, "step": 1024}
    return {**zero("sensor_msgs/Image"), **size, "encoding": "mono8", "data": pixels}


def rounded(native: str, message: Message) -> Message:
    """Return the message with every number as the float of its field has it."""

    def of(schema: Any, value: Any) -> Any:
        if schema["type"] == "object":
            inner = schema["properties"].items()
            return {name: of(member, value[name]) for name, member in inner}
        if schema["type"] == "array":
            if isinstance(value, bytes | memoryview):
                return value
            return [of(schema["items"], item) for item in value]
        if schema.get("x-native-type") == "float32":
            return struct.unpack("f", struct.pack("f", value))[0]
        return float(value) if schema["type"] == "number" else value

    return of(TYPES.require(native).schema, message)
