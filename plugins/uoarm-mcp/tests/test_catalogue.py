# mypy: disable-error-code="union-attr"
"""Which tools and streams there are: made once, for what provides a function now."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from typing import Any

import pytest
from agents import Agents
from components import CONFIGURATION, script
from mcp.client.client import Client
from mcp.shared.exceptions import MCPError
from uoarm_mcp._catalogue import CatalogueMaker

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import BridgeError
from uoarm.model import Plan
from uoarm.server import Server, ServerOptions
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


async def _pages(client: Client, method: str, part: str) -> list[list[str]]:
    pages: list[list[str]] = []
    cursor = None
    while cursor is not None or not pages:
        page = await getattr(client, method)(cursor=cursor)
        pages.append([item.name for item in getattr(page, part)])
        cursor = page.next_cursor
    return pages


def test_long_lists_have_pages(agents: Agents, monkeypatch: pytest.MonkeyPatch) -> None:
    client = agents.client()
    for method, part in (("list_tools", "tools"), ("list_resources", "resources")):
        monkeypatch.setattr("uoarm_mcp._service._PAGE", 50)
        (names,) = agents.run(_pages(client, method, part))
        monkeypatch.setattr("uoarm_mcp._service._PAGE", 3)
        pages = agents.run(_pages(client, method, part))
        assert [name for page in pages for name in page] == names
        assert {len(page) for page in pages[:-1]} == {3}
        with pytest.raises(MCPError, match="cursor: there is no 'x'; list anew"):
            agents.run(getattr(client, method)(cursor="x"))


def test_the_tools_of_a_large_robot_are_on_the_first_page(
    agents: Agents, robot: RobotManager
) -> None:
    functions = "".join(
        f"  f{count}:\n    components:\n      - {{name: c{count}, bridge: python, "
        "service: {endpoint: ['components:add']}}\n"
        for count in range(200)
    )
    text = f"version: 1\nbridges: {{python: {{}}}}\nfunctions:\n{functions}"
    robot.apply(loads(text, origin=robot.config.origin))
    page = agents.run(agents.client().list_tools())
    assert {f"f{count}" for count in range(200)} <= {tool.name for tool in page.tools}


async def test_what_was_made_of_what_was_before_is_not_kept(
    robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.apply(loads(NAMESAKES, origin=robot.config.origin))
    server = Server(robot, ServerOptions(port=0))
    await server.start()
    try:
        resolve, gate, sought = server.backend.resolve, asyncio.Event(), list[str]()

        async def gated(name: str) -> Plan:
            sought.append(name)
            plan = await resolve(name)
            await gate.wait()
            return plan

        monkeypatch.setattr(server.backend, "resolve", gated)
        maker = CatalogueMaker(server.backend, lambda: None)
        role = server.stateless_clients.local("").role
        making = asyncio.ensure_future(maker.of(role))
        while len(sought) < 2:  # noqa: ASYNC110 - until both are begun with
            await asyncio.sleep(0)
        maker.forget("numbers")
        gate.set()
        await making
        assert "read_numbers" in (await maker.of(role)).tools
        assert sought.count("numbers") == 2, "another component may provide it now"
    finally:
        await server.stop()
