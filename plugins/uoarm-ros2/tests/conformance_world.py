"""The world of the conformance kit: loops through topics, and nodes in processes of their own."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

from endpoints import Start
from messages import default_of
from peers import DOMAIN, MORTAL_CALM, Peer
from uoarm_ros2._types import import_type

from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing import patience, slowness
from uoarm.testing.conformance import LinkVictim, Pair, Retained, Served, Victim, World

KINDS = {
    "scalars": "test_msgs/msg/BasicTypes",
    "strings": "test_msgs/msg/Strings",
    "arrays": "test_msgs/msg/BoundedPlainSequences",
    "image": "sensor_msgs/msg/Image",
    "echoed": "geometry_msgs/msg/PoseStamped",  # by way of a node in another process
}
BOUND_OCTETS = 22  # of test_msgs/msg/Strings
# What is not there is looked for so long; what is there may be found later on a busy machine.
WAIT_SECONDS = slowness()
NOWHERE_SECONDS = 0.1  # for which what is never there is looked for, so that there is a wait
FROZEN_SECONDS = 3 * slowness()  # for which what opens waits for a frozen node
SILENT_SECONDS = 3.0
CUT_SHORT = b"\0\1\0\0\1\2\3"  # serialised, little endian: three octets of a field
SERVICE = "test_msgs/srv/BasicTypes"
NAMES = itertools.count()
ROLES = (Role.OUTPUT, Role.INPUT)


class RosWorld(World):
    """Topics of its own, and the nodes of other processes.

    What the node of every test still sends when a test ends reaches no other one, since each world
    has names of its own.

    Args:
        lasting: a node that serves every test.
        start: starts a node for one test alone.
        breaks: whether the node behind the kind `echoed` is one for this test, to be frozen. The
            other kinds loop through topics within the bridge, with no link that could break.
    """

    def __init__(self, lasting: Peer, start: Start, *, breaks: bool = False) -> None:
        self._lasting = lasting
        self._start = start
        self._breaks = breaks
        self._breakable: Peer | None = None
        self._at = f"/world{next(NAMES)}"
        self._echoes = False

    def spec(self) -> BridgeSpec:
        return BridgeSpec("ros", "ros2", {"domain_id": DOMAIN, "wait": WAIT_SECONDS})

    def pair(self, kind: str) -> Pair:
        topic, native = f"{self._at}/{kind}", KINDS[kind]
        if kind == "echoed" and self._breaks:
            if self._breakable is None:
                self._breakable = self._start("breakable", "threads", **MORTAL_CALM)
                self._breakable.do("echo", come="/asked_again", go="/echoed_again")
            return Pair(
                at(Role.INPUT, "/asked_again", native, wait=FROZEN_SECONDS),
                at(Role.OUTPUT, "/echoed_again", native, wait=FROZEN_SECONDS),
            )
        if kind == "echoed":
            asked = f"{self._at}/asked"
            if not self._echoes:
                self._lasting.do("echo", come=asked, go=topic)
                self._echoes = True
            return Pair(there(Role.INPUT, asked, native), there(Role.OUTPUT, topic, native))
        qos = {"depth": 100}  # a burst is longer than what is kept of pictures by default
        return Pair(
            at(Role.INPUT, topic, native, peer="optional", qos=qos),
            at(Role.OUTPUT, topic, native, peer="optional", wait=0, qos=qos),
        )

    def missing(self) -> Endpoint:
        return at(Role.OUTPUT, "/nowhere", "std_msgs/msg/Int64", wait=NOWHERE_SECONDS)

    def await_receivers(self, kind: str, count: int) -> None:
        """DDS reports readers to a writer, and to a reader nothing of what its writers know."""
        if kind == "echoed" and not self._breaks:
            topic = self.pair(kind).source.address[0]
            assert self._lasting.do("subscriptions", topic=topic, expected=count) == count

    def close(self) -> None:
        """End what the lasting node does for this world."""
        if self._echoes:
            self._lasting.do("end_echo", come=f"{self._at}/asked")

    def carried(self, kind: str, message: Message) -> Message:
        return rounded(KINDS[kind], message)

    def takes(self, kind: str, message: Message) -> bool:
        """ROS 2 counts the octets of a bounded string."""
        return kind != "strings" or all(
            len(text.encode()) <= BOUND_OCTETS
            for name, text in message.items()
            if name.startswith("bounded")
        )

    def samples(self, kind: str) -> Sequence[Message]:
        if kind == "scalars":
            return [special(value) for value in (math.nan, math.inf, -math.inf, 0.1)]
        if kind == "image":
            return [large_image()]
        message = default_of(import_type(KINDS[kind]))
        return [{name: listed(value) for name, value in message.items()}]

    def victim(self) -> Victim:
        return self._victim("/mortal")

    def victims(self) -> Sequence[Victim]:
        return [self._victim(topic) for topic in ("/first_mortal", "/second_mortal")]

    def _victim(self, topic: str) -> Victim:
        talker = self._start(topic.strip("/"), **MORTAL_CALM)
        talker.do("advertise", topic=topic)
        return Victim(there(Role.OUTPUT, topic, "std_msgs/msg/Int64"), talker.kill)

    def broken(self) -> bool:
        """Freeze the node on the way: its lease ends, and with it the link to it."""
        if self._breakable is None:
            return False
        self._breakable.freeze()
        return True

    def mended(self) -> None:
        assert self._breakable is not None
        self._breakable.thaw()

    def unreadable(self, kind: str) -> Callable[[], object]:
        topic = f"{self._at}/{kind}"
        self._lasting.do("advertise_octets", topic=topic, native=KINDS[kind])

        def emit() -> None:
            self._lasting.do("publish_octets", topic=topic, octets=CUT_SHORT.hex())

        return emit

    def retained(self) -> Retained:
        node = self._start("retaining")
        node.do("advertise", topic="/retained", durability="transient_local")

        def emit() -> Message:
            node.do("publish", topic="/retained", count=1, first=7)
            return {"data": 7}

        return Retained(there(Role.OUTPUT, "/retained", "std_msgs/msg/Int64"), emit)

    def served(self) -> Served:
        mortal = self._start("failing", **MORTAL_CALM)
        mortal.do("fail", name="/failing")
        native: Any = import_type(SERVICE)
        request = {**default_of(native.Request), "int64_value": 2**62, "string_value": "abc"}
        reply = {**default_of(native.Response), "int64_value": 2**62 + 1, "string_value": "cba"}
        service, failing, silent = (
            there(Role.SERVICE, name, SERVICE) for name in ("/add", "/failing", "/silent")
        )
        more = [
            (
                {**request, "int64_value": number, "string_value": text},
                {**reply, "int64_value": number + 1, "string_value": text[::-1]},
            )
            for number, text in ((1, "one"), (2, "two"), (3, "three"))
        ]
        return Served(service, request, reply, failing, silent, more)

    def servable(self) -> tuple[Endpoint, Endpoint]:
        offered = at(Role.SERVICE, "/offered", SERVICE)
        return offered, offered

    def linkable(self) -> Pair:
        image = KINDS["image"]
        options = {"peer": "optional", "wait": 0}
        return Pair(
            at(Role.INPUT, "/linked", image, **options), at(Role.OUTPUT, "/from", image, **options)
        )

    def link_victims(self) -> list[LinkVictim]:
        """Between two topics, and of one topic, which ROS 2 connects by itself."""
        return [
            self._link_victim(dies, *topics)
            for topics in (("from", "to"), ("shared", "shared"))
            for dies in ROLES
        ]

    def _link_victim(self, dies: Role, *topics: str) -> LinkVictim:
        ends, native = [], "std_msgs/msg/Int64"
        mortal = self._start(f"{topics[0]}_{dies.value}", **MORTAL_CALM)
        for role, do, topic in zip(ROLES, ("advertise", "subscribe"), topics, strict=True):
            name = f"{self._at}/{dies.value}/{topic}"
            (mortal if role is dies else self._lasting).do(do, topic=name)
            component, limit = f"{name}_{role.value}", {"wait": patience()}
            ends.append(Endpoint("ros", component, role, (name, native), options=limit))
        source, sink = ends
        dead = source if dies is Role.OUTPUT else sink
        return LinkVictim(Pair(sink, source), dead, mortal.kill)


def at(role: Role, name: str, native: str, **options: object) -> Endpoint:
    return Endpoint("ros", name.strip("/"), role, (name, native), options=options)


def there(role: Role, name: str, native: str) -> Endpoint:
    """One that another process has, as soon as discovery has it."""
    return at(role, name, native, wait=patience())


def special(value: float) -> Message:
    message = default_of(import_type(KINDS["scalars"]))
    return {**message, "float32_value": value, "float64_value": value}


def listed(value: Any) -> Any:
    """A value of a message as JSON would have it, octets as bytes."""
    if isinstance(value, memoryview):
        return bytes(value)
    return value.tolist() if hasattr(value, "tolist") else value


def large_image() -> Message:
    message = default_of(import_type(KINDS["image"]))
    pixels = bytes(range(256)) * 4096
    return {**message, "height": 1024, "width": 1024, "step": 1024, "data": pixels}


def rounded(native: str, message: Message) -> Message:
    """The message with every number as the float32 or float64 of its field has it."""
    fields: dict[str, str] = import_type(native).get_fields_and_field_types()  # type: ignore[attr-defined]  # generated
    return {name: _rounded(kind, message[name]) for name, kind in fields.items()}


def _rounded(kind: str, value: Any) -> Any:
    element = kind.removeprefix("sequence<").split(",")[0].split("[")[0].rstrip(">")
    if isinstance(value, list):
        return [_rounded(element, item) for item in value]
    if isinstance(value, dict):
        package, name = element.split("/")
        return rounded(f"{package}/msg/{name}", value)
    if element == "float":
        return struct.unpack("f", struct.pack("f", value))[0]
    return float(value) if element == "double" else value
