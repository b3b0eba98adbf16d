# mypy: disable-error-code="union-attr,index,operator"
"""Tools and resources as the SDK's own client gets them, of each revision of the protocol."""

from __future__ import annotations

import asyncio
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import httpx2
import pytest
from agents import TOKENS, Agents, text_of
from components import script
from mcp.server.session import ServerSession
from mcp.shared.exceptions import MCPError
from uoarm_mcp import _actions, _http
from uoarm_mcp._streams import AgentStreams

from uoarm import RobotManager
from uoarm.model import LeaseHolder
from uoarm.server.front_end import FeedKey
from uoarm.testing import Script, patience, wait

MODES = ("auto", "legacy", "2026-07-28")


@pytest.mark.parametrize("mode", MODES)
def test_a_client_of_each_revision_lists_and_calls(agents: Agents, mode: str) -> None:
    client = agents.client("agent", mode)
    tools = {tool.name: tool for tool in agents.run(client.list_tools()).tools}
    assert {"add", "read_numbers", "cuff", "send_drive", "read_drive", "plan", "stop"} <= set(tools)
    assert "missing" not in str(sorted(tools))
    result = agents.run(client.call_tool("add", {"a": 1, "b": 2}))
    assert result.structured_content["state"] == "succeeded"
    assert result.structured_content["result"] == {"value": 3}


def test_tools_say_what_they_take_give_and_move(agents: Agents) -> None:
    tools = {tool.name: tool for tool in agents.run(agents.client().list_tools()).tools}
    add, cuff, read = tools["add"], tools["cuff"], tools["read_numbers"]
    assert add.description == "adds two numbers (Calls add.)"
    assert set(add.input_schema["properties"]) == {"a", "b", "x-approval"}
    assert add.output_schema["properties"]["result"]["properties"].keys() == {"value"}
    assert add.annotations.destructive_hint is False
    assert cuff.annotations.destructive_hint is True
    assert "Needs the approval of a person" in cuff.description
    assert tools["diary"].annotations.destructive_hint is True
    assert read.annotations.read_only_hint is True
    assert not any("publish" in name for name in tools)


def test_a_role_has_the_tools_of_its_rights_and_status_says_what_is_left_out(
    agents: Agents,
) -> None:
    names = {tool.name for tool in agents.run(agents.client("guest").list_tools()).tools}
    assert "read_numbers" in names
    assert not {"add", "cuff", "drive", "send_drive", "discover"} & names
    status = agents.facts("status", name="guest")
    assert status["left_out"] == {"add": "the role may not call add"}
    assert "cuff" not in json.dumps(status)
    with pytest.raises(MCPError, match="there is no tool 'add': the role may not call add"):
        agents.call("add", {"a": 1, "b": 2}, "guest")
    with pytest.raises(MCPError, match=r"there is no tool 'cuff' \(UOA-703\)$"):
        agents.call("cuff", {"pressure": 1}, "guest")
    assert script.came == []
    assert "has no 'nothing'" in agents.facts("status")["left_out"]["missing"]


@pytest.mark.parametrize(
    ("tool", "arguments", "text"),
    [
        ("add", {"a": 1}, "b"),
        ("add", {"a": 101, "b": 1}, "a"),
        ("add", {"a": "x", "b": 1}, "a"),
        ("add", {"a": 1, "b": 1, "x-approval": "x"}, "x-approval"),
        ("add", {"a": 1, "b": 1, "x-approval": 3}, "x-approval"),
        ("cuff", {"pressure": 301.0}, "pressure"),
        ("cuff", {"pressure": 301.0, "x-approval": "x"}, "pressure"),
        ("read_numbers", {"count": 0}, "count"),
        ("read_numbers", {"counts": 1}, "counts"),
        ("read_numbers", {"seconds": 31}, "seconds"),
        ("plan", {}, "function"),
        ("plan", {"function": "cuff", "arguments": {"pressure": "x"}}, "pressure"),
        ("wait", {"handle": "x", "seconds": "y"}, "seconds"),
    ],
)
def test_what_does_not_fit_is_refused_with_field_and_reason(
    agents: Agents, tool: str, arguments: dict[str, Any], text: str
) -> None:
    refusal = agents.refused(tool, arguments)
    assert text in refusal
    assert refusal.partition(":")[0] in {"message", "usage"}
    assert script.came == []


def test_a_failure_is_explained_in_the_words_of_the_component(agents: Agents) -> None:
    result = agents.call("broken", {"value": 1})
    assert result.is_error
    assert result.structured_content["state"] == "failed"
    assert "the wire is loose" in result.structured_content["cause"]
    explained = agents.facts("explain_failure", {"function": "broken"})
    assert "the wire is loose" in json.dumps(explained)
    again = agents.facts("explain_failure", {"handle": result.structured_content["handle"]})
    assert again["first_report"] is False
    assert "has no 'nothing'" in agents.facts("explain_failure", {"function": "missing"})["why"]


def test_a_plan_says_what_would_open_or_why_not(agents: Agents) -> None:
    plan = agents.facts("plan", {"function": "cuff"})
    assert plan["possible"] is True
    assert plan["components"] == ["cuff"]
    assert "plan for cuff" in plan["opens"]
    assert "has a lifetime" in plan["needs_approval"]
    missing = agents.facts("plan", {"function": "missing"})
    assert missing["possible"] is False
    assert "has no 'nothing'" in missing["why"]
    unknown = agents.facts("plan", {"function": "cufff"})
    assert "cuff" in unknown["why"]


def test_a_plan_that_does_not_fit_has_the_message_that_would_not(agents: Agents) -> None:
    plan = agents.facts("plan", {"function": "digit"})
    assert plan["possible"] is False
    assert "value: -1 does not meet what the consumer demands" in plan["why"]
    assert 'takes:    {"type": "integer", "minimum": 0, "maximum": 9}' in plan["why"]
    assert "example:  -1" in plan["why"]


def test_messages_are_read_next_latest_and_several(agents: Agents) -> None:
    script.numbers.put({"value": 1}, {"value": 2}, {"value": 3})
    read = agents.facts("read_numbers", {"count": 3, "seconds": 30})
    assert read["messages"] == [{"value": 1}, {"value": 2}, {"value": 3}]
    assert read["lost"] == 0
    assert agents.facts("read_numbers")["messages"] == [{"value": 3}]
    assert agents.facts("read_numbers", {"latest": False, "seconds": 0})["messages"] == []


def test_the_end_of_a_stream_is_said(agents: Agents) -> None:
    script.numbers.put({"value": 4}, Script.END)
    ended = agents.facts("read_numbers", {"count": 9, "seconds": 30})
    assert ended["messages"] == [{"value": 4}]
    assert "closed" in ended["ended"]


def test_what_is_long_is_summarised_with_a_link(agents: Agents) -> None:
    short = agents.facts("many", {"count": 10})
    assert len(short["result"]["values"]) == 10
    result = agents.call("many", {"count": 100_000})
    facts = result.structured_content
    assert "result" not in facts
    values = facts["summary"]["values"]
    assert (values["length"], values["least"], values["greatest"]) == (100_000, 0.0, 99_999.0)
    assert len(text_of(result)) < 2_000
    link = result.content[1]
    assert agents.call("goal_status", {"handle": facts["handle"]}).content[1] == link
    read = agents.run(agents.client().read_resource(link.uri))
    assert len(json.loads(read.contents[0].text)["values"]) == 100_000
    with pytest.raises(MCPError):
        agents.run(agents.client("other").read_resource(link.uri))


def test_a_picture_is_octets_and_shown_on_request_only(agents: Agents) -> None:
    pytest.importorskip("PIL")
    script.pictures.put({"width": 640, "height": 480, "data": bytes(640 * 480 * 3)})
    plain = agents.call("read_picture", {"seconds": 30})
    assert [part.type for part in plain.content] == ["text", "resource_link"]
    assert plain.structured_content["messages"] == []
    link = plain.content[1]
    blob = agents.run(agents.client().read_resource(link.uri)).contents[0]
    assert len(blob.blob) == 640 * 480 * 4
    shown = agents.call("read_picture", {"picture": True})
    picture = shown.content[-1]
    assert (picture.type, picture.mime_type) == ("image", "image/jpeg")
    assert len(picture.data) < 350_000


def test_streams_are_resources_with_their_latest_message(agents: Agents) -> None:
    uris = {str(item.uri) for item in agents.run(agents.client().list_resources()).resources}
    assert {"uoarm://stream/numbers", "uoarm://stream/picture", "uoarm://stream/drive"} <= uris
    script.numbers.put({"value": 7})
    read = agents.run(agents.client().read_resource("uoarm://stream/numbers"))
    assert json.loads(read.contents[0].text) == {"value": 7}
    for uri in ("uoarm://stream/cuff", "uoarm://kept/1", "file:///etc/passwd"):
        with pytest.raises(MCPError):
            agents.run(agents.client().read_resource(uri))


def test_a_change_of_a_stream_wakes_who_listens(agents: Agents) -> None:
    uri = "uoarm://stream/numbers"

    client = agents.client("agent", "2026-07-28")

    async def first() -> Any:
        async with client.listen(resource_subscriptions=[uri]) as subscription:
            script.numbers.put({"value": 1})
            async for event in subscription:
                return event
        return None

    assert str(agents.run(first()).uri) == uri


def test_work_that_lasts_gives_a_handle_and_its_end_once(agents: Agents) -> None:
    began = agents.facts("slow", {"value": 1})
    assert began["state"] == "running"
    handle = began["handle"]
    assert agents.facts("goal_status", {"handle": handle})["state"] == "running"
    assert agents.facts("wait", {"handle": handle, "seconds": 0})["state"] == "running"
    script.gate.set()
    ended = agents.facts("wait", {"handle": handle, "seconds": 30})
    assert (ended["state"], ended["result"]) == ("succeeded", {"value": 1})
    assert ended["first_report"] is True
    assert agents.facts("goal_status", {"handle": handle})["first_report"] is False
    assert "there is no goal" in agents.refused("goal_status", {"handle": handle}, "other")


def test_what_is_used_no_more_is_closed_and_ended_with_the_rights(
    agents: Agents, robot: RobotManager, access: Path
) -> None:
    script.numbers.put({"value": 1})
    agents.facts("read_numbers", {"seconds": 30})
    assert robot.connections()
    text = access.read_text(encoding="utf-8")
    access.write_text(text.replace("name: agent, role: agent", "name: agent, role: guest"))
    wait(lambda: not robot.connections(), "the streams of the agent are closed")


def test_a_call_that_rights_end_in_is_answered(
    agents: Agents, access: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting = threading.Event()

    async def within(seconds: float, done: asyncio.Event) -> None:
        del seconds, done
        waiting.set()
        await asyncio.Event().wait()

    arguments = {"handle": agents.facts("slow", {"value": 1})["handle"], "seconds": 30}
    monkeypatch.setattr("uoarm_mcp._robot_tools.within", within)
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(agents.posted, "wait", arguments)
        assert waiting.wait(patience())
        text = access.read_text(encoding="utf-8")
        access.write_text(text.replace("name: agent, role: agent", "name: agent, role: guest"))
        answer = asked.result()
    assert (answer.status_code, answer.text) == (401, "the rights of this client have ended\n")


OPENING = {
    "jsonrpc": "2.0",
    "id": 1,
    "method": "initialize",
    "params": {
        "protocolVersion": "2025-11-25",
        "capabilities": {},
        "clientInfo": {"name": "test", "version": "1"},
    },
}
HEADERS = {
    "Authorization": f"Bearer {TOKENS['agent']}",
    "Accept": "application/json, text/event-stream",
}


def post(agents: Agents, body: dict[str, Any] = OPENING, **more: str) -> httpx2.Response:
    return httpx2.post(agents.url, json=body, headers=HEADERS | more, timeout=patience())


def opened(agents: Agents) -> dict[str, str]:
    session = post(agents).headers["mcp-session-id"]
    return {"mcp-session-id": session, "mcp-protocol-version": "2025-11-25"}


def test_one_agent_does_not_take_the_sessions_of_all(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_http, "_MOST_SESSIONS", 2)
    ping = {"jsonrpc": "2.0", "id": 2, "method": "ping"}
    first, second = opened(agents), opened(agents)
    assert post(agents, ping, **first).status_code == 200
    third = opened(agents)
    answers = [post(agents, ping, **known).status_code for known in (first, second, third)]
    assert answers == [200, 404, 200]
    with (
        httpx2.stream("GET", agents.url, headers=HEADERS | first, timeout=patience()),
        httpx2.stream("GET", agents.url, headers=HEADERS | third, timeout=patience()),
    ):
        assert post(agents).status_code == 503, "both are in use"
        other = agents.client("other", "legacy")
        assert agents.run(other.call_tool("add", {"a": 1, "b": 2})).is_error is False
    wait(lambda: post(agents).status_code == 200, "a session whose client has gone makes room")


def test_a_stream_that_is_asked_for_from_an_event_on_begins_anew(agents: Agents) -> None:
    asked = HEADERS | opened(agents) | {"last-event-id": "5"}
    with httpx2.stream("GET", agents.url, headers=asked, timeout=patience()) as answer:
        assert answer.status_code == 200


@pytest.mark.parametrize("identity", [None, 1.5, True, {}])
def test_a_request_whose_id_has_no_answer_is_refused(agents: Agents, identity: object) -> None:
    ping = {"jsonrpc": "2.0", "id": identity, "method": "ping"}
    refused = post(agents, ping, **opened(agents))
    assert refused.status_code == 400
    assert refused.text == "an id is a string or a whole number (UOA-502)\n"


def test_an_id_of_a_request_under_way_is_refused_in_its_session(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_actions, "_AT_ONCE_SECONDS", patience())  # slow ends once it is let go
    session, other = opened(agents), opened(agents)
    ping = {"jsonrpc": "2.0", "id": "7", "method": "ping"}
    parameters = {"name": "slow", "arguments": {"value": 1}}
    slow = {"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": parameters}
    with ThreadPoolExecutor(1) as executor:
        answer = executor.submit(post, agents, slow, **session)
        wait(lambda: script.came, "it is under way")
        refused = post(agents, ping, **session)
        assert refused.text == "the id '7' is that of a request under way\n"
        assert refused.status_code == 400
        assert post(agents, ping, **other).status_code == 200
        script.gate.set()
        assert answer.result(patience()).status_code == 200
    assert post(agents, ping, **session).status_code == 200


def test_an_id_of_the_stream_of_notices_is_refused(agents: Agents) -> None:
    session = opened(agents)
    subscribe = {
        "jsonrpc": "2.0", "id": 2, "method": "resources/subscribe",
        "params": {"uri": "uoarm://stream/numbers"},
    }  # fmt: skip
    ping = {"jsonrpc": "2.0", "id": "_GET_stream", "method": "ping"}
    with httpx2.stream("GET", agents.url, headers=HEADERS | session, timeout=patience()) as notices:
        assert post(agents, subscribe, **session).json()["result"] == {}
        assert post(agents, ping, **session).status_code == 400
        script.numbers.put({"value": 1})
        assert "notifications/resources/updated" in next(
            line for line in notices.iter_lines() if line.startswith("data:")
        )


def test_sessions_that_begin_together_have_room(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_http, "_MOST_SESSIONS", 2)
    end_session = _http._end_session
    ending, go = threading.Semaphore(0), threading.Event()

    async def end(*arguments: Any) -> None:
        ending.release()
        await asyncio.to_thread(go.wait, patience())
        await end_session(*arguments)

    monkeypatch.setattr(_http, "_end_session", end)
    opened(agents), opened(agents)
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(post, agents)
        assert ending.acquire(timeout=patience()), "it makes room for itself"
        second = pool.submit(post, agents)
        wait(lambda: ending.acquire(blocking=False) or second.done(), "so does the next")
        go.set()
        assert [asked.result().status_code for asked in (first, second)] == [200, 200]


def test_a_session_whose_end_was_refused_makes_room_still(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_http, "_MOST_SESSIONS", 1)
    asked = HEADERS | opened(agents) | {"mcp-protocol-version": "2026-07-28"}
    ended = httpx2.delete(agents.url, headers=asked, timeout=patience())
    assert ended.status_code == 405, "that revision has none"
    assert post(agents).status_code == 200


@pytest.mark.filterwarnings("ignore::mcp.shared.exceptions.MCPDeprecationWarning")
def test_a_client_that_does_not_read_has_one_notice_under_way(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm_mcp._service._NOTICE_SECONDS", 0.0)
    begun: list[str] = []
    read = threading.Event()

    async def send(session: ServerSession, uri: Any) -> None:
        del session
        begun.append(str(uri))
        await asyncio.to_thread(read.wait, patience())

    monkeypatch.setattr(ServerSession, "send_resource_updated", send)
    client = agents.client("agent", "legacy")
    agents.run(client.subscribe_resource("uoarm://stream/numbers"))
    try:
        for number in range(20):
            script.numbers.put({"value": number})
            wait(lambda: latest(agents)["messages"] == [{"value": number}], "it came")  # noqa: B023
        assert begun == ["uoarm://stream/numbers"]
    finally:
        read.set()
    wait(lambda: len(begun) == 2, "there is one notice for all that came meanwhile")


@pytest.mark.filterwarnings("ignore::mcp.shared.exceptions.MCPDeprecationWarning")
@pytest.mark.parametrize("end", ["unsubscribe", "session"])
def test_what_is_watched_no_more_is_closed(
    agents: Agents, robot: RobotManager, monkeypatch: pytest.MonkeyPatch, end: str
) -> None:
    monkeypatch.setattr("uoarm_mcp._streams._IDLE_SECONDS", 0.0)
    uri = "uoarm://stream/numbers"

    async def watch() -> None:
        async with agents.session("agent", "legacy") as client:
            for _ in range(2):
                await client.subscribe_resource(uri)
            if end == "unsubscribe":
                await client.unsubscribe_resource(uri)
                await asyncio.to_thread(wait, lambda: not robot.connections(), "it is closed")
            else:
                assert robot.connections()

    agents.run(watch())
    wait(lambda: not robot.connections(), "it is closed with the session")


@pytest.mark.filterwarnings("ignore::mcp.shared.exceptions.MCPDeprecationWarning")
def test_what_is_watched_twice_at_one_time_is_watched_once(
    agents: Agents, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm_mcp._streams._IDLE_SECONDS", 0.0)
    client, uri = agents.client("agent", "legacy"), "uoarm://stream/numbers"

    async def subscribe() -> None:
        await asyncio.gather(*(client.subscribe_resource(uri) for _ in range(5)))

    agents.run(subscribe())
    assert robot.connections()
    agents.run(client.unsubscribe_resource(uri))
    wait(lambda: not robot.connections(), "it is closed")


def test_more_than_may_be_watched_is_refused(agents: Agents) -> None:
    client = agents.client("agent", "2026-07-28")

    async def listen() -> None:
        uris = [f"uoarm://stream/{number}" for number in range(65)]
        async with client.listen(resource_subscriptions=uris):
            """It is refused before."""

    with pytest.raises(MCPError, match="limit: 64 resources are watched"):
        agents.run(listen())


async def test_what_opens_for_a_client_that_has_gone_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("uoarm_mcp._streams._IDLE_SECONDS", 0.0)
    joining, gate, left = asyncio.Event(), asyncio.Event(), asyncio.Event()
    feed = Mock()

    async def join(key: FeedKey) -> Any:
        del key
        joining.set()
        await gate.wait()
        return feed

    backend = Mock(join=join, leave=lambda _: left.set())
    streams = AgentStreams(backend, Mock(), LeaseHolder("agent", "agent"))
    reading = asyncio.ensure_future(streams.read("numbers.default", 1, 30, latest=True))
    await joining.wait()
    reading.cancel()
    gate.set()
    await asyncio.wait_for(left.wait(), patience())
    assert streams.open == []


def latest(agents: Agents) -> Any:
    return agents.facts("read_numbers", {"seconds": 0})


def test_what_is_refused_has_the_code_that_explains_it(agents: Agents) -> None:
    assert agents.refused("add", {"a": "x", "b": 2}).endswith(" (UOA-501)")
    assert agents.refused("broken", {"value": 1}).count("(UOA-409)") == 1
    assert agents.refused("cuff", {"pressure": 1, "x-approval": "none"}).endswith(" (UOA-707)")
    assert agents.refused("goal_status", {"handle": "none"}).endswith(" (UOA-703)")
    assert "(UOA-201)" in agents.facts("plan", {"function": "missing"})["why"]
    with pytest.raises(MCPError, match=r"\(UOA-703\)$"):
        agents.call("nothing")
    with pytest.raises(MCPError, match=r"\(UOA-703\)$"):
        agents.run(agents.client().read_resource("uoarm://stream/nothing"))
    unknown = httpx2.post(agents.url, timeout=patience())
    assert unknown.text.endswith(" (UOA-705)\n")
