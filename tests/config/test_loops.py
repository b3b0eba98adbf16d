"""Loops through topics: seen before anything runs, and none where there is none."""

from __future__ import annotations

from typing import Any

import pytest

from uoarm.bridge import Bridge, BridgeType
from uoarm.config import loads

HEAD = (
    "version: 1\nbridges: {net: {plugin: bus}, other: {plugin: bus, options: {n: 1}}, python: {}}\n"
)


def never(name: str, options: Any) -> Bridge:
    raise AssertionError(name)


BUS = BridgeType(
    "bus",
    "topics",
    never,
    bridge_options={"type": "object"},
    topic=lambda address, _: "" if address[0].startswith("one-way") else address[0],
    contract=2,
)


def component(name: str, *ports: str, bridge: str = "net") -> str:
    inner = "".join(f"        {port}\n" for port in ports)
    return f"  {name}:\n    components:\n      - name: {name}\n        bridge: {bridge}\n{inner}"


def into(address: str, source: str = "", more: str = "") -> str:
    fed = f"from: {source}, " if source else ""
    return f"input: {{{fed}endpoint: ['{address}']{more}}}"


def out(address: str) -> str:
    return f"output: {{endpoint: ['{address}']}}"


def warned(*parts: str) -> list[str]:
    robot = loads(HEAD + "functions:\n" + "".join(parts), types={"bus": BUS})
    return [warning for warning in robot.warnings if "without end" in warning]


def test_a_component_that_sends_where_it_listens() -> None:
    [warning] = warned(component("echo", into("/a"), out("/a")))
    assert "$.functions.echo.components[0]: a message would go round without end: " in warning
    assert "/a -> echo -> /a" in warning


def test_a_map_from_a_topic_to_itself() -> None:
    talker = component("talker", out("/a"))
    [warning] = warned(talker, component("relay", into("/a", "talker", ", map: {x: y}")))
    assert "$.functions.relay.components[0]: " in warning
    assert "/a -> /a" in warning


def test_a_round_through_plain_python() -> None:
    [warning] = warned(
        component("talker", out("/a")),
        component("step", into("m:step", "talker"), out("m:step"), bridge="python"),
        component("said", into("/a", "step")),
    )
    assert "/a -> step -> /a" in warning


def test_a_round_through_two_topics() -> None:
    [warning] = warned(
        component("one", into("/a"), out("/b")),
        component("two", into("/a", "one")),
    )
    assert "/a -> one -> /b -> /a" in warning


@pytest.mark.parametrize(
    "parts",
    [
        (component("talker", out("/a")), component("listener", into("/a", "talker"), out("/b"))),
        (component("echo", into("one-way"), out("one-way")),),
        (component("echo", into("/a"), out("/b")),),
        (
            component("here", out("/a")),
            component("there", into("/a", "here"), out("/b"), bridge="other"),
        ),
    ],
    ids=["connected by the framework", "no topics", "two topics", "two networks"],
)
def test_what_is_no_loop(parts: tuple[str, ...]) -> None:
    assert warned(*parts) == []


def test_two_bridges_of_one_network_make_a_loop() -> None:
    head = HEAD.replace(", options: {n: 1}", "")
    parts = component("here", out("/a")), component("there", into("/a", "here"), bridge="other")
    robot = loads(head + "functions:\n" + "".join(parts), types={"bus": BUS})
    assert any("/a -> /a" in warning for warning in robot.warnings)
