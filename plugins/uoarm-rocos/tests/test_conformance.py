"""The plugin passes the suite that every bridge passes, over TCP and over a real tty."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from rigs import QUICK, endpoint, served
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    BooleanField,
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
)
from uoarm_rocos.simulate import Job

from uoarm._host import RemoteBridge
from uoarm.bridge import Bridge, Registry
from uoarm.model import BridgeSpec, Endpoint, Message
from uoarm.testing import patience
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
VALUE: Fields = {"value": NamedField(IntegerField(-1000, 1000))}


def fields_of(kind: str) -> Fields:
    return {name: NamedField(field, name != "short") for name, field in KINDS[kind].items()}


class Mirror:
    """What comes in on a flow goes out on it; `double` doubles, `broken` fails, `silent` waits."""

    def __init__(self) -> None:
        apis = {kind: Api(kind, ApiKind.FLOW, fields_of(kind), fields_of(kind)) for kind in KINDS}
        for name in ("double", "broken", "silent"):
            apis[name] = Api(name, ApiKind.SERVICE, VALUE, VALUE)
        self.catalogue = DeviceCatalogue("mirror", apis)
        self._came: list[tuple[str, dict[str, Any]]] = []

    def call(self, api: str, values: dict[str, Any], now: float) -> dict[str, Any] | Job:
        del now
        if api == "broken":
            raise ValueError("the service is broken")
        if api == "silent":
            return lambda now: None
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


class RocosWorld(World):
    """One mirror that lasts, and one that can be killed."""

    def __init__(self, kind: str, *, hosted: bool = False) -> None:
        self._hosted = hosted
        self._lasting, self._mortal = ExitStack(), ExitStack()
        urls = {
            "mirror": self._lasting.enter_context(served(Mirror(), kind)),
            "mortal": self._mortal.enter_context(served(Mirror(), kind)),
        }
        self._options = {
            "devices": {name: {**QUICK, "url": url, "grace": 0.2} for name, url in urls.items()}
        }

    def bridge(self) -> Bridge:
        if self._hosted:
            host = {"silence": patience(), "start": patience()}
            return RemoteBridge(BridgeSpec("rocos", "rocos", self._options, host))
        return Registry().create(BridgeSpec("rocos", "rocos", self._options))

    def pair(self, kind: str) -> Pair:
        return Pair(endpoint("mirror", kind, "input"), endpoint("mirror", kind))

    def missing(self) -> Endpoint:
        return endpoint("mirror", "nowhere")

    def carried(self, kind: str, message: Message) -> Message:
        if kind != "number":
            return message
        return {name: float(value) for name, value in message.items()}

    def samples(self, kind: str) -> list[Message]:
        if kind == "number":
            return [{"value": 5e-324, "open": float("nan")}, {"value": -0.0, "open": float("inf")}]
        if kind == "octets":
            return [{"image": bytes(range(256))}, {"image": b""}, {"image": b"\x7e\x7d" * 900}]
        return [{"text": "Kia ora \u2192 \U0001f916\r\n\t ]]> <&\0"}] if kind == "text" else []

    def victim(self) -> Victim:
        return Victim(endpoint("mortal", "integers"), self._mortal.close)

    def served(self) -> Served:
        services = [endpoint("mirror", name, "service") for name in ("double", "broken", "silent")]
        return Served(services[0], {"value": 21}, {"value": 42}, services[1], services[2])

    def close(self) -> None:
        self._mortal.close()
        self._lasting.close()


class TestOverTcp(BridgeConformance):
    """The whole suite over TCP."""

    kinds = tuple(KINDS)

    @pytest.fixture
    def world(self) -> Iterator[World]:
        made = RocosWorld("tcp")
        yield made
        made.close()


class TestInAHost(BridgeConformance):
    """The whole suite with the bridge in a process of its own."""

    kinds = ("octets", "text")

    @pytest.fixture
    def world(self) -> Iterator[World]:
        made = RocosWorld("tcp", hosted=True)
        yield made
        made.close()


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
