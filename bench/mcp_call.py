"""What a tool call costs beside a call over WebSocket and beside the SDK's own server, in one run.

`python -m bench.mcp_call` starts `uoarm mcp` once on HTTP and once on standard input and output,
and a server of nothing but the SDK with the same tool twice likewise. All ways take turns, so that
they meet the same load. A *bare* client writes octets that were made once and reads the answer: it
shows what of a call is the server's. The SDK's client is what an agent uses.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

from mcp.client.client import Client
from mcp.client.stdio import StdioServerParameters, stdio_client
from mcp.client.streamable_http import streamable_http_client
from mcp.server.mcpserver import MCPServer

from bench._components import Sum
from bench.tables import print_table, row
from bench.turns import load, module, running
from uoarm.client import connect

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  add:
    components:
      - {name: adder, bridge: python, service: {endpoint: ["bench._components:add"]}}
"""
_META = {
    "io.modelcontextprotocol/protocolVersion": "2026-07-28",
    "io.modelcontextprotocol/clientInfo": {"name": "bench", "version": "1"},
    "io.modelcontextprotocol/clientCapabilities": {},
}
_BODY = json.dumps(
    {
        "jsonrpc": "2.0",
        "id": 1,
        "method": "tools/call",
        "params": {"name": "add", "arguments": {"a": 1, "b": 2}, "_meta": _META},
    }
).encode()
_HEAD = (
    b"POST /mcp HTTP/1.1\r\nHost: %s\r\nAccept: application/json, text/event-stream\r\n"
    b"Content-Type: application/json\r\nMCP-Protocol-Version: 2026-07-28\r\n"
    b"Mcp-Method: tools/call\r\nMcp-Name: add\r\nContent-Length: %d\r\n\r\n"
)
Way = Callable[[], Awaitable[Any]]


def serve_sdk(way: str) -> None:
    """Serve the same tool with the SDK alone."""
    server = MCPServer("sdk")

    @server.tool(name="add")
    def add_numbers(a: float, b: float) -> Sum:
        """Add two numbers."""
        return {"value": a + b}

    if way == "stdio":
        server.run("stdio")
    else:
        import socket  # noqa: PLC0415 - of this program alone

        import uvicorn  # noqa: PLC0415

        # With its protocol said, asyncio turns off the delay of small packets.
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        print(f"serving http://127.0.0.1:{listening.getsockname()[1]}/mcp", file=sys.stderr)
        app = server.streamable_http_app(json_response=True)
        config = uvicorn.Config(app, log_level="error", access_log=False, timeout_keep_alive=600)
        uvicorn.Server(config).run([listening])


async def _bare_http(url: str, stack: AsyncExitStack) -> Way:
    host, port = url.removeprefix("http://").partition("/")[0].split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    stack.callback(writer.close)
    request = _HEAD % (f"{host}:{port}".encode(), len(_BODY)) + _BODY

    async def call() -> Any:
        writer.write(request)
        head = await reader.readuntil(b"\r\n\r\n")
        found = re.search(rb"content-length: (\d+)", head.lower())
        assert found is not None, head
        return json.loads(await reader.readexactly(int(found[1])))["result"]["structuredContent"]

    await call()  # a connection without a request is closed after a while
    return call


async def _bare_lines(words: tuple[str, ...], stack: AsyncExitStack) -> Way:
    process = await asyncio.create_subprocess_exec(
        *words,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    reader, writer = process.stdout, process.stdin
    assert reader is not None
    assert writer is not None
    stack.push_async_callback(process.wait)
    stack.callback(process.terminate)
    request = _BODY + b"\n"

    async def call() -> Any:
        writer.write(request)
        return json.loads(await reader.readline())["result"]["structuredContent"]

    return call


def _by_client(client: Client) -> Way:
    async def call() -> Any:
        return (await client.call_tool("add", {"a": 1, "b": 2})).structured_content

    return call


async def _compare(folder: Path, rounds: int, calls: int) -> dict[str, list[float]]:
    configuration = folder / "robot.yaml"
    configuration.write_text(CONFIGURATION, encoding="utf-8")
    ours = module("uoarm", "mcp", str(configuration), "--port", "0")
    theirs = module("bench.mcp_call", "--serve-sdk")
    ways: dict[str, Way] = {}
    async with AsyncExitStack() as stack:
        urls = []
        for words in ((*ours, "--http", "0"), (*theirs, "http")):
            server = running(words, signal.SIGTERM, stderr=subprocess.PIPE)
            child = stack.enter_context(server)
            urls += [child.said(r"serving (\S+)") for _ in range(2 if "uoarm" in words else 1)]
        websocket, http, sdk_http = urls
        robot = await stack.enter_async_context(connect(websocket))
        ways["WebSocket, our client"] = lambda: robot.call("add", {"a": 1, "b": 2})
        for name, url, words in (
            ("uoarm", http, ours),
            ("SDK alone", sdk_http, (*theirs, "stdio")),
        ):
            ways[f"HTTP, {name}, bare client"] = await _bare_http(url, stack)
            over_http = await stack.enter_async_context(Client(streamable_http_client(url)))
            ways[f"HTTP, {name}, SDK's client"] = _by_client(over_http)
            ways[f"stdio, {name}, bare client"] = await _bare_lines(words, stack)
            parameters = StdioServerParameters(
                command=words[0], args=list(words[1:]), env=dict(os.environ)
            )
            errors = stack.enter_context((folder / "errors.txt").open("a"))
            over_stdio = await stack.enter_async_context(
                Client(stdio_client(parameters, errlog=errors))
            )
            ways[f"stdio, {name}, SDK's client"] = _by_client(over_stdio)
        times: dict[str, list[float]] = {name: [] for name in ways}
        for turn in range(rounds + 1):
            for name, call in ways.items():
                for _ in range(calls):
                    began = time.perf_counter()
                    answer = await call()
                    if turn:  # the first warms up
                        times[name].append(time.perf_counter() - began)
                    assert answer.get("result", answer)["value"] == 3
    return times


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--calls", type=int, default=100)
    parser.add_argument("--serve-sdk", choices=["http", "stdio"], help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve_sdk is not None:
        serve_sdk(given.serve_sdk)
        return
    with tempfile.TemporaryDirectory() as folder:
        times = asyncio.run(_compare(Path(folder), given.rounds, given.calls))
    least = statistics.median(times["WebSocket, our client"])
    rows = [
        row(name, [1000 * took for took in found], f"{statistics.median(found) / least:.1f}", 2)
        for name, found in times.items()
    ]
    title = f"Call of a tool (ms; {load()}, {given.rounds} rounds of {given.calls} calls)"
    print_table(title, ("way", "median", "p99", "times the first"), rows)


if __name__ == "__main__":
    main()
