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
import statistics
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

from mcp.client.client import Client
from mcp.client.stdio import StdioServerParameters, stdio_client
from mcp.client.streamable_http import streamable_http_client
from mcp.server.mcpserver import MCPServer
from typing_extensions import TypedDict

from uoarm.client import connect

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  add:
    components:
      - {name: adder, bridge: python, service: {endpoint: ["bench.mcp_call:add"]}}
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


@asynccontextmanager
async def _started(*words: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, list[str]]]:
    """Start a server; give its process and the addresses that it says."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *words,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stderr is not None
    addresses: list[str] = []
    is_ours = "uoarm" in words
    try:
        while len(addresses) < (1 + ("--http" in words) if is_ours else 1):
            line = (await process.stderr.readline()).decode()
            if not line:
                raise RuntimeError(f"{words} did not start")
            addresses += re.findall(r"serving (\S+)", line)
        yield process, addresses
    finally:
        process.terminate()
        await process.wait()


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
        sys.executable,
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
    ours = ("-m", "uoarm", "mcp", str(configuration), "--port", "0")
    theirs = ("-m", "bench.mcp_call", "--serve-sdk")
    ways: dict[str, Way] = {}
    async with AsyncExitStack() as stack:
        _, (websocket, http) = await stack.enter_async_context(_started(*ours, "--http", "0"))
        _, (sdk_http,) = await stack.enter_async_context(_started(*theirs, "http"))
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
                command=sys.executable, args=list(words), env=dict(os.environ)
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
    print(f"load {os.getloadavg()[0]:.1f}, {given.rounds} rounds of {given.calls} calls")
    for name, found in times.items():
        found.sort()
        median, late = statistics.median(found), found[int(len(found) * 0.99)]
        print(
            f"{name:30} median {median * 1e3:6.2f} ms, p99 {late * 1e3:6.2f} ms,"
            f" {median / least:4.1f} times"
        )


if __name__ == "__main__":
    main()
