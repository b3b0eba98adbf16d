"""A server that restarts: its clients connect again, and ask again for what they had."""

from __future__ import annotations

import asyncio
import socket
import subprocess
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from pathlib import Path
from typing import Any, NoReturn

import pytest
from tests.processes import ForkedProgram
from tests.server.conftest import Between, Serve
from tests.server.robot import script
from tests.server.talk import SECONDS, eventually
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as ws_connect

from uoarm import ConnectionClosedError, RobotManager
from uoarm.client import RemoteRobot, connect
from uoarm.model import StatusEvent
from uoarm.server import Limits, Server, ServerOptions, serve_in_thread
from uoarm.testing import patience, slowness

Restart = Callable[[], Awaitable[None]]
FORMS = pytest.mark.parametrize("binary", [False, True], ids=["json", "cbor"])


class Restarting:
    """A server that can be stopped, and started again on its port."""

    def __init__(self, robot: RobotManager) -> None:
        self._robot = robot
        self._serving = self._serve(0)
        self.server = self._serving.__enter__()
        self.port = self.server.ports[0]

    @contextmanager
    def _serve(self, port: int) -> Iterator[Server]:
        with serve_in_thread(self._robot, ServerOptions(port=port, limits=Limits())) as server:
            yield server

    def stop(self) -> None:
        self._serving.__exit__(None, None, None)

    def start(self) -> None:
        self._serving = self._serve(self.port)
        self.server = self._serving.__enter__()


@pytest.fixture
def restarting(robot: RobotManager) -> Iterator[Restarting]:
    made = Restarting(robot)
    yield made
    made.stop()


FORKED = """
import sys
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, serve_in_thread

robot = RobotManager(loads("version: 1\\nbridges: {}\\nfunctions: {}"))
serving = serve_in_thread(robot, ServerOptions(port=0))
print(serving.__enter__().ports[0], flush=True)
sys.stdin.readline()
"""


def test_a_child_that_is_forked_holds_neither_port_nor_connections() -> None:
    with ForkedProgram(FORKED) as forked:
        port = int(forked.read())
        with ws_connect(f"ws://127.0.0.1:{port}/", open_timeout=patience()) as client:
            forked.write("connected")
            assert forked.read() == "forked"
            forked.kill_parent()
            with pytest.raises(ConnectionClosed):
                read_to_end(client)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port))


def read_to_end(client: ClientConnection) -> NoReturn:
    while True:
        client.recv(patience())


def joined(restarting: Restarting, **options: Any) -> AbstractAsyncContextManager[RemoteRobot]:
    return connect(f"ws://127.0.0.1:{restarting.port}/", **options)


async def restart(restarting: Restarting) -> None:
    await asyncio.to_thread(restarting.stop)
    await asyncio.to_thread(restarting.start)


async def until(condition: Callable[[], bool]) -> None:
    await asyncio.to_thread(eventually, condition, "what the test waits for")


@FORMS
@pytest.mark.parametrize("resume", [False, True])
async def test_a_stream_goes_on_after_a_restart_with_a_gap_that_is_marked(
    restarting: Restarting, binary: bool, resume: bool
) -> None:
    async with joined(restarting, binary=binary, resume=resume) as client:
        stream = await client.request("numbers")
        script.put({"value": 1})
        assert await stream.get() == {"value": 1}
        await restart(restarting)
        await until(lambda: stream.gaps == 1)
        script.put({"value": 2})
        assert await stream.get() == {"value": 2}
        assert (client.restarts, stream.lost, stream.state) == (1, 0, "open")
        assert await client.call("add", {"a": 1, "b": 2})
        await stream.kill()


async def test_what_waits_for_an_answer_fails_and_nothing_is_done_twice(
    restarting: Restarting,
) -> None:
    async with joined(restarting) as client:
        slow = asyncio.ensure_future(client.call("slow", {"value": 1}))
        await client.status()
        await restart(restarting)
        with pytest.raises(ConnectionClosedError):
            await slow
        script.release()


async def test_what_was_asked_during_a_drop_is_not_done_by_the_session_after(
    serve: Serve, between: Between, caplog: pytest.LogCaptureFixture
) -> None:
    """It has failed, and may be asked again by then."""
    caplog.set_level("INFO", "uoarm.audit")
    proxy = between(serve(Limits(resume_seconds=slowness())))

    async with connect(f"ws://127.0.0.1:{proxy.port}/") as client:
        await client.status()
        proxy.cut(admit=False)
        await until(lambda: proxy.refused > 0)
        lost = asyncio.ensure_future(client.call("add", {"a": 1, "b": 2}))
        await until(lambda: client.restarts == 1)
        proxy.admit()
        with pytest.raises(ConnectionClosedError):
            await lost
        assert await client.call("parrot", {"text": "polly"}) == {"text": "polly"}
    assert '"parrot"' in caplog.text
    assert '"add"' not in caplog.text


async def test_a_command_of_before_reaches_nothing_of_after(restarting: Restarting) -> None:
    """Names of connections are the server's: one of before may be another's after."""

    async with joined(restarting) as client:
        stream = await client.request("echo")
        await asyncio.to_thread(restarting.stop)
        await until(lambda: client.restarts == 1)
        with pytest.raises(ConnectionClosedError, match="nothing was sent"):
            await stream.send({"value": 5})
        call = asyncio.ensure_future(client.call("add", {"a": 1, "b": 2}))
        await asyncio.to_thread(restarting.start)
        assert await call
        await until(lambda: stream.gaps == 1)
        await stream.send({"value": 7})
        assert await stream.get() == {"value": 7}


async def test_changes_go_on(restarting: Restarting) -> None:
    async def until_running(changes: AsyncIterator[StatusEvent]) -> None:
        while (await anext(changes)).change != "running":
            pass

    async with joined(restarting) as client:
        changes = client.watch()
        first = asyncio.ensure_future(anext(changes))
        await asyncio.sleep(0)  # its question is sent before the next, which is answered after it
        await client.status()
        stream = await client.request("numbers")
        assert (await first).change
        await restart(restarting)
        await until(lambda: stream.gaps == 1)
        running = asyncio.ensure_future(until_running(changes))
        # What ran before the new session watches is in no event.
        while not running.done():
            await (await client.request("echo")).kill()
        await running


async def test_it_fails_where_reconnecting_is_off(restarting: Restarting) -> None:
    async with joined(restarting, reconnect=0) as client:
        stream = await client.request("numbers")
        await asyncio.to_thread(restarting.stop)
        with pytest.raises(ConnectionClosedError, match="closed the connection: the server stops"):
            await stream.get()
        assert stream.state == "failed"
        assert stream.cause
        restarting.start()


async def test_it_fails_with_the_cause_when_no_server_comes_back(restarting: Restarting) -> None:
    async with joined(restarting, reconnect=0.3) as client:
        stream = await client.request("numbers")
        await asyncio.to_thread(restarting.stop)
        with pytest.raises(ConnectionClosedError, match="connecting again failed"):
            await stream.get()
        restarting.start()


async def test_a_loop_that_ends_because_of_a_kill_has_its_cause(restarting: Restarting) -> None:
    async with joined(restarting) as client:
        stream = await client.request("numbers")
        connection = restarting.server._robot.connections()[0]
        killing = asyncio.to_thread(connection.kill)
        taking = asyncio.ensure_future(_all(stream))
        await killing
        assert await taking == []
        assert stream.state == "closed"
        assert "killed" in stream.cause


async def _all(stream: object) -> list[object]:
    return [message async for message in stream]  # type: ignore[attr-defined]


@pytest.mark.needs("node")
@pytest.mark.parametrize("form", ["json", "cbor"])
def test_the_javascript_client_begins_anew_too(restarting: Restarting, form: str) -> None:
    url = f"ws://127.0.0.1:{restarting.port}/"
    flags = ["--experimental-websocket", "--no-warnings"]
    program = Path(__file__).parent / "clients" / "with_restarts.mjs"
    command = ["node", *flags, str(program), url, form, str(SECONDS)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        does = {"stop": restarting.stop, "start": restarting.start}
        try:
            for line in process.stdout:
                word, _, value = line.strip().partition(" ")
                if word == "done":
                    break
                if word == "put":
                    script.put({"value": int(value)})
                else:
                    assert word in does, line + process.stdout.read()
                    does[word]()
                process.stdin.write("\n")
                process.stdin.flush()
            assert process.wait(SECONDS) == 0
        finally:
            process.kill()
    restarting.start()
