"""Real components: a suite that exercises whatever it finds at a naming service.

    make interop-rtm NAMESERVICE=localhost:2809

It connects every data port in every way and looks for what stays behind, sends an example to
every InPort, drives every component's lifecycle and puts it back, reads every configuration. It
is no part of the ordinary run: pytest collects it only by its name.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from uoarm.testing import wait

sys.path.insert(0, str(Path(__file__).parent))

from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm._shape import IdlEnum, IdlScalar, IdlSequence, IdlString, IdlStruct, IdlUnion, Shape

from uoarm.bridge import Bridge, Registry
from uoarm.errors import BridgeError
from uoarm.model import BridgeSpec, Endpoint, Message, Role

NAMESERVICE = os.environ.get("NAMESERVICE", "localhost:2809")
SETTLE_SECONDS = 1.0
WAYS: list[dict[str, Any]] = [
    {},
    {"subscription": "new"},
    {"subscription": "periodic", "rate": 50},
    {"subscription": "new", "push_policy": "all", "outport_buffer": {"full_policy": "do_nothing"}},
    {"subscription": "periodic", "rate": 50, "push_policy": "skip", "skip_count": 1},
    {"flow": "pull", "rate": 50},
    {"flow": "pull", "rate": 50, "outport_buffer": {"empty_policy": "do_nothing"}},
    {"flow": "pull", "rate": 50, "outport_buffer": {"empty_policy": "block", "read_timeout": 0.1}},
]
SENDING_WAYS: list[dict[str, Any]] = [
    {},
    {"subscription": "new", "push_policy": "fifo"},
    {"flow": "pull"},
    {"inport_buffer": {"length": 4, "full_policy": "block", "write_timeout": 0.5}},
]


def make() -> Bridge:
    options = {"nameserver": NAMESERVICE, "watch": 0}
    return Registry().create(BridgeSpec("interop", "rtm", options))


def found() -> list[tuple[Endpoint, bool]]:
    """Every endpoint there is, and whether its type is known."""
    bridge = make()
    try:
        return [
            (at, what.message is not None)
            for component in bridge.discover(timeout=30)
            for at, what in component.endpoints
        ]
    finally:
        bridge.close()


FOUND = found()


def of(role: Role, port: str = "") -> list[Any]:
    return [
        pytest.param(at, id="/".join(at.address[:2]))
        for at, known in FOUND
        if at.role is role
        and (at.address[1] == port if port else known and not at.address[1].startswith("@"))
    ]


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    made = make()
    yield made
    made.close()


def with_options(at: Endpoint, options: dict[str, Any]) -> Endpoint:
    return Endpoint(at.bridge, at.component, at.role, at.address, at.port, options)


def lifecycle_of(at: Endpoint) -> Endpoint:
    return Endpoint(at.bridge, at.component, Role.SERVICE, (at.address[0], "@lifecycle"))


def connectors(bridge: Any, at: Endpoint) -> int:
    peer = bridge._directory.peer(at.address[0])
    return len(peer.port(at.address[1]).reference.get_connector_profiles())


def example(shape: Shape) -> Message:
    """The plainest message of a type."""
    if isinstance(shape, IdlStruct):
        return {field.name: example(field.shape) for field in shape.fields}
    if isinstance(shape, IdlSequence):
        if shape.element == IdlScalar("octet"):
            return bytes(shape.size or 0) if shape.fixed else b""
        return [example(shape.element)] * (shape.size or 0) if shape.fixed else []
    if isinstance(shape, IdlUnion):
        variant = next(item for item in shape.variants if item.labels)
        return {"switch": variant.labels[0], variant.name: example(variant.shape)}
    if isinstance(shape, IdlEnum):
        return shape.labels[0]
    if isinstance(shape, IdlString):
        return ""
    plain = {"boolean": False, "char": "a", "wchar": "a", "float": 0.0, "double": 0.0}
    return plain.get(shape.name, 0)


def test_there_is_something_to_exercise() -> None:
    assert FOUND, f"no component answers at {NAMESERVICE}"


@pytest.mark.parametrize("options", WAYS, ids=str)
@pytest.mark.parametrize("at", of(Role.OUTPUT))
def test_an_out_port_connects_delivers_and_lets_go(
    bridge: Bridge, at: Endpoint, options: dict[str, Any]
) -> None:
    before = connectors(bridge, at)
    inbox = Inbox()
    ours = with_options(at, {**options, "activate": True})
    structure = bridge.describe(ours).message
    assert structure is not None
    channel = bridge.open_source(ours, structure, inbox)
    assert connectors(bridge, at) == before + 1
    deadline = time.monotonic() + SETTLE_SECONDS
    while not inbox.messages and time.monotonic() < deadline:
        time.sleep(0.02)
    channel.close()
    assert connectors(bridge, at) == before
    assert channel.unreadable == 0


@pytest.mark.parametrize("options", SENDING_WAYS, ids=str)
@pytest.mark.parametrize("at", of(Role.INPUT))
def test_an_in_port_takes_a_message_and_lets_go(
    bridge: Any, at: Endpoint, options: dict[str, Any]
) -> None:
    before = connectors(bridge, at)
    ours = with_options(at, {**options, "activate": True})
    structure = bridge.describe(ours).message
    sink = bridge.open_sink(ours, structure)
    sink.send(example(bridge._types.codec(at.address[2]).shape))
    sink.close()
    assert connectors(bridge, at) == before


@pytest.mark.parametrize("at", of(Role.INPUT))
def test_a_full_buffer_of_an_inactive_component_says_so(bridge: Any, at: Endpoint) -> None:
    if bridge.call(lifecycle_of(at), {"action": "state"})["state"] != "inactive":
        pytest.skip("the component is not inactive")
    ours = with_options(at, {"inport_buffer": {"length": 2, "full_policy": "do_nothing"}})
    sink = bridge.open_sink(ours, bridge.describe(ours).message)
    message = example(bridge._types.codec(at.address[2]).shape)

    def fill() -> None:
        for _ in range(20):
            sink.send(message)

    with pytest.raises(BridgeError, match="BUFFER_FULL"):
        fill()
    sink.close()
    # An InPort of OpenRTM has one buffer for all its connections: leave it as it usually is.
    usual = with_options(at, {"inport_buffer": {"length": 8, "full_policy": "overwrite"}})
    bridge.open_sink(usual, bridge.describe(usual).message).close()


@pytest.mark.parametrize("at", of(Role.OUTPUT) + of(Role.INPUT))
def test_a_refused_connection_leaves_nothing_behind(bridge: Bridge, at: Endpoint) -> None:
    before = connectors(bridge, at)
    wrong = with_options(at, {"properties": {"dataport.dataflow_type": "sideways"}})
    structure = bridge.describe(wrong).message
    assert structure is not None
    with pytest.raises(BridgeError, match="refuses to connect"):
        _ = (
            bridge.open_source(wrong, structure, Inbox())
            if at.role is Role.OUTPUT
            else bridge.open_sink(wrong, structure)
        )
    assert connectors(bridge, at) == before


@pytest.mark.parametrize("at", of(Role.SERVICE, "@lifecycle"))
def test_a_lifecycle_goes_round(bridge: Bridge, at: Endpoint) -> None:
    begun = bridge.call(at, {"action": "state"})["state"]
    if begun not in {"active", "inactive"}:
        pytest.skip(f"the component is {begun}")
    round_trip = ["deactivate", "activate"] if begun == "active" else ["activate", "deactivate"]
    try:
        for action in round_trip:
            bridge.call(at, {"action": action})
    except BridgeError as error:
        # One that waits for a key in `on_execute` cannot be deactivated before that returns.
        assert "it answers RTC_ERROR and is still active" in str(error)
        pytest.skip(str(error))
    wait(lambda: bridge.call(at, {"action": "state"})["state"] == begun)


@pytest.mark.parametrize("at", of(Role.SERVICE, "@configuration"))
def test_configuration_sets_are_read(bridge: Bridge, at: Endpoint) -> None:
    reply = bridge.call(at, {})
    assert reply["active"] in {"", *reply["sets"]}
