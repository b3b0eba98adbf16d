"""Types whose package is not installed: known from the descriptions of their nodes."""

from __future__ import annotations

import sys
from typing import Any

import pytest
from endpoints import Start, endpoint, known, sink, source
from messages import same
from peers import DOMAIN
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2 import _type_finder
from uoarm_ros2._middleware import Participant, untyped_class
from uoarm_ros2._middleware import Peer as End_
from uoarm_ros2._qos import Policies
from uoarm_ros2._type_finder import DefinedTypes, described_type

from uoarm.bridge import Bridge, Description
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Role
from uoarm.testing import patience

SEQUENCES = "test_msgs/msg/UnboundedSequences"


@pytest.fixture
def uninstalled(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if test_msgs were not installed here; peers have it."""
    for name in [module for module in sys.modules if module.split(".")[0] == "test_msgs"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "test_msgs", None)


@pytest.mark.usefixtures("uninstalled")
def test_a_type_that_is_not_installed_is_used_both_ways(bridge: Bridge, peer: Start) -> None:
    there = peer("there", "threads")
    there.do("pass_on", come="/come", go="/go", kind=SEQUENCES.rsplit("/", 1)[1])
    known(bridge, "/there")
    at = endpoint(Role.INPUT, "/come", SEQUENCES)
    structure = bridge.describe(at).message
    assert structure is not None
    assert structure.native_type == SEQUENCES
    inbox = Inbox()
    source(bridge, endpoint(Role.OUTPUT, "/go"), inbox)
    out = sink(bridge, at)
    schema: Any = structure.schema
    message: dict[str, Any] = {name: [] for name in schema["properties"]}
    message |= {
        "alignment_check": 7,
        "string_values": ["a", "\N{SNOWMAN}"],
        "float64_values": [0.5],
        "bool_values": [True],
        "byte_values": [1, 2],
        "basic_types_values": [_basic(schema["properties"]["basic_types_values"]["items"])],
    }
    out.send(message)
    assert same(inbox.wait_for(1)[0], message)
    with pytest.raises(MessageError, match="alignment_check"):
        out.send({**message, "alignment_check": "seven"})
    (found,) = [component for component in bridge.discover() if component.name == "/there"]
    assert {item.port for item, report in found.endpoints if report.message} >= {"come", "go"}


def _basic(schema: Any) -> dict[str, object]:
    made = {"boolean": True, "integer": 3, "number": 0.25}
    return {name: made[kind["type"]] for name, kind in schema["properties"].items()}


@pytest.mark.usefixtures("uninstalled")
def test_a_type_that_no_node_describes_says_what_to_install(bridge: Bridge, peer: Start) -> None:
    there = peer("there", "silent")
    there.do("pass_on", come="/come", go="/go", kind="Strings")
    known(bridge, "/there", bare=True)
    with pytest.raises(
        BridgeError, match=r"install ros-.*there is no service.*option definitions"
    ) as raised:
        bridge.describe(endpoint(Role.INPUT, "/come", "test_msgs/msg/Strings"))
    assert raised.value.reason is FailureReason.NOT_FOUND


def description(**changes: Any) -> Any:
    kind = {"type_id": 2, "capacity": 0, "string_capacity": 0, "nested_type_name": "", **changes}
    field = {"name": kind.pop("name", "x"), "type": kind, "default_value": ""}
    own = {"type_name": "a/msg/B", "fields": [field]}
    return {"type_description": own, "referenced_type_descriptions": []}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"name": "x: __import__('os')"}, "a field is called"),
        ({"type_id": 1, "nested_type_name": "a/msg/C"}, "a/msg/C is not in it"),
        ({"type_id": 1, "nested_type_name": "a/msg/B"}, "nested more than 32 deep"),
        ({"type_id": 12}, "type number 12"),
        ({"type_id": 0}, "type number 0"),
    ],
)
def test_a_description_is_checked_before_it_is_used(changes: Any, words: str) -> None:
    with pytest.raises(BridgeError, match=words):
        described_type(description(**changes), "a/msg/B", "")


def test_a_description_of_too_much_is_refused() -> None:
    whole = description()
    whole["type_description"]["fields"] *= 5000
    with pytest.raises(BridgeError, match="more than 4096 fields"):
        described_type(whole, "a/msg/B", "")


def test_types_that_nodes_describe_have_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a class is made of is never given back, so that forgetting one would give no room."""
    monkeypatch.setattr(_type_finder, "_MOST_KEPT", 1)
    names = ["a/msg/B", "a/msg/C"]
    peers = [End_("/n", name, Policies(), b"", f"RIHS01_{64 * 'a'}") for name in names]

    def ask(node: str, request: Any) -> Any:
        whole = description()
        whole["type_description"]["type_name"] = request["type_name"]
        return {"successful": True, "type_description": whole}

    finder = _type_finder.TypeFinder(ask, lambda _: peers, DefinedTypes([]))
    made = finder.find("a/msg/B", "/t")
    with pytest.raises(BridgeError, match="1 types are known from nodes already"):
        finder.find("a/msg/C", "/t")
    assert finder.find("a/msg/B", "/t") is made


def test_a_type_of_bare_dds_has_no_structure(bridge: Bridge) -> None:
    """ROS 2 shows types of programs on bare DDS, whose names have any number of parts."""
    participant = Participant(DOMAIN, "")
    try:
        runner = participant.start_node("bare")
        native = untyped_class("vendor::arm/types/State", "", {"__slots__": ()})
        runner.advertise(native, "/state", Policies(), events={})
        known(bridge, "/bare")
        [found] = [component for component in bridge.discover() if component.name == "/bare"]
        [(at, description)] = found.endpoints
        assert at.address == ("/state", "vendor/arm/types/State")
        assert description == Description()
        assert "type 'vendor/arm/types/State' is not spelt package/msg/Name" in found.detail
        with pytest.raises(BridgeError, match="is not spelt package/msg/Name"):
            bridge.describe(endpoint(Role.OUTPUT, "/state"))
    finally:
        participant.close(patience())
