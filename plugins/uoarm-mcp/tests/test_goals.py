"""Actions as one tool: goals with handles, cancellations that reach them, ends that come once."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from agents import Agents
from components import script
from mcp_types import ResourceLink, TextResourceContents

from uoarm import RobotManager
from uoarm.testing import patience, wait


def began(agents: Agents) -> str:
    """Give the goal that waits, until its feedback has come; return its handle."""
    facts = agents.facts("plan", {"function": "walk", "arguments": {"value": 99}})
    assert (facts["tool"], facts["needs_approval"]) == ("walk", "")
    handle: list[str] = []

    async def give() -> None:
        result = await agents.client().call_tool("walk", {"value": 99})
        assert result.structured_content is not None
        handle.append(result.structured_content["handle"])

    agents.run(give())
    return handle[0]


def test_an_action_is_one_tool(agents: Agents) -> None:
    tools = {tool.name: tool for tool in agents.run(agents.client().list_tools()).tools}
    assert {name for name in tools if "walk" in name} == {"walk", "read_walk"}
    assert set(tools["walk"].input_schema["properties"]) == {"value", "x-approval"}
    assert "has a handle" in str(tools["walk"].description)


@pytest.mark.parametrize(("steps", "state"), [(3, "succeeded"), (13, "aborted")])
def test_a_goal_ends_in_the_word_of_the_action(agents: Agents, steps: int, state: str) -> None:
    facts: Any = agents.call("walk", {"value": steps}).structured_content
    assert (facts["state"], facts["result"]) == (state, {"walked": steps})
    assert facts["first_report"] is True
    again = agents.facts("goal_status", {"handle": facts["handle"]})
    assert (again["state"], again["first_report"]) == (state, False)


def test_a_goal_that_is_rejected_says_so(agents: Agents) -> None:
    assert "rejected the goal" in agents.refused("walk", {"value": -1})


def test_a_cancellation_reaches_the_action_and_the_end_is_reported_once(agents: Agents) -> None:
    handle = began(agents)
    shown = agents.facts("goal_status", {"handle": handle})
    assert (shown["state"], shown["feedback"]) == ("running", {"step": 1})
    ended = agents.facts("cancel", {"handle": handle})
    if ended["state"] == "running":  # it was asked for, and did not end at once
        ended = agents.facts("wait", {"handle": handle, "seconds": 30})
    assert (ended["state"], ended["result"]) == ("canceled", {"walked": 1})
    assert ended["first_report"] is True
    assert script.came == [{"value": 99}, {"goal_id": "1"}]
    assert agents.facts("goal_status", {"handle": handle})["first_report"] is False


def test_long_feedback_is_rendered_once_with_a_link_to_all_of_it(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm_mcp._actions._AT_ONCE_SECONDS", 0.0)
    handle = agents.facts("walk", {"value": 98})["handle"]
    wait(lambda: "feedback" in agents.facts("goal_status", {"handle": handle}), "it has come")

    def links() -> list[str]:
        content = agents.call("goal_status", {"handle": handle}).content
        return [part.uri for part in content if isinstance(part, ResourceLink)]

    first = links()
    assert len(first) == 1
    assert links() == first
    (part,) = agents.run(agents.client().read_resource(first[0])).contents
    assert isinstance(part, TextResourceContents)
    assert json.loads(part.text) == {"steps": [0.5] * 20_000}


@pytest.mark.parametrize("revision", ["legacy", "2026-07-28"])
def test_a_request_that_is_cancelled_cancels_what_it_began(
    agents: Agents, monkeypatch: pytest.MonkeyPatch, revision: str
) -> None:
    monkeypatch.setattr("uoarm_mcp._actions._AT_ONCE_SECONDS", patience())
    client = agents.client("agent", revision)

    async def give_up() -> None:
        asked = asyncio.ensure_future(client.call_tool("walk", {"value": 99}))
        await asyncio.to_thread(wait, lambda: script.came == [{"value": 99}], "it is begun")
        asked.cancel()
        await asyncio.wait({asked})

    agents.run(give_up())
    wait(lambda: {"goal_id": "1"} in script.came, "the action is cancelled")


def test_what_an_agent_began_is_cancelled_when_its_rights_end(
    agents: Agents, robot: RobotManager, access: Any
) -> None:
    began(agents)
    text = access.read_text(encoding="utf-8")
    access.write_text(text.replace("name: agent, role: agent", "name: agent, role: guest"))
    wait(lambda: {"goal_id": "1"} in script.came, "the goal is cancelled")
    wait(lambda: not robot.connections(), "the action is let go of")


def test_stop_cancels_what_the_agent_began(agents: Agents) -> None:
    handle = began(agents)
    assert agents.facts("stop")["cancelled"] == [handle]
    assert agents.facts("wait", {"handle": handle, "seconds": 30})["state"] == "canceled"


def test_an_action_that_moves_something_needs_an_approval_of_this_goal(agents: Agents) -> None:
    asked = agents.facts("press", {"value": 3})
    assert asked["state"] == "approval-needed"
    handle = asked["handle"]
    assert "is pending" in agents.refused("press", {"value": 3, "x-approval": handle})
    agents.approve(handle)
    assert "other arguments" in agents.refused("press", {"value": 4, "x-approval": handle})
    assert "above its limit 5" in agents.refused("press", {"value": 6, "x-approval": handle})
    assert script.came == []
    done = agents.facts("press", {"value": 3, "x-approval": handle})
    assert (done["state"], done["result"], done["handle"]) == ("succeeded", {"walked": 3}, handle)
    assert "is used" in agents.refused("press", {"value": 3, "x-approval": handle})
    assert script.came[:1] == [{"value": 3}]
    assert script.came.count({"value": 3}) == 1


def test_goals_of_two_agents_are_kept_apart(agents: Agents) -> None:
    mine = began(agents)
    theirs = agents.facts("walk", {"value": 5}, "other")
    assert (theirs["state"], theirs["result"]) == ("succeeded", {"walked": 5})
    assert "there is no goal" in agents.refused("cancel", {"handle": mine}, "other")
    assert agents.facts("cancel", {"handle": mine})["handle"] == mine
