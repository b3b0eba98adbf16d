"""What is suggested for components in Python and for topics: each once, and as it is listed."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from uoarm import RobotManager
from uoarm.config import loads, suggest
from uoarm.config._suggestion import new_name
from uoarm.model import (
    BridgeFindings,
    Component,
    Endpoint,
    FoundComponent,
    FoundPort,
    MessageStructure,
    Robot,
    Role,
)


def camera(path: str = "", at: int = 0) -> Iterator[int]:
    """Look: a component."""
    while True:
        yield len(path) + at


def double(number: int, by: int = 2) -> int:
    """Return a number that many times: a component."""
    return number * by


HEAD = r"""
version: 1
bridges:
  python:
    options:
      discover:
        - {component: "here:camera", name: recorded, parameters: {path: "\U0001f600 \x7f\u2028"}}
        - {component: "here:camera", name: live, parameters: {at: 3}}
        - {component: "here:double", parameters: {by: 3}}
functions:
"""
RECORDED = r"""
  seen: {components: [{name: seen, bridge: python, output: {endpoint: ["here:camera"]},
    parameters: {path: "\U0001f600 \x7f\u2028"}}]}
"""
OTHER = """
  seen: {components: [{name: seen, bridge: python, output: {endpoint: ["here:camera"]}}]}
"""
CALLED = """
  twice: {components: [{name: twice, bridge: python, parameters: {by: 3},
    service: {endpoint: ["here:double"]}}]}
"""
STREAM = """
  twice: {components: [{name: twice, bridge: python, parameters: {by: 3},
    output: {endpoint: ["here:double"]}}]}
"""


def expected(text: str) -> Robot:
    """Read a configuration whose components are here."""
    return loads(text.replace("here:", f"{__name__}:"))


def suggested(functions: str) -> dict[str, Component]:
    """Return what a robot that reads the suggestion has, by the names of components."""
    robot = expected(HEAD + (functions or "  {}\n"))
    with RobotManager(robot) as manager:
        text = suggest(robot, manager.discover(), configured=robot.bridges)
    text = text[text.index("functions:") :]
    return {
        component.name: component
        for component in expected(HEAD.replace("functions:\n", text)).components()
    }


def test_parameters_that_discovery_states_are_suggested() -> None:
    found = suggested("")
    assert set(found) == {"recorded", "live", "double", "double_default"}
    assert found["recorded"].parameters == {"path": "\U0001f600 \x7f\u2028"}
    assert found["live"].parameters == {"at": 3}
    assert found["double"].parameters == found["double_default"].parameters == {"by": 3}


@pytest.mark.parametrize("used", [CALLED, STREAM])
def test_what_is_named_is_not_suggested_in_its_other_role(used: str) -> None:
    assert set(suggested(used)) == {"recorded", "live"}


def test_of_two_that_differ_in_parameters_the_one_that_is_named_is_used() -> None:
    assert set(suggested(RECORDED)) == {"live", "double", "double_default"}
    assert set(suggested(OTHER)) == {"double", "double_default"}, "its parameters are of neither"
    with RobotManager(expected(HEAD + RECORDED)) as manager:
        [findings] = manager.discover()
    assert f'output  {__name__}:camera  {{"at": 3}}\n' in str(findings)
    assert str(findings).count("used by seen") == 1


def test_a_subscriber_of_a_topic_is_not_fed_by_its_publisher() -> None:
    """It receives that already, and each message would come back without end."""
    number = MessageStructure({"type": "integer"})

    def node(name: str, role: Role, topic: str) -> FoundComponent:
        return FoundComponent(name, (FoundPort(Endpoint("net", name, role, (topic,)), number),))

    robot = loads("version: 1\nbridges: {net: {plugin: bus}}\nfunctions: {}\n")
    here, there = node("here", Role.OUTPUT, "/a"), node("there", Role.OUTPUT, "/b")
    ear = node("ear", Role.INPUT, "/a")
    alone = suggest(robot, [BridgeFindings("net", "bus", (here, ear))])
    assert "from:" not in alone
    both = suggest(robot, [BridgeFindings("net", "bus", (here, there, ear))])
    assert "{from: there, " in both


class _Names(dict[str, int]):
    """Counts how often it is asked for a name."""

    asked = 0

    def __contains__(self, name: object) -> bool:
        self.asked += 1
        return super().__contains__(name)


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_many_components_whose_names_are_written_alike_are_numbered_in_one_go(count: int) -> None:
    taken = _Names({"component_3": 1})
    names = [new_name(chr(0x3042 + number), taken) for number in range(count)]
    assert names[:4] == ["component", "component_2", "component_4", "component_5"]
    assert len(set(names)) == count
    assert taken.asked <= 3 * count
    assert new_name("component_2", taken) == "component_2_2"
