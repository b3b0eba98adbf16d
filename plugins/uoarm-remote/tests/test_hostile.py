"""Peers that are no managers, or bad ones: they cost a bounded time, and end with their name."""

from __future__ import annotations

import asyncio
import struct
import threading
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any, Protocol

import pytest
from robots import here
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from uoarm import RobotManager
from uoarm._wire import BINARY_FORM
from uoarm.config import loads
from uoarm.errors import ResolutionError, UoarmError
from uoarm.model import Budget, BudgetUse
from uoarm.testing import patience, wait

Answer = Callable[[ServerConnection, Mapping[str, Any]], Awaitable[bool]]
IDENTITY = "f" * 32
DESK = """
version: 1
bridges:
  bad:
    {{plugin: remote, options: {{url: "{url}", timeout: {time}, silence: {silence}, grace: 1}}}}
functions: {{f: {{components: [{{name: far, bridge: bad, output: {{endpoint: [f]}}}}]}}}}
"""


def plan(schema: object = True, managers: object = (IDENTITY,), **component: Any) -> dict[str, Any]:
    provider = {
        "component": {"name": "c", "inputs": [], **component},
        "structures": {"output.default": {"schema": schema}},
    }
    return {"plan": {"steps": [provider]}, "managers": managers}


GREETING = {
    "op": "Status",
    "type": "hello",
    "jsonMessage": {"protocol": 1, "manager": IDENTITY, "time": time.time()},
}
REPLIES: Mapping[str, Any] = {
    "Resume": {"key": "k" * 20, "seconds": 30},
    "List": {"functions": [{"name": "f"}]},
    "Resolve": plan(),
    "Request": {"connection": "c1", "inputs": [], "warnings": []},
}


class Peer:
    """Speaks the protocol in a thread; `answer` may answer in its own way, and says whether."""

    def __init__(self, answer: Answer) -> None:
        self._answer = answer
        self._loop = asyncio.new_event_loop()
        self._ready, self._over = threading.Event(), asyncio.Event()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._run(),))
        self._thread.start()
        assert self._ready.wait(patience())

    async def _run(self) -> None:
        subprotocols = [Subprotocol(BINARY_FORM.subprotocol)]
        async with serve(
            self._attend, "127.0.0.1", 0, subprotocols=subprotocols, close_timeout=patience()
        ) as server:
            self.url = f"ws://127.0.0.1:{next(iter(server.sockets)).getsockname()[1]}/"
            self._ready.set()
            await self._over.wait()
            for connection in server.connections:
                connection.transport.abort()

    async def _attend(self, connection: ServerConnection) -> None:
        await connection.send(BINARY_FORM.write(GREETING))
        async for frame in connection:
            asked = BINARY_FORM.read(frame, BudgetUse(Budget()))
            if not await self._answer(connection, asked):
                reply = {"op": "Reply", "id": asked["id"], "jsonMessage": REPLIES.get(asked["op"])}
                await connection.send(BINARY_FORM.write(reply))

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(patience())
        self._loop.close()


class Meet(Protocol):
    def __call__(self, answer: Answer, silence: float = ...) -> RobotManager: ...


@pytest.fixture
def meet() -> Iterator[Meet]:
    with ExitStack() as stack:

        def begin(answer: Answer, silence: float = patience()) -> RobotManager:
            peer = Peer(answer)
            stack.callback(peer.close)
            text = DESK.format(url=peer.url, time=patience(), silence=silence)
            return stack.enter_context(RobotManager(loads(text, origin=here("desk.yaml"))))

        yield begin


def link_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if "uoarm-remote" in thread.name]


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (None, "NoneType"),
        ([], "list"),
        ({"plan": {"steps": []}}, "IndexError"),
        (plan(schema=5), "expected a schema, got int"),
        (plan(schema={"allOf": [{"type": "object"}] * 50_000}), "more than 4,194,304 octets"),
        (plan(managers="f" * 1_000_000), "8 managers at most"),
        (plan(managers=["f"] * 9), "8 managers at most"),
        (plan(inputs=5), "TypeError"),
    ],
    ids=["nothing", "list", "no-steps", "no-schema", "large", "text", "long-way", "inputs"],
)
def test_what_is_no_plan_is_refused_with_whose_it_is(meet: Meet, answer: Any, said: str) -> None:
    async def lie(connection: ServerConnection, asked: Mapping[str, Any]) -> bool:
        if asked["op"] != "Resolve":
            return False
        reply = {"op": "Reply", "id": asked["id"], "jsonMessage": answer}
        await connection.send(BINARY_FORM.write(reply))
        return True

    with pytest.raises(ResolutionError, match="its plan of 'f' cannot be read") as caught:
        meet(lie).request("f")
    assert said in str(caught.value)
    assert "the manager at ws://127.0.0.1:" in str(caught.value)


def flooding(*strange: object) -> Answer:
    """Answer a request with more than is ever read, and something strange behind the first."""

    async def flood(connection: ServerConnection) -> None:
        frame = BINARY_FORM.write_data("c1", 1, {"data": bytes(5_000)})
        try:
            await connection.send(frame)
            for message in strange:
                await connection.send(BINARY_FORM.write(message))
            while True:
                await connection.send(frame)
        except ConnectionClosed:
            return

    async def answer(connection: ServerConnection, asked: Mapping[str, Any]) -> bool:
        if asked["op"] != "Request":
            return False
        reply = {"op": "Reply", "id": asked["id"], "jsonMessage": REPLIES["Request"]}
        await connection.send(BINARY_FORM.write(reply))
        await flood(connection)
        return True

    return answer


def test_a_link_that_is_flooded_is_closed_at_once(meet: Meet) -> None:
    manager = meet(flooding())
    connection = manager.request("f")
    connection.get(patience())
    manager.close()
    assert not link_threads()


def test_something_strange_in_a_flood_ends_the_connection(meet: Meet) -> None:
    manager = meet(flooding({"op": "Status", "type": "change", "jsonMessage": {}}))
    connection = manager.request("f")
    wait(lambda: connection.state.value == "failed", "it was not noticed")
    assert "the server sent what is no message" in connection.cause


def halving(read: threading.Event, end: Callable[[ServerConnection], None]) -> Answer:
    """Give a message, half of another when that is read, and nothing to any who come again."""
    begun = threading.Event()

    async def answer(connection: ServerConnection, asked: Mapping[str, Any]) -> bool:
        if asked["op"] == "Request":
            begun.set()
            reply = {"op": "Reply", "id": asked["id"], "jsonMessage": REPLIES["Request"]}
            await connection.send(BINARY_FORM.write(reply))
            await connection.send(BINARY_FORM.write_data("c1", 1, 1))
            await asyncio.to_thread(read.wait, patience())
            content = BINARY_FORM.write_data("c1", 2, bytes(50_000))
            head = struct.pack("!BBH", 0x82, 126, len(content))  # whole, binary, its length in two
            connection.transport.write(head + content[: len(content) // 2])
        if begun.is_set():
            end(connection)
        return begun.is_set()

    return answer


def stop_reading(connection: ServerConnection) -> None:
    connection.transport.pause_reading()


def abort(connection: ServerConnection) -> None:
    connection.transport.abort()


@pytest.mark.parametrize(
    ("end", "silence", "why"),
    [
        (stop_reading, 1.0, "nothing came for 1 s"),
        (abort, patience(), "no close frame received or sent"),
    ],
    ids=["then-nothing", "then-the-end"],
)
def test_half_a_message_breaks_the_link_for_one_cause(
    meet: Meet, end: Callable[[ServerConnection], None], silence: float, why: str
) -> None:
    read = threading.Event()
    connection = meet(halving(read, end), silence).request("f")
    assert connection.get(patience()) == 1
    read.set()
    wait(lambda: connection.state.value == "failed", "it was not noticed")
    assert connection.cause.count("the manager at ws://127.0.0.1:") == 1
    assert why in connection.cause
    with pytest.raises(UoarmError):  # half of a message is none
        connection.get(patience())


def test_a_frame_of_half_a_message_ends_the_connection(meet: Meet) -> None:
    read = threading.Event()

    async def halve(connection: ServerConnection, asked: Mapping[str, Any]) -> bool:
        if asked["op"] != "Request":
            return False
        reply = {"op": "Reply", "id": asked["id"], "jsonMessage": REPLIES["Request"]}
        await connection.send(BINARY_FORM.write(reply))
        content = BINARY_FORM.write_data("c1", 1, bytes(50_000))
        await connection.send(content)
        await asyncio.to_thread(read.wait, patience())
        await connection.send(content[: len(content) // 2])
        return True

    connection = meet(halve).request("f")
    connection.get(patience())
    read.set()
    wait(lambda: connection.state.value == "failed", "it was not noticed")
    assert "the server sent what is no message" in connection.cause


def test_a_peer_that_answers_nothing_holds_up_nothing(meet: Meet) -> None:
    asked: list[str] = []

    async def stall(connection: ServerConnection, message: Mapping[str, Any]) -> bool:
        asked.append(message["op"])
        stalls = "Resolve" in asked
        if stalls:
            connection.transport.pause_reading()
        return stalls

    manager = meet(stall)
    with pytest.raises(UoarmError):
        manager.resolve("f", timeout=0.1)
    wait(lambda: "Resolve" in asked, "it was not asked")
    manager.close()
    wait(lambda: not link_threads(), "a thread is left over")


def test_messages_are_as_they_are_counted_whatever_their_numbers(meet: Meet) -> None:
    """A number that goes back, or is far ahead, is counted, and is no memory."""

    async def number(connection: ServerConnection, asked: Mapping[str, Any]) -> bool:
        if asked["op"] != "Request":
            return False
        reply = {"op": "Reply", "id": asked["id"], "jsonMessage": REPLIES["Request"]}
        await connection.send(BINARY_FORM.write(reply))
        for place in (5, 1, -3, 10**12):
            await connection.send(BINARY_FORM.write_data("c1", place, place))
        return True

    with meet(number).request("f") as connection:
        assert [connection.get(patience()) for _ in range(4)] == [5, 1, -3, 10**12]
