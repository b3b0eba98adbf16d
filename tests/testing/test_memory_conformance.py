"""The memory bridge passes the suite that it helps to test."""

from __future__ import annotations

from typing import Any

import pytest

from uoarm.bridge import Bridge
from uoarm.model import Endpoint, Role
from uoarm.testing import Hang, MemoryBridge
from uoarm.testing.conformance import BridgeConformance, Pair, Served, Victim, World

SCHEMAS: dict[str, Any] = {
    "byte": {"type": "integer", "minimum": 0, "maximum": 255},
    "text": {"type": "string"},
    "number": {"type": "number"},
    "list": {"type": "array", "items": {"type": "boolean"}},
}


def record(field: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {"value": field},
        "required": ["value"],
        "additionalProperties": False,
    }


class MemoryWorld(World):
    """Loops, an emitter to be killed, and three services, made anew on every bridge."""

    def __init__(self) -> None:
        self._bridge: MemoryBridge | None = None
        self._hang = Hang()

    def bridge(self) -> Bridge:
        made = self._bridge = MemoryBridge(links=True)
        for kind, field in SCHEMAS.items():
            made.loop(kind, record(field))
        made.emitter("victim", record(SCHEMAS["byte"]))
        made.emitter("producer", record(SCHEMAS["byte"]))
        made.taker("consumer", record(SCHEMAS["byte"]))
        value = record(SCHEMAS["byte"])
        made.service("double", value, value, lambda asked: {"value": 2 * asked["value"]})
        made.service("broken", value, value, self._fail)
        made.service("silent", value, value, self._hold)
        return made

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("nowhere", Role.OUTPUT)

    def victim(self) -> Victim:
        bridge = self._bridge
        assert bridge is not None
        return Victim(at("victim", Role.OUTPUT), lambda: bridge.die("victim"))

    def served(self) -> Served:
        services = [at(name, Role.SERVICE) for name in ("double", "broken", "silent")]
        return Served(services[0], {"value": 21}, {"value": 42}, services[1], services[2])

    def servable(self) -> tuple[Endpoint, Endpoint]:
        return at("offered", Role.SERVICE), at("offered", Role.SERVICE)

    def linkable(self) -> Pair:
        return Pair(at("consumer", Role.INPUT), at("producer", Role.OUTPUT))

    def close(self) -> None:
        self._hang.release()

    def _fail(self, _: Any) -> Any:
        raise RuntimeError("the service is broken")

    def _hold(self, _: Any) -> Any:
        self._hang.wait()


def at(name: str, role: Role) -> Endpoint:
    return Endpoint("memory", name, role, (name,))


class TestMemoryBridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(SCHEMAS)

    @pytest.fixture
    def world(self) -> MemoryWorld:
        return MemoryWorld()
