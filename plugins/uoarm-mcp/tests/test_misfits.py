"""Thousands of arguments that do not fit: none reaches a bridge, each is refused with a reason."""

from __future__ import annotations

import asyncio
import json
import os
import random
import select
import socket
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import httpx2
import pytest
from agents import TOKENS, Agents
from components import script
from mcp.client.client import Client
from mcp_types import ResourceLink
from uoarm_mcp import _catalogue, _http
from uoarm_mcp._catalogue import Catalogue, CatalogueMaker

from uoarm import RobotManager
from uoarm.model import Plan
from uoarm.server import Limits
from uoarm.server.front_end import AccessRole
from uoarm.server.streams import FeedRegistry
from uoarm.testing import patience, slowness, wait

MISFITS = 10_000 if os.environ.get("HYPOTHESIS_PROFILE") == "long" else 1_000
BATCH = 16


def _junk(draw: random.Random, depth: int = 0) -> Any:
    kinds: list[Callable[[], Any]] = [
        lambda: None,
        lambda: draw.random() < 0.5,
        lambda: draw.choice((-(2**70), -1, 101, 2**31, 10**300, 1.5, -1e308, 301.0)),
        lambda: draw.choice(("", "x", "NaN", "../../etc/passwd", "\x00", "1e999", "💥" * 50)),
        lambda: [_junk(draw, depth + 1) for _ in range(draw.randrange(4))],
        lambda: {
            draw.choice(("a", "b", "value", "", "__proto__", "$ref", "x-y")): _junk(draw, depth + 1)
            for _ in range(draw.randrange(4))
        },
    ]
    return draw.choice(kinds[: 4 if depth > 3 else 6])()


def _misfit(draw: random.Random) -> tuple[str, dict[str, Any]]:
    """Return a tool and arguments, of which at least one does not fit."""
    wrong: Any = draw.choice((None, "x", [], {}, True, 1.5))
    match draw.randrange(7):
        case 0:
            return "add", {"a": draw.choice((wrong, -1, 101, 10**20)), "b": 1}
        case 1:
            return "add", {"b": 1, "c": _junk(draw)}
        case 2:
            return "cuff", {"pressure": draw.choice((None, [], {}, True, -0.1, 300.1, "high"))}
        case 3:
            handle: Any = draw.choice((None, 3, "", "x" * 65, ["x"], {}))
            return "slow", {"value": 1, "x-approval": handle or ["x"]}
        case 4:
            return "send_drive", {"speed": draw.choice((None, "x", [], {}, True, 1.1, -9, 1e300))}
        case 5:
            return "diary", {"a": 1, "b": draw.choice((None, "x", [], {}, True, 0.5))}
        case _:
            return "slow", {"value": draw.choice((None, "x", [], {}, True, 0.5)), "z": _junk(draw)}


def test_none_of_many_misfits_reaches_a_bridge(agents: Agents) -> None:
    draw = random.Random(48)
    client = agents.client()

    async def all_of_them() -> list[str]:
        accepted: list[str] = []
        for _ in range(MISFITS // BATCH):
            batch = [_misfit(draw) for _ in range(BATCH)]
            results = await asyncio.gather(*(client.call_tool(*item) for item in batch))
            accepted += [
                f"{item}: {result}"
                for item, result in zip(batch, results, strict=True)
                if not result.is_error
            ]
        return accepted

    future = asyncio.run_coroutine_threadsafe(all_of_them(), agents.loop)
    assert future.result() == []
    assert script.came == []
    assert agents.run(agents.remote().approvals()) == [], "nothing was even asked for"


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"[" * 100_000, 413),
        (b'{"a": "' + b"x" * 2_000_000 + b'"}', 413),
        (b"\xff\xfe", 400),
        (b"", 400),
        (b"null", 400),
    ],
)
def test_a_body_is_bounded_before_it_is_parsed(agents: Agents, body: bytes, status: int) -> None:
    headers = {
        "Authorization": f"Bearer {TOKENS['agent']}",
        "Content-Type": "application/json",
        "Accept": "application/json, text/event-stream",
        "MCP-Protocol-Version": "2026-07-28",
    }
    assert httpx2.post(agents.url, content=body, headers=headers).status_code == status


@pytest.mark.parametrize("seconds", ["NaN", '1.0, "seconds": 2.0'])
def test_what_other_readers_take_otherwise_is_no_json(agents: Agents, seconds: str) -> None:
    arguments = {"seconds": 0.125}  # within any bounds
    body, headers = agents.request(
        "tools/call", "read_numbers", name="read_numbers", arguments=arguments
    )
    headers["Content-Type"] = "application/json"
    text = json.dumps(body).replace("0.125", seconds)
    refused = httpx2.post(agents.url, content=text, headers=headers, timeout=patience())
    assert (refused.status_code, refused.text[:8]) == (400, "not JSON")


def _send_on(connection: socket.socket, octets: bytes) -> None:
    for _ in range(64):
        connection.sendall(octets)
        octets = octets.removeprefix(b"POST /mcp HTTP/1.1\r\n")


@pytest.mark.parametrize(
    "octets",
    [
        b"POST /mcp HTTP/1.1\r\nx: " + b"y" * 1_000_000,
        b"POST /mcp HTTP/1.1\r\n" + b"x: y\r\n" * 200_000,
        b"POST /" + b"p" * 1_000_000,
        b"POST /mcp HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n"
        b"1;extension=" + b"e" * 1_000_000,
        b"GET /mcp HTTP/1.1\r\nHost: x\r\n\r\n" * 20_000,
    ],
    ids=["header", "headers", "path", "chunk", "ahead"],
)
def test_heads_and_requests_sent_ahead_are_bounded(agents: Agents, octets: bytes) -> None:
    with (
        socket.create_connection(agents.address, timeout=patience()) as connection,
        pytest.raises(ConnectionError),
    ):
        _send_on(connection, octets)
    assert agents.facts("add", {"a": 1, "b": 2})["result"] == {"value": 3}


def test_a_later_head_comes_in_time_too(serve: Any, access: Any) -> None:
    server = serve(Limits(handshake_seconds=slowness() * 0.5), access=access)
    address = "127.0.0.1", server.ports[1]
    with socket.create_connection(address, timeout=patience()) as connection:
        token = f"Authorization: Bearer {TOKENS['agent']}"
        connection.sendall(f"GET /mcp HTTP/1.1\r\nHost: 127.0.0.1\r\n{token}\r\n\r\n".encode())
        assert connection.recv(65_536).startswith(b"HTTP/1.1 406")
        connection.sendall(b"POST /mcp HT")
        while connection.recv(65_536):
            """Read what is left of the answer, until the connection is cut."""


def _ask_for(agents: Agents, kept: str, connection: socket.socket) -> None:
    """Ask for what is kept, over a connection of its own."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.settimeout(patience())
    connection.connect(agents.address)
    body, headers = agents.request("resources/read", kept, uri=kept)
    request = httpx2.Request("POST", agents.url, json=body, headers=headers)
    lines = "".join(f"{name}: {value}\r\n" for name, value in request.headers.items())
    connection.sendall(f"POST /mcp HTTP/1.1\r\n{lines}\r\n".encode() + request.read())


def _long(agents: Agents) -> str:
    """Return the address of a kept value whose 11 MB are more than the system takes at once."""
    script.pictures.put({"width": 2000, "height": 4000, "data": bytes(8_000_000)})
    kept = agents.call("read_picture", {"seconds": 30}).content[1]
    assert isinstance(kept, ResourceLink)
    return kept.uri


def test_who_does_not_read_an_answer_is_cut(
    serve: Any, access: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost: list[Exception | None] = []

    class Noting(_http._BoundedProtocol):
        def connection_lost(self, exc: Exception | None) -> None:
            if self.cycle.scope["method"] == "POST":
                lost.append(exc)
            super().connection_lost(exc)

    monkeypatch.setattr(_http, "_BoundedProtocol", Noting)
    server = serve(Limits(stall_seconds=slowness() * 0.1), access=access)
    with Agents(server.ports, TOKENS) as agents, socket.socket() as connection:
        _ask_for(agents, _long(agents), connection)
        wait(lambda: lost, "it is cut")


def test_answers_that_are_not_read_are_memory_of_their_client(serve: Any, access: Any) -> None:
    server = serve(Limits(memory_bytes=40_000_000, stall_seconds=patience()), access=access)
    with Agents(server.ports, TOKENS) as agents, ExitStack() as stack:
        kept = _long(agents)
        connections = [stack.enter_context(socket.socket()) for _ in range(3)]
        for connection in connections:
            _ask_for(agents, kept, connection)
        heads = sorted(connection.recv(12) for connection in connections)
        assert heads == [b"HTTP/1.1 200", b"HTTP/1.1 200", b"HTTP/1.1 503"]
        assert agents.facts("add", {"a": 1, "b": 2}, "other")["result"] == {"value": 3}


def test_requests_that_do_not_end_are_memory_of_their_client(serve: Any, access: Any) -> None:
    server = serve(Limits(memory_bytes=2_000_000, message_seconds=patience()), access=access)
    head = f"POST /mcp HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {TOKENS['agent']}\r\n"
    with ExitStack() as stack:
        address = "127.0.0.1", server.ports[1]
        opened = [socket.create_connection(address, patience()) for _ in range(3)]
        connections = [stack.enter_context(connection) for connection in opened]
        for connection in connections:
            connection.sendall(f"{head}Content-Length: 900000\r\n\r\n{'x' * 800_000}".encode())
        answered = select.select(connections, [], [], patience())[0]
        assert [connection.recv(12) for connection in answered] == [b"HTTP/1.1 503"]


def test_who_has_no_token_or_is_a_strange_page_is_not_let_in(agents: Agents) -> None:
    for headers, status in (
        ({}, 401),
        ({"Authorization": "Bearer wrong"}, 401),
        ({"Authorization": f"Bearer {TOKENS['agent']}", "Origin": "http://evil.example"}, 403),
        ({"Authorization": f"Bearer {TOKENS['agent']}", "Host": "evil.example"}, 403),
    ):
        answer = httpx2.post(agents.url, content=b"{}", headers=headers)
        assert answer.status_code == status
        assert ("www-authenticate" in answer.headers) is (status == 401)


def test_an_agent_has_bounds(serve: Any, access: Any) -> None:
    server = serve(Limits(calls=2), access=access)
    with Agents(server.ports, TOKENS) as agents:
        client = agents.client()

        async def three() -> list[bool | None]:
            results = await asyncio.gather(
                *(client.call_tool("slow", {"value": number}) for number in range(3))
            )
            return [result.is_error for result in results]

        assert agents.run(three()).count(True) == 1
        script.gate.set()


def test_to_stop_waits_for_nothing(
    serve: Any, access: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def of(self: CatalogueMaker, role: AccessRole) -> Catalogue:
        del self, role
        await asyncio.Event().wait()
        raise AssertionError("it hangs")

    limits = Limits()
    object.__setattr__(limits, "calls", 0)  # as though that many were under way
    server = serve(limits, access=access)
    monkeypatch.setattr(CatalogueMaker, "of", of)
    with Agents(server.ports, TOKENS) as agents:
        answer = agents.posted("stop", {})
        assert answer.json()["result"]["structuredContent"] == {"stopped": [], "cancelled": []}


def test_what_hangs_is_waited_for_once(
    agents: Agents, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans = {name: robot.resolve(name) for name in ("add", "cuff")}
    asked: list[str] = []
    loops: list[asyncio.AbstractEventLoop] = []
    gate = asyncio.Event()

    async def resolve(self: FeedRegistry, name: str) -> Plan:
        del self
        asked.append(name)
        loops.append(asyncio.get_running_loop())
        if name != "add":
            await gate.wait()
        return plans[name]

    async def late(client: Client) -> list[str]:
        async with client.listen(tools_list_changed=True) as events:
            loops[0].call_soon_threadsafe(gate.set)
            await anext(aiter(events))
        return [tool.name for tool in (await client.list_tools()).tools]

    monkeypatch.setattr(FeedRegistry, "resolve", resolve)
    monkeypatch.setattr(_catalogue, "_FIND_SECONDS", 0.05 * slowness())
    client = agents.client("agent", "2026-07-28")
    assert agents.facts("add", {"a": 1, "b": 2})["result"] == {"value": 3}
    monkeypatch.setattr(_catalogue, "_FIND_SECONDS", 10 * patience())
    assert agents.facts("add", {"a": 1, "b": 2})["result"] == {"value": 3}
    assert "no plan within" in agents.facts("status", {})["left_out"]["cuff"]
    assert sorted(asked) == sorted(robot.config.functions)
    assert "cuff" in agents.run(late(client)), "clients know when it is found after all"
