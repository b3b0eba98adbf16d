"""The memory bridge passes the suite that it helps to test."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import pytest
from tests.structures import closed

from uoarm.bridge import Bridge, BridgeType, Registry
from uoarm.model import BridgeSpec, Endpoint, Message, Options, Role
from uoarm.testing import Emitter, Hang, Loop, MemoryBridge
from uoarm.testing.conformance import (
    BridgeConformance,
    LinkVictim,
    Pair,
    Retained,
    Served,
    Victim,
    World,
)

SCHEMAS: dict[str, Any] = {
    "byte": {"type": "integer", "minimum": 0, "maximum": 255},
    "text": {"type": "string"},
    "number": {"type": "number"},
    "list": {"type": "array", "items": {"type": "boolean"}},
    "octets": {
        "type": "array",
        "items": {"type": "integer", "minimum": 0, "maximum": 255},
        "x-octets": True,
    },
}


OPTIONS: dict[str, Any] = closed(links={"type": "boolean"})


class MemoryWorld(World):
    """Loops, emitters to be killed, and three services, made anew on every bridge."""

    runs_code = True

    def __init__(self) -> None:
        self._made: MemoryBridge | None = None
        self._hang = Hang()
        self._loops: dict[str, Loop] = {}
        self._latch: Emitter | None = None

    def spec(self) -> BridgeSpec:
        return BridgeSpec("memory", "memory", {"links": True})

    def registry(self) -> Registry:
        made = Registry([])
        declared = BridgeType("memory", "for tests", self.create, OPTIONS, check, contract=2)
        made.add(declared)
        return made

    def create(self, name: str, options: Options) -> Bridge:
        made = self._made = MemoryBridge(name, options, links=options["links"] is True)
        for kind, field in SCHEMAS.items():
            self._loops[kind] = made.loop(kind, closed(value=field))
        self._latch = made.emitter("latched", closed(value=SCHEMAS["byte"]), latched=True)
        for victim in ("victim", "second"):
            made.emitter(victim, closed(value=SCHEMAS["byte"]))
        made.emitter("producer", closed(value=SCHEMAS["byte"]))
        for taker in ("consumer", "third"):
            made.taker(taker, closed(value=SCHEMAS["byte"]))
        value = closed(value=SCHEMAS["byte"])
        made.service("double", value, value, lambda asked: {"value": 2 * asked["value"]})
        made.service("broken", value, value, self._fail)
        made.service("silent", value, value, self._hold)
        text = closed(value=SCHEMAS["text"])
        made.service("length", text, value, lambda asked: {"value": len(asked["value"])})
        return made

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("nowhere", Role.OUTPUT)

    @property
    def made(self) -> MemoryBridge:
        assert self._made is not None
        return self._made

    def victims(self) -> list[Victim]:
        return [
            Victim(at(name, Role.OUTPUT), partial(self.made.die, name))
            for name in ("victim", "second")
        ]

    def broken(self) -> bool:
        self.made.cut()
        return True

    def mended(self) -> None:
        self.made.mend()

    def unreadable(self, kind: str) -> Callable[[], object]:
        return lambda: self._loops[kind].emit_native(("garbled", "beyond", "repair"))

    def samples(self, kind: str) -> Sequence[Message]:
        made: dict[str, list[object]] = {
            "byte": [0, 255],
            "text": ["", "Kia ora \u2192 \U0001f916\r\n\t\0"],
            "number": [-0.0, 5e-324, 1.7976931348623157e308],
            "list": [[], [True, False] * 1000],
            "octets": [b"", bytes(range(256)) * 8192],
        }
        return [{"value": value} for value in made[kind]]

    def retained(self) -> Retained:
        def emit() -> Message:
            assert self._latch is not None
            self._latch.emit({"value": 7})
            return {"value": 7}

        return Retained(at("latched", Role.OUTPUT), emit)

    def served(self) -> Served:
        names = ("double", "broken", "silent")
        double, failing, silent = (at(name, Role.SERVICE) for name in names)
        more = [({"value": n}, {"value": 2 * n}) for n in range(3)]
        text = at("length", Role.SERVICE), {"value": "Kia ora"}
        return Served(double, {"value": 21}, {"value": 42}, failing, silent, more, text)

    def servable(self) -> tuple[Endpoint, Endpoint]:
        return at("offered", Role.SERVICE), at("offered", Role.SERVICE)

    def linkable(self) -> Pair:
        return Pair(at("consumer", Role.INPUT), at("producer", Role.OUTPUT))

    def link_victims(self) -> list[LinkVictim]:
        one, another = self.linkable(), Pair(at("third", Role.INPUT), at("second", Role.OUTPUT))
        return [
            LinkVictim(one, one.sink, partial(self.made.die, "consumer")),
            LinkVictim(another, another.source, partial(self.made.die, "second")),
        ]

    def close(self) -> None:
        self._hang.release()

    def _fail(self, _: Any) -> Any:
        raise RuntimeError("the service is broken")

    def _hold(self, _: Any) -> Any:
        self._hang.wait()


def check(address: tuple[str, ...], options: Options) -> str:
    """Say what is wrong with an address or its options."""
    if options:
        return f"there are no options, got {list(options)}"
    return "" if len(address) == 1 else "expected one name"


def at(name: str, role: Role) -> Endpoint:
    return Endpoint("memory", name, role, (name,))


class TestMemoryBridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(SCHEMAS)

    @pytest.fixture
    def world(self) -> MemoryWorld:
        return MemoryWorld()
