"""The world of the conformance kit: topics on a real Mosquitto, and peers."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from brokers import Broker, Peer

from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing.conformance import (
    Pair,
    Retained,
    Served,
    Victim,
    World,
)

OCTETS = {
    "type": "array",
    "items": {"type": "integer", "minimum": 0, "maximum": 255},
    "x-octets": True,
}
POINT: Any = {
    "type": "object",
    "properties": {"x": {"type": "number"}, "on": {"type": "boolean"}, "n": {"type": "integer"}},
    "required": ["x", "n"],
    "additionalProperties": False,
}
KINDS: dict[str, Any] = {
    "nested": {
        "type": "object",
        "properties": {
            "points": {"type": "array", "items": {"$ref": "#/$defs/point"}},
            "name": {"type": "string"},
            "image": OCTETS,
        },
        "required": ["points"],
        "additionalProperties": False,
        "$defs": {"point": POINT},
    },
    "text": {"type": "string"},
    "octets": OCTETS,
}
VALUE = {
    "type": "object",
    "properties": {"value": {"type": "integer"}},
    "required": ["value"],
    "additionalProperties": False,
}
SERVICE = {"request": VALUE, "reply": VALUE}
NAMES = itertools.count()


class MqttWorld(World):
    """Topics of its own on a broker that lasts longer than a test.

    Args:
        broker: that has them.
        bridge_lasts: whether the bridge, too, lasts longer: its options name no world.
    """

    def __init__(self, broker: Broker, *, bridge_lasts: bool = False) -> None:
        self.broker = broker
        self.at = f"world{next(NAMES)}"
        self.peers: list[Peer] = []
        self._bridge_lasts = bridge_lasts
        self._retained: dict[str, Any] = {f"described/{self.at}/found": VALUE}
        if bridge_lasts:
            self._retained |= {f"described/{topic}": taken for topic, taken in self._services()}
        self._retain()

    def spec(self) -> BridgeSpec:
        if self._bridge_lasts:
            return lasting_spec(self.broker)
        options = {**lasting_spec(self.broker).options, "services": dict(self._services())}
        return BridgeSpec("mqtt", "mqtt", options)

    def _services(self) -> Iterator[tuple[str, Any]]:
        for name in SERVICES:
            yield f"{self.at}/{name}", SERVICE
        yield f"{self.at}/length", {"request": KINDS["text"], "reply": VALUE}

    def endpoint(self, name: str, role: Role = Role.OUTPUT, **options: object) -> Endpoint:
        topic = f"{self.at}/{name}"
        return Endpoint("mqtt", f"{topic} component", role, (topic,), options=options)

    def pair(self, kind: str) -> Pair:
        content = "json" if kind == "nested" else kind
        return Pair(
            self.endpoint(kind, Role.INPUT, content=content), self.endpoint(kind, content=content)
        )

    def missing(self) -> Endpoint:
        return self.endpoint("nowhere")

    def samples(self, kind: str) -> Sequence[Message]:
        if kind == "octets":
            return [b"", bytes(range(256)), b"\xff" * 100_000]
        if kind == "text":
            return ["", "Kia ora \u2192 \U0001f916\r\n\t\0", "{" * 1000]
        return [
            {"points": [{"x": -0.0, "n": 2**80}, {"x": 5e-324, "n": 0}], "image": b"\0\xff"},
            {"points": [], "name": "Kia ora \u2192 \U0001f916"},
            {"points": [], "name": '[[["{{{,,,:::' * 100},
        ]

    def victims(self) -> Sequence[Victim]:
        return [self._victim(name) for name in ("victim/a", "victim/b")]

    def _victim(self, name: str) -> Victim:
        topic = f"{self.at}/{name}/presence"
        peer = self.peer(will=(topic, "gone"))
        peer.publish(topic, "online", retain=True)
        return Victim(self.endpoint(name, presence={"topic": topic}), peer.die)

    def broken(self) -> bool:
        self.broker.kill()
        return True

    def mended(self) -> None:
        self.broker.start()
        self._retain()  # the broker has forgotten it

    def unreadable(self, kind: str) -> Callable[[], object] | None:
        bad = {"nested": b'{"points": [', "text": b"\xff\xfe"}.get(kind)
        if bad is None:
            return None
        peer = self.peer()
        return lambda: peer.publish(f"{self.at}/{kind}", bad)

    def retained(self) -> Retained:
        peer, message = self.peer(), {"value": 7}

        def emit() -> Message:
            peer.publish(f"{self.at}/retained", json.dumps(message), retain=True)
            return message

        return Retained(self.endpoint("retained", retain=True), emit)

    def served(self) -> Served:
        peer = self.peer()
        peer.serve(f"{self.at}/double", double)
        peer.serve(f"{self.at}/failing", lambda _: ValueError("the service is broken"))
        peer.serve(f"{self.at}/silent", lambda _: None)
        made = [self.endpoint(name, Role.SERVICE) for name in SERVICES[:3]]
        more = [({"value": n}, {"value": 2 * n}) for n in range(3)]
        peer.serve(f"{self.at}/length", length)
        text = self.endpoint("length", Role.SERVICE), "Kia ora"
        return Served(made[0], {"value": 21}, {"value": 42}, made[1], made[2], more, text)

    def servable(self) -> tuple[Endpoint, Endpoint]:
        endpoint = self.endpoint("served", Role.SERVICE)
        return endpoint, endpoint

    def peer(self, will: tuple[str, str] | None = None) -> Peer:
        self.peers.append(Peer(self.broker, will))
        return self.peers[-1]

    def close(self) -> None:
        self._retained = dict.fromkeys(self._retained)  # or the next world is shown it
        self._retain()
        for peer in self.peers:
            peer.close()

    def _retain(self) -> None:
        peer = self.peer()
        for topic, schema in self._retained.items():
            peer.publish(topic, "" if schema is None else json.dumps(schema), retain=True)


SERVICES = ("double", "failing", "silent", "served")


def lasting_spec(broker: Broker) -> BridgeSpec:
    """Return a bridge to the topics of every world; what their services take is retained."""
    structures = {"+/nested": KINDS["nested"], "+/retained": VALUE, "+/victim/+": VALUE}
    options = {"url": broker.url, "structures": structures, "schemas": "described/{topic}"}
    return BridgeSpec("mqtt", "mqtt", {**options, "retained_wait": 0})


def double(request: bytes) -> bytes:
    return json.dumps({"value": 2 * json.loads(request)["value"]}).encode()


def length(request: bytes) -> bytes:
    return json.dumps({"value": len(json.loads(request))}).encode()
