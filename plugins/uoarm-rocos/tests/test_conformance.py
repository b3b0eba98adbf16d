"""The plugin passes the suite that every bridge passes, over TCP and over a real tty."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from rigs import QUICK, endpoint, line_end, on_cable, running, served
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    BooleanField,
    DataMessage,
    DeviceCatalogue,
    Field,
    Fields,
    IntegerField,
    ListField,
    NamedField,
    NumberField,
    OctetsField,
    StringField,
    StructField,
    WireMessage,
)
from uoarm_rocos._codec import XmlCodec
from uoarm_rocos._framing import SERIAL_LIMITS, TCP_LIMITS, LengthFramer, StuffedFramer
from uoarm_rocos.simulate import Job, ProfileServer

from uoarm.model import BridgeSpec, Endpoint, Message
from uoarm.testing import patience, slowness
from uoarm.testing.conformance import BridgeConformance, Pair, Served, Victim, World

POINT = StructField(
    {"x": NamedField(NumberField(-1e9, 1e9, "m")), "on": NamedField(BooleanField())}
)
KINDS: dict[str, dict[str, Field]] = {
    "integers": {
        "small": IntegerField(-128, 127),
        "large": IntegerField(),
        "choice": StringField(("one", "two")),
    },
    "text": {"text": StringField(), "short": StringField((), 3)},
    "number": {"value": NumberField(-1e308, 1e308), "open": NumberField(0.0, None, nonfinite=True)},
    "octets": {"image": OctetsField(2000)},
    "nested": {"points": ListField(POINT, 0, 4), "list": ListField(ListField(IntegerField(0, 9)))},
}
SAMPLES: dict[str, list[Any]] = {
    "integers": [{"small": -128, "large": 2**63 - 1, "choice": "two"}],
    "text": [{"text": "Kia ora \u2192 \U0001f916\r\n\t ]]> <&\0"}],
    "number": [{"value": 5e-324, "open": float("nan")}, {"value": -0.0, "open": float("inf")}],
    "octets": [{"image": bytes(range(256))}, {"image": b""}, {"image": b"\x7e\x7d" * 900}],
    "nested": [{"points": [{"x": -0.0, "on": True}] * 4, "list": [[], [0, 9]]}],
}
VALUE: Fields = {"value": NamedField(IntegerField(-1000, 1000))}


def fields_of(kind: str) -> Fields:
    return {name: NamedField(field, name != "short") for name, field in KINDS[kind].items()}


class Mirror:
    """What comes in on a flow goes out on it; `double` doubles, `broken` fails, `silent` waits.

    `length` takes text.
    """

    def __init__(self) -> None:
        apis = {kind: Api(kind, ApiKind.FLOW, fields_of(kind), fields_of(kind)) for kind in KINDS}
        for name in ("double", "broken", "silent"):
            apis[name] = Api(name, ApiKind.SERVICE, VALUE, VALUE)
        apis["length"] = Api("length", ApiKind.SERVICE, fields_of("text"), VALUE)
        # Nothing here ends by silence, which a busy machine is to these devices now and then.
        self.catalogue = DeviceCatalogue("mirror", apis, heartbeat=min(patience() / 3, 60.0))
        self._came: list[tuple[str, dict[str, Any]]] = []

    def call(self, api: str, values: dict[str, Any], now: float) -> dict[str, Any] | Job:
        del now
        if api == "broken":
            raise ValueError("the service is broken")
        if api == "silent":
            return lambda now: None
        if api == "length":
            return {"value": len(values["text"])}
        return {"value": 2 * values["value"]}

    def sample(self, api: str, now: float) -> dict[str, Any] | None:
        del api, now
        return None

    def events(self, now: float) -> list[tuple[str, dict[str, Any]]]:
        del now
        came, self._came = self._came, []
        return came

    def take(self, api: str, values: dict[str, Any], now: float) -> None:
        del now
        self._came.append((api, values))


class SpoiltCodec(XmlCodec):
    """Writes the next data with a field that the catalogue does not have, where it is asked to."""

    is_spoilt = False

    def write(self, message: WireMessage) -> bytes:
        if self.is_spoilt and isinstance(message, DataMessage):
            self.is_spoilt = False
            message = DataMessage(message.seq, message.id, {"no_such_field": 1}, message.time)
        return super().write(message)


class RocosWorld(World):
    """A mirror whose cable can be pulled out, and two that can be killed."""

    def __init__(self, kind: str) -> None:
        self._model, self._codec, self._plugged = Mirror(), SpoiltCodec(), threading.Event()
        self._plugged.set()
        end = on_cable(line_end(kind), self._plugged)
        self._longest = TCP_LIMITS.octets if end.framed else SERIAL_LIMITS.octets
        mirror = ProfileServer(self._model, LengthFramer if end.framed else StuffedFramer)
        mirror._codec = self._codec
        self._devices = {name: ExitStack() for name in ("mirror", "mortal", "fragile")}
        # What opens while the cable is out is refused after `wait`; what dies is lost soon.
        options = {"mirror": {**QUICK, "wait": 2 * slowness(), "grace": patience()}}
        options["mirror"]["url"] = self._devices["mirror"].enter_context(running(mirror, end))
        for name in ("mortal", "fragile"):
            url = self._devices[name].enter_context(served(Mirror(), kind))
            options[name] = {**QUICK, "url": url, "grace": 0.2}
        self._options: Any = {"devices": options}

    def spec(self) -> BridgeSpec:
        return BridgeSpec("rocos", "rocos", self._options)

    def pair(self, kind: str) -> Pair:
        return Pair(endpoint("mirror", kind, "input"), endpoint("mirror", kind))

    def missing(self) -> Endpoint:
        return endpoint("mirror", "nowhere")

    def takes(self, kind: str, message: Message) -> bool:
        return len(str(message)) < self._longest

    def carried(self, kind: str, message: Message) -> Message:
        if kind != "number":
            return message
        return {name: float(value) for name, value in message.items()}

    def samples(self, kind: str) -> list[Message]:
        return SAMPLES[kind]

    def victims(self) -> list[Victim]:
        return [
            Victim(endpoint(name, "integers"), self._devices[name].close)
            for name in ("mortal", "fragile")
        ]

    def broken(self) -> bool:
        self._plugged.clear()
        return True

    def mended(self) -> None:
        self._plugged.set()

    def unreadable(self, kind: str) -> Callable[[], object]:
        def emit() -> None:
            self._codec.is_spoilt = True
            self._model.take(kind, SAMPLES[kind][0], 0.0)

        return emit

    def served(self) -> Served:
        names = ("double", "broken", "silent")
        double, failing, silent = (endpoint("mirror", name, "service") for name in names)
        more = [({"value": number}, {"value": 2 * number}) for number in range(3)]
        text = endpoint("mirror", "length", "service"), {"text": "Kia ora"}
        return Served(double, {"value": 21}, {"value": 42}, failing, silent, more, text)

    def close(self) -> None:
        self._plugged.set()
        for stack in self._devices.values():
            stack.close()


class TestOverTcp(BridgeConformance):
    """The whole suite over TCP."""

    kinds = tuple(KINDS)

    @pytest.fixture
    def world(self) -> Iterator[World]:
        made = RocosWorld("tcp")
        yield made
        made.close()


class TestInAHost(TestOverTcp):
    """The whole suite with the bridge in a process of its own."""

    hosted = True
    kinds = ("integers", "octets")


class TestOverTty(BridgeConformance):
    """The whole suite over pseudo-terminals."""

    kinds = ("integers", "text", "octets")

    @pytest.fixture
    def world(self) -> Iterator[World]:
        made = RocosWorld("pty")
        yield made
        made.close()


def test_nothing_of_the_tests_is_left_running() -> None:
    names = {thread.name for thread in threading.enumerate()}
    assert not {name for name in names if name.startswith("uoarm-mirror")}
