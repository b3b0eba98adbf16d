"""Approvals through the protocol: what is asked for, given and done; and attacks on it."""

from __future__ import annotations

import asyncio
import threading
from contextlib import suppress
from typing import Any

import pytest
from agents import Agents
from attrs import evolve
from components import CONFIGURATION, script
from uoarm_mcp._actions import AgentActions

from uoarm import RobotManager
from uoarm.client import ServerError
from uoarm.config import loads
from uoarm.errors import BridgeError
from uoarm.testing import patience, wait

PRESS = {"pressure": 120.0}


def asked(agents: Agents, arguments: dict[str, Any] = PRESS, tool: str = "cuff") -> str:
    facts = agents.facts(tool, arguments)
    assert facts["state"] == "approval-needed"
    assert script.came == []
    return str(facts["handle"])


def press(agents: Agents, handle: str, pressure: float = 120.0, name: str = "agent") -> str:
    return agents.refused("cuff", {"pressure": pressure, "x-approval": handle}, name)


def test_another_principal_approves_and_it_is_done_once(agents: Agents) -> None:
    handle = asked(agents)
    waiting = agents.run(agents.remote().approvals())
    assert [(item["approval"], item["arguments"]) for item in waiting] == [(handle, PRESS)]
    assert waiting[0]["components"] == ["cuff"]
    assert "the arm cuff presses" in waiting[0]["preview"]
    decided = agents.approve(handle, digest=waiting[0]["digest"])
    assert (decided["phase"], decided["approver"]) == ("approved", "nurse")
    assert agents.facts("wait", {"handle": handle})["state"] == "approved"
    done = agents.facts("cuff", {**PRESS, "x-approval": handle})
    assert (done["state"], done["result"], done["handle"]) == ("succeeded", {"value": 120}, handle)
    assert script.came == [PRESS]
    assert "is used" in press(agents, handle)
    assert script.came == [PRESS]


def test_the_handle_of_the_plan_is_that_of_doing_it(agents: Agents) -> None:
    plan = agents.facts("plan", {"function": "cuff", "arguments": PRESS, "seconds": 120})
    assert plan["state"] == "approval-needed"
    agents.approve(plan["handle"])
    assert agents.facts("cuff", {**PRESS, "x-approval": plan["handle"]})["state"] == "succeeded"


def test_it_is_not_done_before_or_without_the_approval(agents: Agents) -> None:
    handle = asked(agents)
    assert "is pending" in press(agents, handle)
    agents.approve(handle, approve=False, cause="not on this arm")
    assert "is refused: not on this arm" in press(agents, handle)
    assert "there is no approval" in press(agents, "0123456789abcdef")
    assert script.came == []


def test_other_arguments_are_not_approved(agents: Agents) -> None:
    handle = asked(agents)
    agents.approve(handle)
    assert "other arguments" in press(agents, handle, 121.0)
    assert script.came == []


@pytest.mark.parametrize("name", ["own", "agent", "second"])
def test_the_same_principal_does_not_approve_whatever_token_it_shows(
    agents: Agents, name: str
) -> None:
    handle = asked(agents)
    with pytest.raises(ServerError, match=r"another principal|may give"):
        agents.approve(handle, name)
    assert "is pending" in press(agents, handle)
    assert script.came == []


def test_one_principal_does_not_use_what_another_one_asked_for(agents: Agents) -> None:
    handle = asked(agents)
    agents.approve(handle)
    assert "there is no approval" in press(agents, handle, name="other")
    assert script.came == []


def test_of_two_uses_at_one_time_one_is_done(agents: Agents) -> None:
    for number in range(1, 6):
        facts = agents.facts("cuff", PRESS)
        agents.approve(facts["handle"])
        client, second = agents.client(), agents.client("second")
        arguments = {**PRESS, "x-approval": facts["handle"]}

        async def race(clients: tuple[Any, ...], arguments: dict[str, Any]) -> list[bool]:
            results = await asyncio.gather(
                *(client.call_tool("cuff", arguments) for client in clients for _ in range(3))
            )
            return [result.is_error for result in results]

        refused = agents.run(race((client, second), arguments))
        assert refused.count(False) == 1
        assert len(script.came) == number


def test_a_reconfiguration_makes_it_void(agents: Agents, robot: RobotManager) -> None:
    before, after = asked(agents), asked(agents)
    agents.approve(before)
    text = CONFIGURATION.replace("description: the base", "description: another base")
    changed = text.replace("priority: 1\n", "priority: 0\n")
    robot.apply(loads(changed, origin=robot.config.origin))
    assert "is void" in press(agents, before)
    wait(
        lambda: agents.facts("goal_status", {"handle": after})["state"] == "void",
        "what waits is void, too",
    )
    with pytest.raises(ServerError, match="is void"):
        agents.approve(after)
    assert script.came == []


def test_a_takeover_makes_it_void(agents: Agents, robot: RobotManager) -> None:
    handle = asked(agents)
    agents.approve(handle)
    script.is_loose = True

    def has_taken_over() -> bool:
        with suppress(BridgeError):
            robot.call("cuff", {"pressure": 1.0})
        return robot.resolve("cuff").provider.component.name == "spare"

    wait(has_taken_over, "the spare cuff takes over")
    script.came.clear()
    assert "it would run spare, not cuff" in press(agents, handle)
    assert script.came == []


def test_what_is_marked_needs_one_too(agents: Agents) -> None:
    facts = agents.facts("diary", {"a": 1, "b": 2})
    assert facts["state"] == "approval-needed"
    agents.approve(facts["handle"])
    done = agents.facts("diary", {"a": 1, "b": 2, "x-approval": facts["handle"]})
    assert done["result"] == {"value": 3}


def test_an_envelope_allows_a_range_and_a_count(agents: Agents) -> None:
    envelope = {"ranges": {"pressure": [100.0, 140.0]}, "count": 2}
    plan = agents.facts("plan", {"function": "cuff", "arguments": PRESS, "envelope": envelope})
    handle = plan["handle"]
    agents.approve(handle)
    assert "other arguments" in press(agents, handle, 141.0)
    for pressure in (100.0, 140.0):
        done = agents.facts("cuff", {"pressure": pressure, "x-approval": handle})
        assert done["state"] == "succeeded"
    assert "is used" in press(agents, handle)
    assert script.came == [{"pressure": 100.0}, {"pressure": 140.0}]


def test_what_moves_stops_with_its_lifetime_though_the_agent_says_nothing_more(
    agents: Agents,
) -> None:
    facts = agents.facts("send_drive", {"speed": 0.5})
    assert facts["state"] == "approval-needed"
    agents.approve(facts["handle"])
    sent = agents.facts("send_drive", {"speed": 0.5, "x-approval": facts["handle"]})
    assert sent["state"] == "succeeded"
    wait(lambda: script.came[-1:] == [{"speed": 0.0}], "it is stopped")
    assert script.came[0] == {"speed": 0.5}


def test_what_moves_is_within_the_limits_of_its_input(agents: Agents) -> None:
    assert "speed: 2.0 is above its limit 1" in agents.refused("send_drive", {"speed": 2.0})
    assert agents.run(agents.remote().approvals()) == []
    assert script.came == []


def test_stop_stops_what_the_agent_moved(agents: Agents) -> None:
    facts = agents.facts("send_drive", {"speed": 0.5})
    agents.approve(facts["handle"])
    agents.facts("send_drive", {"speed": 0.5, "x-approval": facts["handle"]})
    # A command that waits in the queue still is never sent, and then nothing is to be stopped.
    wait(lambda: script.came == [{"speed": 0.5}], "it moves")
    assert agents.facts("stop")["stopped"] == ["drive.default"]
    wait(lambda: script.came[-1:] == [{"speed": 0.0}], "it is stopped")


def test_stop_stops_an_action_that_cannot_be_cancelled(agents: Agents, robot: RobotManager) -> None:
    before, _, press = CONFIGURATION.partition("  press:\n")
    press = press.replace('          cancel: {endpoint: ["components:Walker"]}\n', "", 1)
    text = f"{before}  press:\n{press.replace('maximum: 5', 'maximum: 99', 1)}"
    robot.apply(loads(text, origin=robot.config.origin))
    facts = agents.facts("press", {"value": 99})
    agents.approve(facts["handle"])
    agents.facts("press", {"value": 99, "x-approval": facts["handle"]})
    wait(lambda: script.came == [{"value": 99}], "it moves")
    assert agents.facts("stop") == {"stopped": ["press.goal"], "cancelled": []}
    wait(lambda: script.came == [{"value": 99}, {"value": 0}], "it is stopped")


def test_a_wait_that_ends_leaves_the_other_one_its_decision(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = asked(agents)
    client, nurse, waiting = agents.client(), agents.remote(), threading.Event()

    async def without_limit(seconds: float, event: asyncio.Event) -> None:
        if seconds:
            waiting.set()
            await event.wait()

    monkeypatch.setattr("uoarm_mcp._robot_tools.within", without_limit)

    async def wait_twice() -> Any:
        long = asyncio.ensure_future(client.call_tool("wait", {"handle": handle, "seconds": 30}))
        await asyncio.to_thread(waiting.wait, patience())
        await client.call_tool("wait", {"handle": handle, "seconds": 0})
        await nurse.approve(handle)
        return await long

    assert agents.run(wait_twice()).structured_content["state"] == "approved"


def test_an_approval_is_not_spent_where_no_more_work_may_begin(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = asked(agents)
    agents.approve(handle)
    with monkeypatch.context() as patched:
        patched.setattr("uoarm_mcp._actions._MOST_RUNNING", 0)
        assert "wait for one of them first" in press(agents, handle)
    assert agents.facts("cuff", {**PRESS, "x-approval": handle})["state"] == "succeeded"


def test_what_is_opened_is_what_was_approved(
    agents: Agents, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = CONFIGURATION.replace("  numbers:\n", "  numbers:\n    approve: true\n")
    robot.apply(loads(text, origin=robot.config.origin))
    facts = agents.facts("read_numbers", {"seconds": 0})
    agents.approve(facts["handle"])
    # Between the use of the approval and the opening another component takes over.
    checked = AgentActions.check_foundation

    def check(actions: AgentActions, made: Any, request: Any, plan: Any) -> None:
        taken_over = evolve(request.foundation, components=("another",))
        checked(actions, made, evolve(request, foundation=taken_over), plan)

    monkeypatch.setattr(AgentActions, "check_foundation", check)
    text = agents.refused("read_numbers", {"seconds": 0, "x-approval": facts["handle"]})
    assert "runs numbers, which was not approved" in text
    assert agents.facts("status")["open"] == []


def test_without_an_access_file_nothing_that_moves_can_be_done(serve: Any) -> None:
    server = serve()
    with Agents(server.ports, {}) as agents:
        handle = asked(agents)
        with pytest.raises(ServerError, match="another principal"):
            agents.approve(handle)
        assert "is pending" in press(agents, handle)
        assert "one principal" in agents.facts("status")["warnings"][0]
        assert agents.facts("add", {"a": 1, "b": 2})["result"] == {"value": 3}


def test_after_a_restart_nothing_is_approved(serve: Any, access: Any) -> None:
    from agents import TOKENS

    first = serve(access=access)
    with Agents(first.ports, TOKENS) as agents:
        handle = asked(agents)
        agents.approve(handle)
    again = serve(access=access)
    with Agents(again.ports, TOKENS) as agents:
        assert "there is no approval" in press(agents, handle)
    assert script.came == []
