"""What a tool call costs beside a call over WebSocket, of the same service in one run.

`python -m bench.mcp_call` takes turns, so that all meet the same load: the native client, the
SDK's client, and a bare POST of the same tool call, which shows what of it is the server's.
Both ends are in this process.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import time
from collections.abc import Awaitable, Callable
from typing import Any, TypedDict

import httpx2
from mcp.client.client import Client
from mcp.client.streamable_http import streamable_http_client

from uoarm import RobotManager
from uoarm.client import connect
from uoarm.config import loads
from uoarm.server import Server, ServerOptions, serve_in_thread

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  add:
    components:
      - {name: adder, bridge: python, service: {endpoint: ["bench.mcp_call:add"]}}
"""
_HEADERS = {
    "Accept": "application/json, text/event-stream",
    "Content-Type": "application/json",
    "MCP-Protocol-Version": "2026-07-28",
    "Mcp-Method": "tools/call",
    "Mcp-Name": "add",
}
_META = {
    "io.modelcontextprotocol/protocolVersion": "2026-07-28",
    "io.modelcontextprotocol/clientInfo": {"name": "bench", "version": "1"},
    "io.modelcontextprotocol/clientCapabilities": {},
}


class Pair(TypedDict):
    """What is added."""

    a: float
    b: float


class Sum(TypedDict):
    """What it makes."""

    value: float


def add(request: Pair) -> Sum:
    """Add two numbers."""
    return {"value": request["a"] + request["b"]}


async def _compare(server: Server, rounds: int, calls: int) -> dict[str, list[float]]:
    websocket, http = server.ports
    url = f"http://127.0.0.1:{http}/mcp"
    body = {
        "jsonrpc": "2.0",
        "id": 1,
        "method": "tools/call",
        "params": {"name": "add", "arguments": {"a": 1, "b": 2}, "_meta": _META},
    }
    async with (
        connect(f"ws://127.0.0.1:{websocket}/") as robot,
        httpx2.AsyncClient() as bare,
        Client(streamable_http_client(url)) as client,
    ):

        async def native() -> Any:
            return await robot.call("add", {"a": 1, "b": 2})

        async def tool() -> Any:
            return (await client.call_tool("add", {"a": 1, "b": 2})).structured_content["result"]

        async def post() -> Any:
            answer = await bare.post(url, json=body, headers=_HEADERS)
            return answer.json()["result"]["structuredContent"]["result"]

        ways: dict[str, Callable[[], Awaitable[Any]]] = {
            "WebSocket": native,
            "tool, SDK's client": tool,
            "tool, bare POST": post,
        }
        times: dict[str, list[float]] = {name: [] for name in ways}
        for turn in range(rounds + 1):
            for name, call in ways.items():
                for _ in range(calls):
                    began = time.perf_counter()
                    assert (await call())["value"] == 3
                    if turn:  # the first warms up
                        times[name].append(time.perf_counter() - began)
    return times


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--calls", type=int, default=200)
    given = parser.parse_args()
    options = ServerOptions(port=0, front_end_ports={"mcp": 0})
    with (
        RobotManager(loads(CONFIGURATION)) as robot,
        serve_in_thread(robot, options) as server,
    ):
        times = asyncio.run(_compare(server, given.rounds, given.calls))
    least = statistics.median(times["WebSocket"])
    print(f"load {os.getloadavg()[0]:.1f}, {given.rounds} rounds of {given.calls} calls")
    for name, found in times.items():
        found.sort()
        median, late = statistics.median(found), found[int(len(found) * 0.99)]
        print(
            f"{name:20} median {median * 1e3:6.2f} ms, p99 {late * 1e3:6.2f} ms,"
            f" {median / least:4.1f} times"
        )
    print(json.dumps({name: statistics.median(found) for name, found in times.items()}))


if __name__ == "__main__":
    main()
