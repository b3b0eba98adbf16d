"""Sessions that go on after the connection was cut, for real, by a proxy in between."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.server.conftest import Connect, Serve
from tests.server.proxy import Proxy
from tests.server.robot import END, script
from tests.server.talk import BESIDE, SECONDS, Talk, eventually
from tests.server.test_serving import page

from uoarm import ConnectionClosedError, QueuePolicy, RobotManager
from uoarm.client import Client, connect
from uoarm.model import Message
from uoarm.server import Limits, Server, hash_token
from uoarm.server._answers import Answers

CLIENTS = Path(__file__).parent / "clients"
FORMS = pytest.mark.parametrize("binary", [False, True], ids=["json", "cbor"])
Between = Callable[[Server], Proxy]


@pytest.fixture
def between() -> Iterator[Between]:
    """Put a proxy before a server."""
    with ExitStack() as stack:
        yield lambda server: stack.enter_context(Proxy(server.ports[0]))


def run(proxy: Proxy, work: Callable[[Client], Awaitable[None]], **options: Any) -> None:
    async def within() -> None:
        async with connect(f"ws://127.0.0.1:{proxy.port}/", **options) as client:
            await asyncio.wait_for(work(client), SECONDS)

    asyncio.run(within())


async def until(condition: Callable[[], bool]) -> None:
    await asyncio.to_thread(eventually, condition, "what the test waits for")


@asynccontextmanager
async def resumed(client: Client) -> AsyncIterator[None]:
    """Wait after the block until the session goes on."""
    before = client.resumed
    yield
    await until(lambda: client.resumed > before)


@FORMS
def test_a_stream_goes_on_where_it_was(server: Server, between: Between, binary: bool) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
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
        assert script.started["numbers"] == 1

    run(proxy, work, binary=binary)


def test_what_a_full_queue_lost_meanwhile_is_a_gap_and_counted(
    server: Server, between: Between, robot: RobotManager
) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
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

    run(proxy, work)


def clients(server: Server) -> int:
    """Return how many clients are connected."""
    count: int = json.loads(page(server, "/healthz")[1])["clients"]
    return count


def test_an_answer_that_came_meanwhile_is_heard(server: Server, between: Between) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        calling = asyncio.ensure_future(client.call("slow", {"value": 7}))
        await client.status()
        async with resumed(client):
            proxy.cut(admit=False)
            script.gate.set()
            proxy.admit()
        assert await calling == {"value": 7}

    run(proxy, work)


def test_an_answer_that_was_lost_on_the_way_is_told_again(server: Server, between: Between) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        await client.status()
        proxy.hold(to_client=True)
        before = answered(server)
        calling = asyncio.ensure_future(client.call("add", {"a": 1, "b": 2}))
        await until(lambda: answered(server) > before)
        async with resumed(client):
            proxy.cut()
        assert await calling == {"value": 3}

    run(proxy, work)


def answered(server: Server) -> int:
    """Return how many messages the server has sent."""
    text = figures(server)
    return int(float(text.partition("\nuoarm_serve_sent_messages_total ")[2].split()[0]))


@FORMS
def test_an_end_that_was_lost_on_the_way_is_told_again(
    server: Server, between: Between, binary: bool
) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        stream = await client.request("numbers")
        script.put({"value": 1})
        assert await stream.get() == {"value": 1}
        proxy.hold(to_client=True)
        before = answered(server)
        script.put(END)
        await until(lambda: answered(server) > before)
        async with resumed(client):
            proxy.cut()
        with pytest.raises(ConnectionClosedError, match="finished"):
            await stream.get()

    run(proxy, work, binary=binary)


def test_what_never_arrived_is_told_and_not_done_twice(server: Server, between: Between) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        async with await client.request("echo") as echo:
            proxy.hold(to_server=True)
            sending = asyncio.ensure_future(echo.send({"value": 1}))
            await asyncio.sleep(0)
            async with resumed(client):
                proxy.cut()
            with pytest.raises(ConnectionClosedError, match="did not arrive"):
                await sending
            await echo.send({"value": 2})
            assert await echo.get() == {"value": 2}

    run(proxy, work)


def test_what_is_asked_while_it_is_down_waits(server: Server, between: Between) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        await client.status()
        async with resumed(client):
            proxy.cut(admit=False)
            await until(lambda: proxy.refused > 0)
            asking = [asyncio.ensure_future(client.call("add", {"a": 1, "b": n})) for n in range(9)]
            await asyncio.sleep(0)
            proxy.admit()
        assert [(await one)["value"] for one in asking] == list(range(1, 10))

    run(proxy, work)


def test_a_server_that_has_not_noticed_the_drop_lets_go(server: Server, between: Between) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        stream = await client.request("numbers")
        async with resumed(client):
            proxy.cut(server=False)
        script.put({"value": 1})
        assert await stream.get() == {"value": 1}
        await until(lambda: clients(server) == 1)

    run(proxy, work)


def test_changes_are_watched_over_a_drop(server: Server, between: Between) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        changes = client.watch()
        first = asyncio.ensure_future(anext(changes))
        await client.request("numbers")
        await first
        async with resumed(client):
            proxy.cut()
        echo = await client.request("echo")
        async for change in changes:
            if change.subject == f"connection {echo.connection}":
                return

    run(proxy, work)


def test_a_session_ends_when_its_time_is_over(
    serve: Serve, between: Between, robot: RobotManager
) -> None:
    server = serve(Limits(resume_seconds=0.2))
    proxy = between(server)

    async def work(client: Client) -> None:
        stream = await client.request("numbers")
        proxy.cut(admit=False)
        await until(lambda: not robot.status().connections)
        with pytest.raises(ConnectionClosedError, match="dropped"):
            await stream.get()
        with pytest.raises(ConnectionClosedError, match="dropped"):
            await client.status()

    run(proxy, work)


def test_sessions_without_a_connection_are_limited(
    serve: Serve, between: Between, robot: RobotManager
) -> None:
    server = serve(Limits(kept_sessions=1))
    first, second = between(server), between(server)

    async def work(one: Client) -> None:
        async with connect(f"ws://127.0.0.1:{second.port}/") as other:
            streams = await one.request("numbers"), await other.request("echo")
            first.cut(admit=False)
            await until(lambda: clients(server) == 1)
            assert "uoarm_serve_kept_sessions 1.0" in figures(server)
            second.cut()
            with pytest.raises(ConnectionClosedError, match="begin anew"):
                await streams[1].get()
            async with resumed(one):
                first.admit()
            await until(lambda: [one.function for one in robot.status().connections] == ["numbers"])

    run(first, work)


@pytest.mark.parametrize("keeping", ["neither", "client", "server"])
def test_where_one_side_does_not_want_it_a_drop_is_the_end(
    serve: Serve, between: Between, robot: RobotManager, keeping: str
) -> None:
    limits = Limits() if keeping == "server" else Limits(resume_seconds=0)
    proxy = between(serve(limits))

    async def work(client: Client) -> None:
        stream = await client.request("numbers")
        proxy.cut()
        with pytest.raises(ConnectionClosedError):
            await stream.get()
        await until(lambda: not robot.status().connections)

    run(proxy, work, resume=keeping == "client")


def test_a_client_that_says_goodbye_leaves_nothing(
    server: Server, between: Between, robot: RobotManager
) -> None:
    async def work(client: Client) -> None:
        await client.request("numbers")

    run(between(server), work)
    eventually(lambda: not robot.status().connections, "what it held is closed")


def test_a_key_is_for_a_session_that_is_kept_and_comes_first(talk: Connect) -> None:
    first, second, third = talk(), talk(binary=True), talk()
    key = first.ask("Resume")["key"]
    assert "kept already" in first.refused("Resume")["text"]
    assert "first message" in first.refused("Resume", message={"key": key})["text"]
    assert "speaks json" in second.refused("Resume", message={"key": key})["text"]
    assert "begin anew" in third.refused("Resume", message={"key": "x" * 43})["text"]
    assert third.refused("Resume", message={"key": 5})["code"] == "unreadable"
    third.open("numbers")
    assert "first message" in third.refused("Resume", message={"key": key})["text"]


def test_a_session_is_taken_up_message_by_message(talk: Connect) -> None:
    first, second = talk(), talk()
    key = first.ask("Resume")["key"]
    connection = first.open("numbers")
    call = first.send("Call", "slow", {"value": 1})
    first.ask("List")
    waiting = [call, "never sent"]
    taken = second.ask("Resume", message={"key": key, "waiting": waiting})
    assert taken["session"] == first.hello["session"]
    assert [one["connection"] for one in taken["own"]] == [connection]
    assert second.answer("never sent")["jsonMessage"]["code"] == "closed"
    script.gate.set()
    assert second.answer(call)["jsonMessage"] == {"value": 1}
    script.put({"value": 5})
    assert second.data(connection, 1) == [{"value": 5}]
    second.ask("Kill", connection)


def test_an_answer_that_waits_is_not_told_twice(server: Server, between: Between) -> None:
    proxy = between(server)
    url = f"ws://127.0.0.1:{proxy.port}/"
    with Talk(url) as first:
        key = first.ask("Resume")["key"]
        for _ in range(5):  # so that no id of the second is that of the call
            first.ask("List")
        call = first.send("Call", "slow", {"value": 1})
        first.ask("List")
        proxy.cut()
        eventually(lambda: "uoarm_serve_kept_sessions 1.0" in figures(server), "it is kept")
        script.gate.set()
        eventually(lambda: "uoarm_serve_workers_busy 0.0" in figures(server), "it is answered")
    with Talk(url) as second:
        second.ask("Resume", message={"key": key, "waiting": [call]})
        assert second.answer(call)["jsonMessage"] == {"value": 1}
        second.ask("List")
        assert not second.unheard


def test_a_drop_takes_nothing_from_what_was_counted(server: Server, between: Between) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        await client.status()
        proxy.cut(admit=False)
        await until(lambda: "uoarm_serve_kept_sessions 1.0" in figures(server))
        assert "uoarm_serve_received_messages_total 2.0" in figures(server)
        proxy.admit()

    run(proxy, work)


def figures(server: Server) -> str:
    return page(server, "/metrics")[1]


def test_a_link_that_jams_is_a_drop_for_a_session_that_is_kept(
    serve: Serve, between: Between
) -> None:
    server = serve(Limits(stall_seconds=0.3))
    proxy = between(server)

    async def work(client: Client) -> None:
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

    run(proxy, work)


def test_what_was_answered_is_not_told_again(server: Server, between: Between) -> None:
    proxy = between(server)

    async def work(client: Client) -> None:
        for number in range(100):
            await client.call("add", {"a": number, "b": 0})
        before = answered(server)
        async with resumed(client):
            proxy.cut()
        await client.status()
        assert answered(server) - before < 20

    run(proxy, work)


def test_another_s_session_is_not_taken_up(serve: Serve, tmp_path: Path) -> None:
    access = tmp_path / "access.yaml"
    access.write_text(ACCESS.format(one=hash_token("one"), other=hash_token("other")))
    url = f"ws://127.0.0.1:{serve(access=access).ports[0]}/"
    with Talk(f"{url}?token=one") as first, Talk(f"{url}?token=other") as second:
        key = first.ask("Resume")["key"]
        assert second.refused("Resume", message={"key": key})["code"] == "unknown"
        with Talk(f"{url}?token=one") as third:
            assert third.ask("Resume", message={"key": key})["session"] == first.hello["session"]


ACCESS = """
version: 1
roles: {{all: {{see: ["*"], request: ["*"]}}}}
tokens: [{{name: one, role: all, sha256: {one}}}, {{name: other, role: all, sha256: {other}}}]
"""


@BESIDE
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)
@given(steps=st.lists(st.sampled_from(["call", "cut", "put"]), max_size=10))
def test_whatever_is_cut_nothing_comes_twice_or_without_being_counted(
    server: Server, robot: RobotManager, steps: list[str]
) -> None:
    eventually(lambda: not robot.status().connections, "what was before is closed")
    script.reset()

    async def work(client: Client) -> None:
        stream = await client.request("numbers")
        calls: list[asyncio.Future[Message]] = []
        last = 0
        for step in steps:
            if step == "call":
                calls.append(asyncio.ensure_future(client.call("add", {"a": len(calls), "b": 0})))
                await asyncio.sleep(0)
            elif step == "put":
                last += 1
                script.put({"value": last})
            else:
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
        assert stream.lost == values[-1] - values[0] + 1 - len(values)

    with Proxy(server.ports[0]) as proxy:
        run(proxy, work)


async def answer_of(client: Client) -> object:
    """Return the status, or the error that it did not arrive."""
    try:
        return await client.status()
    except ConnectionClosedError as error:
        return error


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node, from version 20.10 on")
@pytest.mark.parametrize("form", ["json", "cbor"])
def test_the_javascript_client_goes_on(server: Server, between: Between, form: str) -> None:
    proxy = between(server)
    url = f"ws://127.0.0.1:{proxy.port}/"
    flags = ["--experimental-websocket", "--no-warnings"]
    command = ["node", *flags, str(CLIENTS / "with_drops.mjs"), url, form]
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


@given(
    st.lists(st.tuples(st.sampled_from("abcdef"), st.integers(0, 9), st.booleans())),
    st.integers(1, 4),
    st.integers(1, 20),
)
def test_kept_answers_are_bounded_and_the_newest(
    steps: list[tuple[str, int, bool]], most: int, most_bytes: int
) -> None:
    answers = Answers(most, most_bytes)
    newest: dict[str, bytes] = {}
    for identity, size, begins in steps:
        if begins:
            answers.begin(identity)
            assert answers.is_under_way(identity)
            continue
        frame = bytes(size)
        newest.pop(identity, None)
        newest[identity] = frame
        answers.add(identity, frame)
        assert not answers.is_under_way(identity)
        kept = {name: answers.get(name) for name in newest if answers.get(name) is not None}
        assert list(kept) == list(newest)[len(newest) - len(kept) :]
        assert len(kept) <= most
        assert sum(len(one or b"") for one in kept.values()) <= most_bytes
