"""Clients of the SDK in a loop of their own thread, so that tests are plain functions."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator, Coroutine, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any, TypeVar

import httpx2
from mcp.client.client import Client
from mcp.client.streamable_http import streamable_http_client
from mcp_types import CallToolResult
from typing_extensions import Self

from uoarm.client import RemoteRobot, connect
from uoarm.server import make_token
from uoarm.testing import patience

T = TypeVar("T")

ACCESS = """
version: 1
roles:
  agent:
    see: all
    request: ["*"]
    call: ["*"]
    send: ["*"]
    supervised: true
  guest: {{see: ["numbers", "add"], request: ["numbers"], supervised: true}}
  nurse: {{see: all, approve: ["*"], call: ["*"], send: ["*"], request: ["*"], stop: all,
           release: all, configure: all}}
tokens:
  - {{name: agent, role: agent, sha256: {agent}}}
  - {{name: second, principal: agent, role: agent, sha256: {second}}}
  - {{name: own, principal: agent, role: nurse, sha256: {own}}}
  - {{name: other, role: agent, sha256: {other}}}
  - {{name: guest, role: guest, sha256: {guest}}}
  - {{name: nurse, role: nurse, sha256: {nurse}}}
"""
TOKENS = {name: make_token() for name in ("agent", "second", "own", "other", "guest", "nurse")}


class Agents:
    """Clients by the names of their tokens, over HTTP and over WebSocket."""

    def __init__(self, ports: tuple[int, ...], tokens: Mapping[str, str]) -> None:
        self._ports = ports
        self._tokens = tokens
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._stop = asyncio.Event()
        self._holding: list[asyncio.Task[None]] = []
        self._clients: dict[tuple[str, str], Client] = {}
        self._remotes: dict[str, RemoteRobot] = {}

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.run(self._end())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(patience())
        self.loop.close()

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Return what becomes of some work in the loop of the clients."""
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(patience())

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._ports[1]}/mcp"

    @property
    def address(self) -> tuple[str, int]:
        return "127.0.0.1", self._ports[1]

    def client(self, name: str = "agent", mode: str = "auto") -> Client:
        """Return a connected client of the SDK."""
        if (name, mode) not in self._clients:
            self._clients[name, mode] = self.run(self._held(self._open(name, mode)))
        return self._clients[name, mode]

    @asynccontextmanager
    async def session(self, name: str, mode: str) -> AsyncIterator[Client]:
        """Have a client of the SDK for a while, in the loop of the clients."""
        client, stack = await self._open(name, mode)
        async with stack:
            yield client

    def remote(self, name: str = "nurse") -> RemoteRobot:
        """Return a connected client of the native protocol."""
        if name not in self._remotes:
            self._remotes[name] = self.run(self._held(self._connect(name)))
        return self._remotes[name]

    def call(
        self, tool: str, arguments: Mapping[str, Any] | None = None, name: str = "agent"
    ) -> CallToolResult:
        """Use a tool."""
        made: CallToolResult = self.run(self.client(name).call_tool(tool, dict(arguments or {})))
        return made

    def posted(
        self, tool: str, arguments: Mapping[str, Any], name: str = "agent"
    ) -> httpx2.Response:
        """Return the whole answer to a call of a tool, in a request of its own."""
        body, headers = self.request("tools/call", tool, name, name=tool, arguments=dict(arguments))
        return httpx2.post(self.url, json=body, headers=headers, timeout=patience())

    def request(
        self, method: str, on: str, client: str = "agent", **parameters: Any
    ) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the body and headers of a request on a tool or resource."""
        body = {
            "jsonrpc": "2.0",
            "id": 1,
            "method": method,
            "params": {
                **parameters,
                "_meta": {
                    "io.modelcontextprotocol/protocolVersion": "2026-07-28",
                    "io.modelcontextprotocol/clientInfo": {"name": "test", "version": "1"},
                    "io.modelcontextprotocol/clientCapabilities": {},
                },
            },
        }
        headers = {
            "Authorization": f"Bearer {self._tokens[client]}",
            "Accept": "application/json, text/event-stream",
            "mcp-protocol-version": "2026-07-28",
            "mcp-method": method,
            "mcp-name": on,
        }
        return body, headers

    def facts(
        self, tool: str, arguments: Mapping[str, Any] | None = None, name: str = "agent"
    ) -> dict[str, Any]:
        """Return what a tool answers as data; it did not fail."""
        result = self.call(tool, arguments, name)
        assert not result.is_error, text_of(result)
        facts: dict[str, Any] = result.structured_content
        assert json.loads(text_of(result)) == facts
        return facts

    def refused(
        self, tool: str, arguments: Mapping[str, Any] | None = None, name: str = "agent"
    ) -> str:
        """Return why a tool did not do it."""
        result = self.call(tool, arguments, name)
        assert result.is_error, result
        return text_of(result)

    def approve(self, handle: str, name: str = "nurse", **more: Any) -> Mapping[str, Any]:
        """Have a principal decide."""
        return self.run(self.remote(name).approve(handle, **more))

    async def _open(self, name: str, mode: str) -> Any:
        stack = AsyncExitStack()
        token = self._tokens.get(name)
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        http = httpx2.AsyncClient(headers=headers, timeout=patience())
        await stack.enter_async_context(http)
        transport = streamable_http_client(self.url, http_client=http)
        client = Client(transport, mode=mode, read_timeout_seconds=patience())
        await stack.enter_async_context(client)
        return client, stack

    async def _connect(self, name: str) -> Any:
        stack = AsyncExitStack()
        url = f"ws://127.0.0.1:{self._ports[0]}/"
        robot = await stack.enter_async_context(connect(url, token=self._tokens.get(name)))
        return robot, stack

    async def _held(self, opening: Coroutine[Any, Any, Any]) -> Any:
        """Open something in a task that also closes it, as anyio wants it."""
        opened: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        async def hold() -> None:
            try:
                made, stack = await opening
            except BaseException as error:  # noqa: BLE001 - raised again where it is waited for
                opened.set_exception(error)
                return
            opened.set_result(made)
            await self._stop.wait()
            await stack.aclose()

        self._holding.append(asyncio.ensure_future(hold()))
        return await opened

    async def _end(self) -> None:
        self._stop.set()
        if self._holding:
            await asyncio.wait(self._holding)


def text_of(result: CallToolResult) -> str:
    """Return the text of a result."""
    return str(getattr(result.content[0], "text", ""))
