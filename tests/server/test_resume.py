"""Sessions that go on after the connection was cut, for real, by a proxy in between."""

from __future__ import annotations

import asyncio
import json
import subprocess
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.server.conftest import Between, Serve
from tests.server.robot import END, script
from tests.server.talk import BESIDE, SECONDS, eventually
from tests.server.test_serving import figures, page

from uoarm import BridgeTimeoutError, ConnectionClosedError, QueuePolicy, RobotManager
from uoarm.client import RemoteRobot, connect
from uoarm.model import Message
from uoarm.server import Limits, Server
from uoarm.testing import Proxy, slowness

CLIENTS = Path(__file__).parent / "clients"
FORMS = pytest.mark.parametrize("binary", [False, True], ids=["json", "cbor"])


def joined(proxy: Proxy, **options: Any) -> AbstractAsyncContextManager[RemoteRobot]:
    return connect(f"ws://127.0.0.1:{proxy.port}/", **options)


async def until(condition: Callable[[], bool]) -> None:
    await asyncio.to_thread(eventually, condition, "what the test waits for")


@asynccontextmanager
async def resumed(client: RemoteRobot) -> AsyncIterator[None]:
    """Wait after the block until the session goes on."""
    before = client.resumed
    yield
    await until(lambda: client.resumed > before)


@FORMS
async def test_a_stream_goes_on_where_it_was(
    server: Server, between: Between, binary: bool
) -> None:
    proxy = between(server)
    async with joined(proxy, binary=binary) as client:
        stream = await client.request("numbers")
        for start in (0, 3, 6):
            script.put({"value": start})
            assert await stream.get() == {"value": start}
            async with resumed(client):
                proxy.cut(admit=False)
                await until(lambda: clients(server) == 0)
                script.put({"value": start + 1}, {"value": start + 2})
                proxy.admit()
            assert [await stream.get() for _ in range(2)] == [
                {"value": start + 1},
                {"value": start + 2},
            ]
        assert stream.lost == 0
        assert script.numbers.started == 1


async def test_what_a_full_queue_lost_meanwhile_is_a_gap_and_counted(
    server: Server, between: Between, robot: RobotManager
) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        stream = await client.request("numbers", queue=QueuePolicy(length=2))
        script.put({"value": 0})
        assert await stream.get() == {"value": 0}
        async with resumed(client):
            proxy.cut(admit=False)
            await until(lambda: clients(server) == 0)
            script.put(*({"value": value} for value in range(1, 11)))
            await until(lambda: robot.status().routes[0].received == 11)
            proxy.admit()
        assert [await stream.get() for _ in range(2)] == [{"value": 9}, {"value": 10}]
        assert stream.lost == 8
        [own] = (await client.status())["own"]
        assert (own["received"], own["dropped"]) == (11, 8)


async def lose(
    client: RemoteRobot, server: Server, proxy: Proxy, *given: object, written: int
) -> None:
    """Have a connection take what the component gives and the server writes, and resume it."""
    proxy.hold(to_client=True)
    before = answered(server)
    script.put(*given)
    await until(lambda: answered(server) == before + written)
    async with resumed(client):
        proxy.cut()


@FORMS
async def test_what_a_dead_connection_took_is_counted_before_anything_else_comes(
    server: Server, between: Between, binary: bool
) -> None:
    proxy = between(server)
    async with joined(proxy, binary=binary) as client:
        stream = await client.request("numbers")  # nothing has come, and from where it counts
        await lose(client, server, proxy, {"value": 1}, {"value": 2}, written=2)
        assert stream.lost == 2
        script.put({"value": 3})
        assert await stream.get() == {"value": 3}
        assert stream.lost == 2


@FORMS
async def test_what_was_lost_before_the_end_is_counted(
    server: Server, between: Between, binary: bool
) -> None:
    proxy = between(server)
    async with joined(proxy, binary=binary) as client:
        stream = await client.request("numbers")
        script.put({"value": 1})
        assert await stream.get() == {"value": 1}
        await lose(client, server, proxy, {"value": 2}, {"value": 3}, END, written=3)
        with pytest.raises(ConnectionClosedError, match="finished"):
            await stream.get()
        assert stream.lost == 2


@FORMS
async def test_what_a_client_left_out_itself_is_not_lost(
    server: Server, between: Between, binary: bool
) -> None:
    proxy = between(server)
    async with joined(proxy, binary=binary) as client:
        stream = await client.request("numbers", every=3600)
        await lose(client, server, proxy, *({"value": value} for value in range(50)), written=1)
        script.put(END)
        with pytest.raises(ConnectionClosedError, match="finished"):
            await stream.get()
        assert stream.lost == 1  # which was on its way


def clients(server: Server) -> int:
    """Return how many clients are connected."""
    count: int = json.loads(page(server, "/healthz")[1])["clients"]
    return count


async def test_an_answer_that_came_meanwhile_is_received(server: Server, between: Between) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        calling = asyncio.ensure_future(client.call("slow", {"value": 7}))
        await client.status()
        async with resumed(client):
            proxy.cut(admit=False)
            script.gate.set()
            proxy.admit()
        assert await calling == {"value": 7}


async def test_an_answer_that_was_lost_on_the_way_is_sent_again(
    server: Server, between: Between
) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        await client.status()
        proxy.hold(to_client=True)
        before = answered(server)
        calling = asyncio.ensure_future(client.call("add", {"a": 1, "b": 2}))
        await until(lambda: answered(server) > before)
        async with resumed(client):
            proxy.cut()
        assert await calling == {"value": 3}


def answered(server: Server) -> int:
    """Return how many messages the server has sent."""
    text = figures(server)
    return int(float(text.partition("\nuoarm_serve_sent_messages_total ")[2].split()[0]))


@FORMS
async def test_an_end_that_was_lost_on_the_way_is_sent_again(
    server: Server, between: Between, binary: bool
) -> None:
    proxy = between(server)
    async with joined(proxy, binary=binary) as client:
        stream = await client.request("numbers")
        script.put({"value": 1})
        assert await stream.get() == {"value": 1}
        await lose(client, server, proxy, END, written=1)
        with pytest.raises(ConnectionClosedError, match="finished"):
            await stream.get()


async def test_what_never_arrived_is_reported_and_not_done_twice(
    server: Server, between: Between
) -> None:
    proxy = between(server)
    async with joined(proxy) as client, await client.request("echo") as echo:
        proxy.hold(to_server=True)
        sending = asyncio.ensure_future(echo.send({"value": 1}))
        await asyncio.sleep(0)
        async with resumed(client):
            proxy.cut()
        with pytest.raises(ConnectionClosedError, match="did not arrive"):
            await sending
        await echo.send({"value": 2})
        assert await echo.get() == {"value": 2}


async def test_a_kill_that_a_drop_took_is_asked_again(
    server: Server, between: Between, robot: RobotManager
) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        stream = await client.request("numbers")
        proxy.hold(to_server=True)
        killing = asyncio.ensure_future(stream.kill())
        await asyncio.sleep(0)
        async with resumed(client):
            proxy.cut()
        await killing
        await until(lambda: not robot.status().connections)


async def test_what_is_asked_while_it_is_down_waits(server: Server, between: Between) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        await client.status()
        async with resumed(client):
            proxy.cut(admit=False)
            await until(lambda: proxy.refused > 0)
            asking = [asyncio.ensure_future(client.call("add", {"a": 1, "b": n})) for n in range(9)]
            await asyncio.sleep(0)
            proxy.admit()
        assert [(await task)["value"] for task in asking] == list(range(1, 10))


async def test_what_runs_out_of_time_while_it_is_down_says_why(
    server: Server, between: Between
) -> None:
    proxy = between(server)
    async with joined(proxy, answer=0.2) as client:
        proxy.cut(admit=False)
        await until(lambda: "again" in client._link.trouble)
        text = r"has not answered Status within 0\.2 s; .*connecting again"
        with pytest.raises(BridgeTimeoutError, match=text):
            await client.status()


async def test_a_server_that_has_not_noticed_the_drop_lets_go(
    server: Server, between: Between
) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        stream = await client.request("numbers")
        async with resumed(client):
            proxy.cut(server=False)
        script.put({"value": 1})
        assert await stream.get() == {"value": 1}
        await until(lambda: clients(server) == 1)


async def test_changes_are_watched_over_a_drop(server: Server, between: Between) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        changes = client.watch()
        first = asyncio.ensure_future(anext(changes))
        while not first.done():  # what came before the watch was answered is no change
            await (await client.request("numbers")).kill()
        async with resumed(client):
            proxy.cut()
        echo = await client.request("echo")
        async for change in changes:
            if change.subject == f"connection {echo.connection}":
                return


async def test_a_session_ends_when_its_time_is_over(
    serve: Serve, between: Between, robot: RobotManager
) -> None:
    server = serve(Limits(resume_seconds=0.2))
    proxy = between(server)
    async with joined(proxy, reconnect=0) as client:
        stream = await client.request("numbers")
        proxy.cut(admit=False)
        await until(lambda: not robot.status().connections)
        with pytest.raises(ConnectionClosedError, match="dropped"):
            await stream.get()
        with pytest.raises(ConnectionClosedError, match="dropped"):
            await client.status()


async def test_sessions_without_a_connection_are_limited(
    serve: Serve, between: Between, robot: RobotManager
) -> None:
    server = serve(Limits(kept_sessions=1))
    first, second = between(server), between(server)

    async with joined(first) as one, joined(second, reconnect=0) as other:
        streams = await one.request("numbers"), await other.request("echo")
        first.cut(admit=False)
        await until(lambda: clients(server) == 1)
        assert "uoarm_serve_kept_sessions 1.0" in figures(server)
        second.cut()
        with pytest.raises(ConnectionClosedError, match="begin anew"):
            await streams[1].get()
        async with resumed(one):
            first.admit()
        await until(
            lambda: (
                [connection.function for connection in robot.status().connections] == ["numbers"]
            )
        )


@pytest.mark.parametrize("keeping", ["neither", "client", "server"])
async def test_where_one_side_does_not_want_it_a_drop_is_the_end(
    serve: Serve, between: Between, robot: RobotManager, keeping: str
) -> None:
    limits = Limits() if keeping == "server" else Limits(resume_seconds=0)
    proxy = between(serve(limits))

    async with joined(proxy, resume=keeping == "client", reconnect=0) as client:
        stream = await client.request("numbers")
        proxy.cut()
        with pytest.raises(ConnectionClosedError):
            await stream.get()
        await until(lambda: not robot.status().connections)


async def test_a_client_that_says_goodbye_leaves_nothing(
    server: Server, between: Between, robot: RobotManager
) -> None:
    async with joined(between(server)) as client:
        await client.request("numbers")
    eventually(lambda: not robot.status().connections, "what it held is closed")


async def test_a_drop_takes_nothing_from_what_was_counted(server: Server, between: Between) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        await client.status()
        proxy.cut(admit=False)
        await until(lambda: "uoarm_serve_kept_sessions 1.0" in figures(server))
        assert "uoarm_serve_received_messages_total 2.0" in figures(server)
        proxy.admit()


async def test_a_link_that_jams_is_a_drop_for_a_session_that_is_kept(
    serve: Serve, between: Between
) -> None:
    server = serve(Limits(stall_seconds=slowness()))
    proxy = between(server)
    async with joined(proxy) as client:
        stream = await client.request("picture", queue=QueuePolicy(length=2))
        script.put({"width": 0, "data": b""})
        assert (await stream.get())["width"] == 0
        proxy.jam()
        script.put(*({"width": number, "data": bytes(2_000_000)} for number in range(1, 20)))
        await until(lambda: "uoarm_serve_kept_sessions 1.0" in figures(server))
        async with resumed(client):
            proxy.cut()
        script.put({"width": 20, "data": b""})
        while (await stream.get())["width"] != 20:
            pass
        assert stream.lost > 0


async def test_what_was_answered_is_not_sent_again(server: Server, between: Between) -> None:
    proxy = between(server)
    async with joined(proxy) as client:
        for number in range(100):
            await client.call("add", {"a": number, "b": 0})
        before = answered(server)
        async with resumed(client):
            proxy.cut()
        await client.status()
        assert answered(server) - before < 20


@BESIDE
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)
@given(steps=st.lists(st.sampled_from(["call", "cut", "hold", "put"]), max_size=10))
def test_whatever_is_cut_nothing_comes_twice_or_without_being_counted(
    server: Server, robot: RobotManager, steps: list[str]
) -> None:
    eventually(lambda: not robot.status().connections, "what was before is closed")
    script.reset()

    async def work(client: RemoteRobot) -> None:
        stream = await client.request("numbers")
        calls: list[asyncio.Future[Message]] = []
        last = 0
        is_read = True
        for step in steps:
            if step == "call":
                calls.append(asyncio.ensure_future(client.call("add", {"a": len(calls), "b": 0})))
                await asyncio.sleep(0)
            elif step == "put":
                last += 1
                script.put({"value": last})
            elif step == "hold":
                proxy.hold(to_client=True)
                is_read = False
            else:
                proxy.cut()
                is_read = True
        if not is_read:
            proxy.cut()
        for number, answer in enumerate(await asyncio.gather(*calls, return_exceptions=True)):
            assert answer == {"value": number} or isinstance(answer, ConnectionClosedError)
        while isinstance(await answer_of(client), ConnectionClosedError):
            pass
        script.put({"value": last + 1})
        values: list[int] = []
        while last + 1 not in values:
            values.append((await stream.get())["value"])
        assert values == sorted(set(values))
        assert stream.lost == values[-1] - len(values)

    async def within() -> None:
        async with joined(proxy) as client:
            await work(client)

    with Proxy(server.ports[0]) as proxy:
        asyncio.run(within())


async def answer_of(client: RemoteRobot) -> object:
    """Return the status, or the error that it did not arrive."""
    try:
        return await client.status()
    except ConnectionClosedError as error:
        return error


@pytest.mark.needs("node")
@pytest.mark.parametrize("form", ["json", "cbor"])
def test_the_javascript_client_goes_on(server: Server, between: Between, form: str) -> None:
    proxy = between(server)
    url = f"ws://127.0.0.1:{proxy.port}/"
    flags = ["--experimental-websocket", "--no-warnings"]
    command = ["node", *flags, str(CLIENTS / "with_drops.mjs"), url, form, str(SECONDS)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if line == "cut\n":
                    proxy.cut(admit=False)
                    eventually(lambda: clients(server) == 0, "the server has noticed")
                    script.put({"value": 2}, {"value": 3})
                    script.gate.set()
                    proxy.admit()
                elif line == "ready\n":
                    script.put({"value": 1})
                elif line == "end\n":
                    proxy.cut(admit=False)
                else:
                    assert line == "done\n", line + process.stdout.read()
            assert process.wait(SECONDS) == 0
        finally:
            process.kill()
