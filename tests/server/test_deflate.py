"""permessage-deflate: texts are compressed where the server has it on and a client asks for it."""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, TypeVar

import pytest
from tests.server.browser import Browser
from tests.server.conftest import Serve
from tests.server.talk import SECONDS, Talk
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.extensions.permessage_deflate import ClientPerMessageDeflateFactory
from websockets.frames import CloseCode
from websockets.typing import Subprotocol

from uoarm.client import connect as connect_robot
from uoarm.server import Limits, Server

T = TypeVar("T")
TEXTS = [Subprotocol("uoarm.v1.json")]


class Counting(ClientConnection):
    """Counts the octets that arrive."""

    octets = 0

    def data_received(self, data: bytes) -> None:
        self.octets += len(data)
        super().data_received(data)


def talking(server: Server, talk: Callable[[Counting], Awaitable[T]], **options: Any) -> T:
    """Return what comes of talking to a server in JSON."""

    async def begin() -> T:
        url = f"ws://127.0.0.1:{server.ports[0]}"
        async with connect(
            url, create_connection=Counting, subprotocols=TEXTS, max_size=None, **options
        ) as socket:
            assert isinstance(socket, Counting)
            await socket.recv()  # the hello
            return await talk(socket)

    return asyncio.run(asyncio.wait_for(begin(), SECONDS))


async def asked(socket: Counting, **message: Any) -> Any:
    """Send a control message, and return what comes next."""
    await socket.send(json.dumps(message))
    return json.loads(await socket.recv())


def extensions(socket: Counting) -> str:
    assert socket.response is not None
    return socket.response.headers.get("Sec-WebSocket-Extensions", "")


async def list_many(socket: Counting) -> tuple[str, int, Any]:
    """Return what was negotiated, how many octets a list of functions took, and the list."""
    before = socket.octets
    report = await asked(socket, op="List", id="1")
    return extensions(socket), socket.octets - before, report


def test_nothing_is_compressed_unless_the_server_is_configured_to(server: Server) -> None:
    negotiated, octets, report = talking(server, list_many)
    assert negotiated == ""
    assert octets > len(json.dumps(report, separators=(",", ":")))


def test_texts_are_compressed_for_clients_that_ask_for_it(serve: Serve) -> None:
    server = serve(deflate=True)
    negotiated, octets, report = talking(server, list_many)
    assert negotiated.startswith("permessage-deflate")
    assert "server_no_context_takeover" in negotiated
    assert octets < len(json.dumps(report)) / 2
    assert talking(server, list_many, compression=None)[2] == report


def test_a_client_may_want_a_small_window(serve: Serve) -> None:
    small = [ClientPerMessageDeflateFactory(server_max_window_bits=9)]
    negotiated, _, report = talking(serve(deflate=True), list_many, extensions=small)
    assert "server_max_window_bits=9" in negotiated
    assert report["op"] == "Reply"


def test_messages_of_every_kind_pass_there_and_back(serve: Serve) -> None:
    """Short, long, longest, and such as do not get shorter."""
    letters = [chr(index) for index in range(0x20, 0x7F)]
    draw = random.Random(5)
    texts = ["", "a" * 100_000, "".join(draw.choices(letters, k=20_000)), "é" * 700]

    async def parrot(socket: Counting) -> list[str]:
        got = []
        for text in texts:
            received = await asked(
                socket, op="Call", type="parrot", id="1", jsonMessage={"text": text}
            )
            got.append(received["jsonMessage"]["text"])
        return got

    assert talking(serve(deflate=True), parrot) == texts


def test_a_small_message_that_becomes_huge_ends_its_client_only(serve: Serve) -> None:
    server = serve(Limits(message_bytes=1_000_000), deflate=True)

    async def flood(socket: Counting) -> int | None:
        with suppress(ConnectionClosed):
            await socket.send("[" + "1," * 4_000_000)
        await socket.wait_closed()
        return socket.close_code

    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as other:
        assert talking(server, flood) == CloseCode.MESSAGE_TOO_BIG
        assert other.ask("List")


def test_the_python_client_asks_for_it_where_it_speaks_json(serve: Serve) -> None:
    server = serve(deflate=True)

    async def call(binary: bool) -> Any:
        async with connect_robot(f"ws://127.0.0.1:{server.ports[0]}", binary=binary) as robot:
            return await robot.call("parrot", {"text": "a" * 100_000})

    assert asyncio.run(call(False)) == asyncio.run(call(True)) == {"text": "a" * 100_000}


ASK = """new Promise((resolve) => {
  const socket = new WebSocket(`ws://${location.host}/`, "uoarm.v1.json");
  let count = 0;
  socket.onmessage = ({ data }) => {
    count += 1;
    if (count === 1) socket.send(JSON.stringify({ op: "List", id: "1" }));
    else resolve([socket.extensions, JSON.parse(data).op]);
  };
})"""


@pytest.mark.needs("chromium")
def test_a_browser_asks_for_it_and_reads_what_comes(serve: Serve, browser: Browser) -> None:
    server = serve(deflate=True)
    browser.go(f"http://127.0.0.1:{server.ports[0]}/")
    browser.until("document.querySelector('.link-state.open')")
    extensions, report = browser.js(ASK)
    assert extensions.startswith("permessage-deflate")
    assert report == "Reply"
