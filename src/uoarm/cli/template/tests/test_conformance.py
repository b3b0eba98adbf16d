"""The bridge passes the whole suite that every bridge passes, in this process and in a host."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from bus import ExampleBus, ExamplePeer

from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing import patience
from uoarm.testing.conformance import (
    BridgeConformance,
    LinkVictim,
    Pair,
    Retained,
    Served,
    Victim,
    World,
)

KINDS: dict[str, Any] = {
    "temperature": {
        "type": "object",
        "properties": {"celsius": {"type": "number", "minimum": -273.15}},
        "required": ["celsius"],
        "additionalProperties": False,
    },
    "text": {"type": "string"},
}
"""What the suite sends in and out: one for each type that your framework has."""
VALUE = {
    "type": "object",
    "properties": {"value": {"type": "integer"}},
    "required": ["value"],
    "additionalProperties": False,
}
OTHERS = dict.fromkeys(("latched", "first", "second", "from", "to"), VALUE)
SERVICES = ("double", "failing", "silent", "offered")


class ExampleWorld(World):
    """Topics and services of a bus of this test's own. Delete what your framework does not have."""

    def __init__(self) -> None:
        services = {name: {"request": VALUE, "reply": VALUE} for name in SERVICES}
        services["length"] = {"request": KINDS["text"], "reply": VALUE}
        self._bus = ExampleBus({**KINDS, **OTHERS}, services, retained=("latched",))
        self._peers: list[ExamplePeer] = []

    def spec(self) -> BridgeSpec:
        options = {"port": self._bus.port, "timeout": patience()}
        return BridgeSpec("example", "example", options)

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("nowhere", Role.OUTPUT)

    def samples(self, kind: str) -> Sequence[Message]:
        if kind == "text":
            return ["", "Kia ora \u2192 \U0001f916\r\n\t\0", "{" * 1000]
        return [{"celsius": value} for value in (-0.0, 5e-324, 1.7976931348623157e308)]

    def victims(self) -> Sequence[Victim]:
        made = []
        for topic in ("first", "second"):
            peer = self.peer()
            peer.ask("own", topic=topic)
            made.append(Victim(at(topic, Role.OUTPUT), peer.close))
        return made

    def broken(self) -> bool:
        self._bus.cut()
        return True

    def mended(self) -> None:
        self._bus.mend()

    def unreadable(self, kind: str) -> Callable[[], object]:
        peer = self.peer()
        return lambda: peer.post("publish", topic=kind, payload='{"celsius": ')

    def retained(self) -> Retained:
        peer, message = self.peer(), {"value": 7}

        def emit() -> Message:
            peer.post("publish", topic="latched", payload='{"value": 7}')
            peer.ask("ping")
            return message

        return Retained(at("latched", Role.OUTPUT), emit)

    def served(self) -> Served:
        peer = self.peer()
        peer.serve("double", lambda request: {"value": 2 * request["value"]})
        peer.serve("failing", lambda _: ArithmeticError("the service is broken"))
        peer.serve("silent", lambda _: None)
        peer.serve("length", lambda request: {"value": len(request)})
        first, failing, silent = (at(name, Role.SERVICE) for name in SERVICES[:3])
        more = [({"value": number}, {"value": 2 * number}) for number in range(3)]
        text = at("length", Role.SERVICE), "Kia ora"
        return Served(first, {"value": 21}, {"value": 42}, failing, silent, more, text)

    def servable(self) -> tuple[Endpoint, Endpoint]:
        return at("offered", Role.SERVICE), at("offered", Role.SERVICE)

    def linkable(self) -> Pair:
        return Pair(sink=at("to", Role.INPUT), source=at("from", Role.OUTPUT))

    def link_victims(self) -> Sequence[LinkVictim]:
        peer = self.peer()
        peer.ask("own", topic="from")
        pair = self.linkable()
        return [LinkVictim(pair, pair.source, peer.close)]

    def peer(self) -> ExamplePeer:
        self._peers.append(ExamplePeer(self._bus))
        return self._peers[-1]

    def close(self) -> None:
        for peer in self._peers:
            peer.close()
        self._bus.close()


def at(name: str, role: Role) -> Endpoint:
    return Endpoint("example", name, role, (name,), options={"grace": patience()})


class TestExampleBridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(KINDS)

    @pytest.fixture
    def world(self) -> Iterator[ExampleWorld]:
        made = ExampleWorld()
        yield made
        made.close()


class TestInAHost(TestExampleBridge):
    """The whole suite with the bridge in a process of its own: needs `uoarm[hosts]`."""

    hosted = True
