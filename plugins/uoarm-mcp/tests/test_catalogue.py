# mypy: disable-error-code="union-attr"
"""Which tools and streams there are: made once, for what provides a function now."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

import pytest
from agents import Agents
from components import CONFIGURATION, script
from uoarm_mcp._catalogue import CatalogueMaker

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import BridgeError
from uoarm.testing import wait

NAMESAKES = """
version: 1
bridges: {python: {}}
functions:
  read_numbers:
    components:
      - {name: adder, bridge: python, service: {endpoint: ["components:add"]}}
  numbers:
    components:
      - {name: numbers, bridge: python, output: {endpoint: ["components:numbers"]}}
"""
SPARE = """      - name: first
        bridge: python
        priority: 2
        service: {endpoint: ["components:broken"]}
      - {name: adder, bridge: python, service: {endpoint: ["components:add"]}}
"""


def test_a_stream_is_read_though_another_tool_has_the_name_of_its_own(
    agents: Agents, robot: RobotManager
) -> None:
    robot.apply(loads(NAMESAKES, origin=robot.config.origin))
    script.numbers.put({"value": 7})
    read = agents.run(agents.client().read_resource("uoarm://stream/numbers"))
    assert json.loads(read.contents[0].text) == {"value": 7}


def test_a_tool_is_made_once_though_another_function_has_no_plan(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "missing" in agents.facts("status")["left_out"]

    def tools(*_: Any) -> None:
        raise AssertionError("a tool is made again")

    monkeypatch.setattr(CatalogueMaker, "_tools", tools)
    assert agents.facts("add", {"a": 1, "b": 2})["result"] == {"value": 3}


def test_after_a_takeover_a_tool_takes_what_the_other_component_takes(
    agents: Agents, robot: RobotManager
) -> None:
    before, _, after = CONFIGURATION.partition("  diary:\n")
    text = f"{before[: before.index('      - {name: adder')]}{SPARE}  diary:\n{after}"
    robot.apply(loads(text, origin=robot.config.origin))

    def taken() -> set[str]:
        tools = agents.run(agents.client().list_tools()).tools
        (add,) = (tool for tool in tools if tool.name == "add")
        return set(add.input_schema["properties"]) - {"x-approval"}

    def has_taken_over() -> bool:
        with suppress(BridgeError):
            robot.call("add", {"value": 1})
        return robot.resolve("add").provider.component.name == "adder"

    assert taken() == {"value"}
    wait(has_taken_over, "the spare takes over")
    wait(lambda: taken() == {"a", "b"}, "the tool is that of the spare")
