"""The world of the conformance kit: one component in another process that sends back what comes."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from endpoints import ANSWERS, Start
from peers import Peer
from uoarm_rtm._shape import IdlScalar, IdlSequence, IdlStruct, IdlUnion, Shape
from uoarm_rtm._types import Types

from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing import patience
from uoarm.testing.conformance import LinkVictim, Pair, Served, Victim, World

HERE = Path(__file__).parent
IDL, TYPES_IDL = str(HERE / "service.idl"), str(HERE / "types.idl")
KINDS = {
    "long": "IDL:RTC/TimedLong:1.0",
    "text": "IDL:RTC/TimedStringSeq:1.0",
    "numbers": "IDL:RTC/TimedFloatSeq:1.0",
    "image": "IDL:RTC/CameraImage:1.0",
    "ranges": "IDL:RTC/RangeData:1.0",
    "mixed": "IDL:Odd/Mixed:1.0",
    "union": "IDL:Odd/ByNumber:1.0",
    "buffered": "IDL:RTC/TimedLong:1.0",
    "pulled": "IDL:RTC/TimedLong:1.0",
}
NUMBERS = itertools.count()
# Of the two last kinds: a buffer of ours before the InPort, so that `send` waits for nothing; and
# InPorts that ask for each message, both ways.
LONG_BUFFER = {"length": 10_000, "empty_policy": "do_nothing"}
PULLED = {"flow": "pull", "rate": 500.0, "outport_buffer": LONG_BUFFER}
OPTIONS: dict[str, dict[str, Any]] = {
    "buffered": {"subscription": "new", "push_policy": "all", "outport_buffer": LONG_BUFFER},
    "pulled": PULLED,
}


@lru_cache
def types() -> Types:
    return Types([TYPES_IDL])


class RtmWorld(World):
    """Ports of its own, of a component in another process.

    What that component still sends when a test ends reaches no other one, since each world has
    ports of its own.

    Args:
        nameserver: of all components.
        loop: the component `Loop`, of several tests.
        start: starts a component for one test alone.
    """

    def __init__(self, nameserver: str, loop: Peer, start: Start) -> None:
        self._nameserver = nameserver
        self._loop = loop
        self._start = start
        self._number = next(NUMBERS)
        self._loops: set[str] = set()

    def close(self) -> None:
        """Remove the ports of this world."""
        for kind in self._loops:
            self._loop.end_loop(self._name(kind))

    def spec(self) -> BridgeSpec:
        # Ten checks a second took 2 % of a quiet processor, where 5 % of a busy one are allowed.
        limits = {"watch": 0.25, "call_timeout": ANSWERS}
        options = {"nameserver": self._nameserver, "idl": [IDL, TYPES_IDL], **limits}
        return BridgeSpec("rtm", "rtm", options, {})

    def pair(self, kind: str) -> Pair:
        name = self._name(kind)
        if kind not in self._loops:
            self._loops.add(kind)
            self._begin(kind)
        into = at(Role.INPUT, f"{name}_in", **OPTIONS.get(kind, {}))
        return Pair(into, at(Role.OUTPUT, f"{name}_out", **(PULLED if kind == "pulled" else {})))

    def _name(self, kind: str) -> str:
        return f"{kind}{self._number}"

    def _begin(self, kind: str) -> None:
        rate = PULLED["rate"] if kind == "pulled" else 0.0
        self._loop.loop(self._name(kind), KINDS[kind], rate)

    def missing(self) -> Endpoint:
        return Endpoint("rtm", "missing", Role.OUTPUT, ("Missing.rtc", "out"))

    def carried(self, kind: str, message: Message) -> Message:
        return rounded(types().codec(KINDS[kind]).shape, message)

    def takes(self, kind: str, message: Message) -> bool:
        """CORBA's strings cannot hold a zero, nor half a surrogate pair."""
        texts = list(strings(message)) if kind in {"text", "image", "union"} else []
        return not any("\0" in text or surrogate(text) for text in texts)

    def samples(self, kind: str) -> Sequence[Message]:
        tm = {"sec": 1, "nsec": 2}
        if kind == "numbers":
            return [{"tm": tm, "data": [math.nan, math.inf, -math.inf, 0.1]}]
        if kind == "text":
            return [{"tm": tm, "data": ["", "grüezi", "日本", "\U0001f916"]}]
        if kind == "image":
            pixels = bytes(range(256)) * 4096
            size = {"width": 1024, "height": 1024, "bpp": 8, "format": "mono8", "fDiv": 0.0}
            return [{"tm": tm, **size, "pixels": pixels}]
        if kind == "ranges":
            return [scan([math.nan, math.inf, 0.0, 1e300]), scan([0.25] * 100_000)]
        if kind == "mixed":
            least = {"a": 0, "b": -math.inf, "c": -(2**15), "d": math.nan, "e": -(2**63)}
            most = {"a": 255, "b": 5e-324, "c": 2**15 - 1, "d": 1e-45, "e": 2**63 - 1}
            return [{**least, "f": "\0", "g": 0}, {**most, "f": "\xff", "g": 2**64 - 1}]
        if kind == "union":
            stamped = {"tm": tm, "data": -1}
            return [{"switch": 5, "stamped": stamped}, {"switch": -(2**15), "others": []}]
        return [{"tm": tm, "data": data} for data in (-(2**31), 2**31 - 1)]

    def victim(self) -> Victim:
        return self._mortal("Mortal")

    def victims(self) -> Sequence[Victim]:
        return [self._mortal(f"Mortal{number}") for number in range(3)]

    def _mortal(self, name: str) -> Victim:
        component = self._start(name)
        return Victim(Endpoint("rtm", name, Role.OUTPUT, (f"{name}.rtc", "out")), component.kill)

    def broken(self) -> bool:
        """End the component without a word to any other process, as a kill does."""
        self._loop.vanish()
        return True

    def mended(self) -> None:
        self._loop.appear()
        begin_loop(self._loop)
        for kind in self._loops:
            self._begin(kind)

    def unreadable(self, kind: str) -> Callable[[], object]:
        return lambda: self._loop.emit_octets(self._name(kind), "ff")

    def served(self) -> Served:
        request = {"target": {"x": 0.5, "y": 0.0}, "steps": 3}
        reply = {"return": 0.5, "steps": 4, "path": [1.0]}
        limit = {"timeout": patience()}  # longer than the kit's own
        service, failing, silent, echo = (
            Endpoint(
                "rtm", "loop", Role.SERVICE, ("Loop.rtc", "served", f"Mover::{name}"), options=limit
            )
            for name in ("move", "broken", "stuck", "echo")
        )
        text = echo, {"words": "Kia ora"}
        return Served(service, request, reply, failing, silent, text=text)

    def servable(self) -> tuple[Endpoint, Endpoint]:
        limit = {"timeout": patience()}
        offered, called = (
            Endpoint(
                "rtm", "offered", Role.SERVICE, (path, "offered", "Arm::Mover::echo"), options=limit
            )
            for path in ("self", "uoarm_rtm.rtc")
        )
        return offered, called

    def linkable(self) -> Pair:
        return self.pair("long")

    def link_victims(self) -> list[LinkVictim]:
        found = []
        for role in (Role.OUTPUT, Role.INPUT):
            source, sink = (self._start(f"{end}{role.value}") for end in ("From", "Into"))
            ends = Pair(
                Endpoint("rtm", "into", Role.INPUT, (f"Into{role.value}.rtc", "in")),
                Endpoint("rtm", "from", Role.OUTPUT, (f"From{role.value}.rtc", "out")),
            )
            dead, component = (ends.source, source) if role is Role.OUTPUT else (ends.sink, sink)
            found.append(LinkVictim(ends, dead, component.kill))
        return found


def begin_loop(component: Peer) -> None:
    """Give a component the service, and activate it."""
    component.provide(IDL, "Mover")
    component.activate()


def scan(ranges: list[float]) -> Message:
    """A message of a range finder; its pose and limits are zero."""
    structure = types().codec(KINDS["ranges"]).shape
    assert isinstance(structure, IdlStruct)
    return {**{field.name: zero(field.shape) for field in structure.fields}, "ranges": ranges}


def zero(shape: Shape) -> Message:
    if isinstance(shape, IdlStruct):
        return {field.name: zero(field.shape) for field in shape.fields}
    return 0 if isinstance(shape, IdlScalar) else []


def at(role: Role, port: str, **options: Any) -> Endpoint:
    return Endpoint("rtm", "loop", role, ("Loop.rtc", port), options=options)


def strings(message: Message) -> Any:
    if isinstance(message, str):
        yield message
    elif isinstance(message, dict):
        for item in message.values():
            yield from strings(item)
    elif isinstance(message, list):
        for item in message:
            yield from strings(item)


def surrogate(text: str) -> bool:
    return any(0xD800 <= ord(name) <= 0xDFFF for name in text)


def rounded(shape: Shape, value: Any) -> Any:
    """The message with every number as the float or double of its field has it."""
    if isinstance(shape, IdlStruct):
        return {field.name: rounded(field.shape, value[field.name]) for field in shape.fields}
    if isinstance(shape, IdlUnion):
        inner = {variant.name: variant.shape for variant in shape.variants}
        return {
            name: rounded(inner[name], item) if name in inner else item
            for name, item in value.items()
        }
    if isinstance(shape, IdlSequence) and not isinstance(value, bytes):
        return [rounded(shape.element, item) for item in value]
    if shape == IdlScalar("float"):
        return struct.unpack("f", struct.pack("f", value))[0]
    return float(value) if shape == IdlScalar("double") else value
