"""The Python client against the server, in both forms."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.processes import ForkedProgram, signal_beside
from tests.server.conftest import Serve
from tests.server.robot import END, script
from typing_extensions import assert_type
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import InvalidStatus
from websockets.typing import Subprotocol

from uoarm import (
    BridgeError,
    BridgeTimeoutError,
    ConnectionClosedError,
    MessageError,
    QueuePolicy,
    ResolutionError,
    RobotManager,
    UsageError,
)
from uoarm.bridge import (
    Description,
    Registry,
    ServiceStructures,
)
from uoarm.client import RemoteRobot, RemoteStream, ServerError, ThreadAnswer, connect
from uoarm.client._socket import ClientSocket
from uoarm.config import loads
from uoarm.local import Shape
from uoarm.model import Endpoint, Message, MessageStructure, OverflowPolicy
from uoarm.server import (
    Limits,
    Server,
    ServerOptions,
    hash_token,
    serve_in_thread,
)
from uoarm.testing import MemoryBridge, Script, patience, wait

Work = Callable[[RemoteRobot], Awaitable[None]]
FORMS = pytest.mark.parametrize("binary", [False, True], ids=["json", "cbor"])


def joined(server: Server, **options: Any) -> AbstractAsyncContextManager[RemoteRobot]:
    return connect(f"ws://127.0.0.1:{server.ports[0]}/", **options)


@FORMS
@pytest.mark.parametrize(
    "strange", [object(), {1: 2}, {1.5}, 1j], ids=["object", "names", "set", "complex"]
)
async def test_messages_come_and_gaps_are_counted(
    server: Server, binary: bool, strange: object
) -> None:
    async with joined(server, binary=binary) as client:
        stream = await client.request("numbers", queue=QueuePolicy(length=100))
        script.put({"value": 1}, {"value": strange}, {"value": 3}, END)
        assert [message["value"] async for message in stream] == [1, 3]
        assert stream.lost == 1
        with pytest.raises(ConnectionClosedError, match="finished"):
            await stream.get()


async def test_who_asks_for_the_latest_reads_that_however_late(server: Server) -> None:
    async with joined(server) as client:
        stream = await client.request("numbers", queue=QueuePolicy(policy=OverflowPolicy.LATEST))
        for number in range(1, 6):
            script.put({"value": number})
            while stream._last != number:  # noqa: ASYNC110 - there is no event of it
                await asyncio.sleep(0.01)
        script.put(END)
        assert [message["value"] async for message in stream] == [5]
        assert stream.lost == 4


cameras = Script()
camera = cameras.source(Annotated[NDArray[np.uint8], Shape(None, None, 3)])


async def test_pictures_come_as_arrays_of_numpy() -> None:
    """In full HD they are more values than a client reads one by one."""
    text = """
    version: 1
    bridges: {python: {}}
    functions:
      camera:
        components:
          - name: camera
            bridge: python
            output: {endpoint: ["tests.server.test_client:camera"]}
    """
    picture = np.ones((1080, 1920, 3), "u1")
    cameras.reset()
    with (
        RobotManager(loads(text, origin=__file__)) as robot,
        serve_in_thread(robot, ServerOptions(port=0)) as server,
    ):
        async with joined(server) as client:
            stream = await client.request("camera")
            cameras.put(picture, picture[:0], Script.END)
            got = [message async for message in stream]
    assert np.array_equal(got[0], picture)
    assert got[1].shape == (0, 1920, 3)


@pytest.mark.parametrize(
    ("function", "why"),
    [
        ("numbers", "the server could not send the last message: .*object"),
        ("doubled", "numbers is degraded: its output 'default' gave what does not match"),
    ],
)
async def test_a_silence_says_what_was_refused_last(
    server: Server, monkeypatch: pytest.MonkeyPatch, function: str, why: str
) -> None:
    monkeypatch.setattr("uoarm.client._client._DIAGNOSIS_SECONDS", patience())

    async with joined(server) as client:
        stream = await client.request(function)
        script.put({"value": 1}, {"value": object()})
        await stream.get(patience())
        said = ""
        while not re.search(why, said):  # until it has come so far; `run` bounds it
            said = "; ".join(await client._diagnose(stream.connection))
            said += f"the server could not send the last message: {stream._refusal}"
        with pytest.raises(TimeoutError, match=rf"^no message within .* s; {why}"):
            await stream.get(0.01)
        script.put({"value": 2}, END)
        await stream.get(patience())


@FORMS
async def test_a_message_that_is_too_much_is_lost_and_nothing_else(
    server: Server, binary: bool
) -> None:
    async with joined(server, binary=binary) as client:
        stream = await client.request("numbers", validate="off")
        script.put({"value": 1}, {"value": [0] * 2_000_000}, {"value": 2}, END)
        assert [message async for message in stream] == [{"value": 1}, {"value": 2}]
        assert stream.lost == 1
        assert await client.call("add", {"a": 1, "b": 2}, timeout=patience()) == {"value": 3}


@FORMS
async def test_what_is_too_much_for_the_server_has_an_answer(server: Server, binary: bool) -> None:
    deep: Any = 1
    for _ in range(100):
        deep = [deep]
    async with joined(server, binary=binary, answer=patience()) as client:
        for message, why in (([0] * 600_000, "500,000 values"), (deep, "nest")):
            with pytest.raises(ServerError, match=why) as caught:
                await client.call("anything", {"value": message, "id": "1"}, timeout=patience())
            assert caught.value.code == "unreadable"


@FORMS
async def test_messages_are_sent_in_order(server: Server, binary: bool) -> None:
    async with joined(server, binary=binary) as client:
        async with await client.request("echo") as echo:
            assert echo.inputs == ("default",)
            await asyncio.gather(*(echo.send({"value": value}) for value in range(50)))
            assert [(await echo.get(patience()))["value"] for _ in range(50)] == list(range(50))
            with pytest.raises(MessageError, match="value"):
                await echo.send({"value": 300})
            with pytest.raises(UsageError):
                await echo.send({"value": 1}, "other")
        await echo.kill()
        assert not (await client.status())["own"]


@dataclass
class Number:
    value: int


@dataclass
class Picture:
    width: int
    data: bytes


@FORMS
async def test_messages_come_and_go_as_types_of_the_client(server: Server, binary: bool) -> None:
    async with joined(server, binary=binary) as client:
        async with await client.request("picture", as_type=Picture) as pictures:
            assert_type(pictures, RemoteStream[Picture])
            script.put({"width": 1, "data": b"\x00\xff"})
            picture = await pictures.get(patience())
            assert_type(picture, Picture)
            assert picture == Picture(1, b"\x00\xff")
        async with await client.request("echo", as_type=Number) as echo:
            await echo.send(Number(7))
            assert await echo.get(patience()) == Number(7)
            with pytest.raises(MessageError, match="value: expected an integer"):
                await echo.send(Number("seven"))  # type: ignore[arg-type] # which is the point
        with pytest.raises(UsageError, match="function 'echo' may give messages that are no Pict"):
            await client.request("echo", as_type=Picture)
        with pytest.raises(UsageError, match="the reply of 'add' may give messages that are no"):
            await client.call("add", {"a": 1, "b": 2}, as_type=Picture)


async def test_octets_stay_octets(server: Server) -> None:
    async with joined(server) as client:
        stream = await client.request("picture")
        script.put({"width": 1, "data": bytes(10_000)})
        assert (await stream.get(patience()))["data"] == bytes(10_000)


async def test_calls_and_their_errors(server: Server) -> None:
    async with joined(server) as client:
        assert await client.call("add", {"a": 1, "b": 2}) == {"value": 3}
        with pytest.raises(BridgeError, match="cannot do 5"):
            await client.call("broken", {"value": 5})
        with pytest.raises(BridgeTimeoutError):
            await client.call("slow", {"value": 5}, timeout=0.05)
        with pytest.raises(MessageError):
            await client.call("add", {"a": 1})
        with pytest.raises(ResolutionError, match="nothing"):
            await client.request("missing")
        with pytest.raises(UsageError):
            await client.call("numbers", {})


async def test_a_slow_call_holds_up_nothing(server: Server) -> None:
    async with joined(server) as client:
        slow = asyncio.ensure_future(client.call("slow", {"value": 1}))
        assert await client.call("add", {"a": 1, "b": 2}) == {"value": 3}
        script.gate.set()
        assert await slow == {"value": 1}


async def test_looking_around(server: Server) -> None:
    async with joined(server) as client:
        assert {"numbers", "add"} <= {function["name"] for function in await client.functions()}
        assert "numbers" in (await client.resolve("doubled"))["text"]
        assert client.hello["protocol"] == 1
        async with await client.request("numbers"):
            assert (await client.status())["own"][0]["received"] == 0


async def test_changes_are_watched(server: Server) -> None:
    async with joined(server) as client:

        async def changes() -> list[str]:
            seen: list[str] = []
            async for event in client.watch():
                seen.append(event.change)
                if event.change == "closed":
                    break
            return seen

        watching = asyncio.ensure_future(changes())
        await asyncio.sleep(0)  # its question is sent before the next, which is answered after it
        await client.status()
        async with await client.request("numbers"):
            pass
        assert await watching == ["opening", "running", "closed"]


async def test_a_request_that_is_given_up_is_given_back(
    server: Server, robot: RobotManager
) -> None:
    async with joined(server) as client:
        asking = asyncio.ensure_future(client.request("numbers"))
        # In turns of the loop and then without it, so that the answer is not read before.
        while not client._link._unanswered:  # noqa: ASYNC110 - there is no event of it
            await asyncio.sleep(0)
        wait(lambda: robot.status().connections, "it was not opened")
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking
        await asyncio.to_thread(wait, lambda: not robot.status().connections)


@pytest.mark.parametrize("is_before", [True, False], ids=["before", "after"])
async def test_a_request_that_is_given_up_in_the_turn_of_its_answer_is_given_back(
    server: Server, robot: RobotManager, is_before: bool
) -> None:
    async with joined(server) as client:
        take = client._link._take

        def take_and_give_up(received: Mapping[str, Any]) -> None:
            if received["op"] == "Reply" and is_before:
                asking.cancel()
            take(received)
            if received["op"] == "Reply":
                asking.cancel()

        client._link._take = take_and_give_up
        asking = asyncio.ensure_future(client.request("numbers"))
        with pytest.raises(asyncio.CancelledError):
            await asking
        await asyncio.to_thread(wait, lambda: not robot.status().connections)


class Reaching(MemoryBridge):
    """A bridge whose one service can be cancelled, and ends in no other way."""

    def __init__(self) -> None:
        super().__init__("arm")
        self.called, self.over = threading.Event(), threading.Event()

    def _describe(self, endpoint: Endpoint) -> Description:
        return Description(
            request=MessageStructure(schema=True), reply=MessageStructure(schema=True)
        )

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        with self.cancelling(self.over.set):
            self.called.set()
            assert self.over.wait(patience())
            raise BridgeError("it was cancelled")

    def _close(self) -> None:
        self.over.set()


REACHING = """
version: 1
bridges: {arm: {plugin: python}}
functions: {reach: {components: [{name: arm, bridge: arm, service: {endpoint: [reach]}}]}}
"""


@asynccontextmanager
async def reaching(arm: Reaching, **options: Any) -> AsyncIterator[RemoteRobot]:
    robot = RobotManager(loads(REACHING), registry=Registry(()), bridges={"arm": arm})
    with robot, serve_in_thread(robot, ServerOptions(port=0)) as server:
        async with joined(server, **options) as client:
            yield client


async def test_a_call_that_is_given_up_is_cancelled_there() -> None:
    arm = Reaching()
    async with reaching(arm) as client:
        calling = asyncio.ensure_future(client.call("reach", {}, timeout=patience()))
        await asyncio.to_thread(arm.called.wait, patience())
        calling.cancel()
        with pytest.raises(asyncio.CancelledError):
            await calling
        assert await asyncio.to_thread(arm.over.wait, patience())


def asked_in_thread(
    client: RemoteRobot, kind: str, timeout: float, session: int = 0
) -> Awaitable[Message]:
    """Call a service in a thread that is not the client's."""
    began: list[object] = []
    return asyncio.to_thread(
        client.ask_in_thread, "Call", kind, timeout, session, began.append, jsonMessage={}
    )


@FORMS
async def test_a_thread_asks_beside_the_loop(binary: bool) -> None:
    """Of JSON the loop writes; of CBOR the thread does."""
    arm = Reaching()
    async with reaching(arm, binary=binary) as client:
        with pytest.raises(ResolutionError):
            await asked_in_thread(client, "nowhere", patience())
        with pytest.raises(ConnectionClosedError, match="begun anew"):
            await asked_in_thread(client, "reach", patience(), session=1)
        assert not arm.called.is_set()
        with pytest.raises(TimeoutError):
            await asked_in_thread(client, "reach", 0.2)
        # It was sent, and ends there, since it is not waited for any more.
        assert await asyncio.to_thread(arm.over.wait, patience())
        assert {asked.fields["op"] for asked in client._asked.values()} <= {"Kill"}


async def test_what_a_thread_gave_up_before_it_was_sent_never_is() -> None:
    arm = Reaching()
    async with reaching(arm) as client:
        client._link._end_sending()  # as while the connection is made anew
        with pytest.raises(TimeoutError):
            await asked_in_thread(client, "reach", 0.05)
        client._link._begin_to_send()
        assert [function["name"] for function in await client.functions()] == ["reach"]
        assert not client._sending
        assert not arm.called.is_set()


async def test_when_the_server_closes_everything_that_waits_fails(serve: Serve) -> None:
    server = serve(Limits(message_bytes=2000))

    async with joined(server) as client:
        stream = await client.request("numbers")
        slow = asyncio.ensure_future(client.call("slow", {"value": 1}))
        await client.status()
        client._link.most = None  # as a client that does not know: the server closes
        with pytest.raises(
            ConnectionClosedError, match=f"to the server at ws://.*:{server.ports[0]}/"
        ):
            await client.call("add", {"a": "x" * 3000})
        with pytest.raises(ConnectionClosedError):
            await slow
        with pytest.raises(ConnectionClosedError):
            await stream.get()
        with pytest.raises(ConnectionClosedError):
            await client.functions()


@FORMS
async def test_what_is_longer_than_the_server_takes_ends_itself_only(
    serve: Serve, binary: bool
) -> None:
    server = serve(Limits(message_bytes=2000))

    async with joined(server, binary=binary) as client:
        stream = await client.request("numbers")
        long = "the message has 3,0.. octets; the server takes 2,000 at most"
        with pytest.raises(MessageError, match=long):
            await client.call("add", {"a": "x" * 3000})
        with pytest.raises(MessageError, match=long):
            await asked_in_thread(client, "x" * 3000, patience())
        assert await client.call("add", {"a": 1, "b": 2})
        await stream.kill()


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("foo", "foo isn't a valid URI"),
        ("ws://10.0.0.1:99999/", "Port out of range"),
        ("ws://[::1/", "Invalid IPv6"),
        ("ws://user:secret@", r"ws://\*\*\*@"),
    ],
)
async def test_what_is_no_address_is_refused(url: str, why: str) -> None:
    with pytest.raises(UsageError, match=rf"expected ws://HOST:PORT/ or wss://HOST:PORT/: .*{why}"):
        await connect(url).__aenter__()


async def test_a_token_is_shown_and_a_denial_has_its_code(serve: Serve, tmp_path: Path) -> None:
    access = tmp_path / "access.yaml"
    access.write_text(
        "version: 1\nroles: {none: {}}\n"
        f"tokens: [{{name: x, role: none, sha256: {hash_token('secret')}}}]\n"
    )
    server = serve(access=access)

    async with joined(server, token="secret") as client:
        with pytest.raises(ServerError) as denied:
            await client.request("numbers")
        assert denied.value.code == "denied"
    with pytest.raises(InvalidStatus):
        async with joined(server):
            """It is not let in without one."""


HELLO = '{"op":"Status","type":"hello","jsonMessage":{}}'


async def test_a_server_that_closes_at_once_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = ClientSocket.open

    async def open_until_closed(*arguments: Any, **options: Any) -> ClientSocket:
        socket = await opened(*arguments, **options)
        await socket.wait_closed()
        return socket

    monkeypatch.setattr(ClientSocket, "open", open_until_closed)

    async def close(connection: ServerConnection) -> None:
        await connection.close(1008, "go away")

    protocols = [Subprotocol("uoarm.v1.cbor")]
    async with serve(close, "127.0.0.1", 0, subprotocols=protocols) as server:
        url = f"ws://127.0.0.1:{next(iter(server.sockets)).getsockname()[1]}/"
        async with connect(url) as client:
            with pytest.raises(ConnectionClosedError, match="go away"):
                await client.functions()


async def test_a_client_that_is_refused_for_good_as_it_comes_again_comes_no_more() -> None:
    came: list[ServerConnection] = []

    async def greet(connection: ServerConnection) -> None:
        came.append(connection)
        if len(came) > 1:
            await connection.close(1008, "its rights have changed")
            return
        await connection.send(HELLO)
        await connection.recv()
        connection.transport.abort()

    protocols = [Subprotocol("uoarm.v1.json")]
    async with serve(greet, "127.0.0.1", 0, subprotocols=protocols) as server:
        url = f"ws://127.0.0.1:{next(iter(server.sockets)).getsockname()[1]}/"
        async with connect(url, binary=False, reconnect=1e9) as client:
            cause = await asyncio.wait_for(client.ended(), patience())
    assert "connecting again failed" in cause
    assert cause.endswith("its rights have changed")
    assert len(came) == 2


FORKED = """
import asyncio, sys
from uoarm.client import connect

connecting = connect(sys.argv[1])
asyncio.new_event_loop().run_until_complete(connecting.__aenter__())
"""


async def test_a_child_that_is_forked_holds_no_connection() -> None:
    ended = asyncio.Event()

    async def wait_for_end(connection: ServerConnection) -> None:
        await connection.wait_closed()
        ended.set()

    protocols = [Subprotocol("uoarm.v1.cbor")]
    options: dict[str, Any] = {"subprotocols": protocols, "ping_interval": None}
    async with serve(wait_for_end, "127.0.0.1", 0, **options) as server:
        url = f"ws://127.0.0.1:{next(iter(server.sockets)).getsockname()[1]}/"
        with ForkedProgram(FORKED, url) as forked:
            assert await asyncio.to_thread(forked.read) == "forked"
            forked.kill_parent()
            await asyncio.wait_for(ended.wait(), patience())


@pytest.mark.parametrize(
    "frame",
    [
        "[" * 100_000,
        f'{{"op":"Data","type":"c1","jsonMessage":[{"[]," * 1_500_000}[]]}}',
        "{}",
        '{"op":"Status","type":"change","jsonMessage":{"x":1}}',
        '{"op":"Status","type":"connection","jsonMessage":[]}',
        '{"op":"Error","id":"1","jsonMessage":null}',
        '{"op":"Reply","id":"1","jsonMessage":{"connection":"c1"}}',
        b"binary",
    ],
    ids=lambda item: str(item[:50]),
)
async def test_a_server_that_sends_rubbish_is_left_with_a_plain_error(frame: str | bytes) -> None:
    async def rubbish(socket: ServerConnection) -> None:
        await socket.send(HELLO)
        async for asked in socket:
            if b"Request" in (asked if isinstance(asked, bytes) else asked.encode()):
                await socket.send(frame)

    protocols = [Subprotocol("uoarm.v1.json")]
    async with serve(rubbish, "127.0.0.1", 0, subprotocols=protocols) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        async with connect(f"ws://127.0.0.1:{port}", binary=False) as client:
            said = f"the server at ws://127.0.0.1:{port} sent what is no message"
            with pytest.raises(ConnectionClosedError, match=said):
                await asyncio.wait_for(client.request("numbers"), patience())


def test_a_signal_that_came_in_another_thread_is_handled_while_an_answer_is_awaited() -> None:
    answer = ThreadAnswer()
    with signal_beside(lambda: answer.set_result("handled"), ThreadAnswer.wait):
        assert answer.wait(patience()) == "handled"
