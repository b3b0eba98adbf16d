"""Front ends of plugins: found, refused, served on real sockets; a failing one hurts no other."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint
from typing import Any
from urllib.request import urlopen

import pytest
from attrs import evolve
from tests.server import lines
from tests.server.conftest import Serve
from tests.server.lines import LINES
from tests.server.robot import END, script
from tests.server.talk import SECONDS, Talk, eventually, opened
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from uoarm import RobotManager
from uoarm.errors import ConfigurationError
from uoarm.server import Limits, Server
from uoarm.server.front_end import (
    Backend,
    Client,
    FrontEnd,
    HttpPlace,
    MakeSession,
    MemoryUse,
    RefusedError,
    Session,
)
from uoarm.server.http import _handshake
from uoarm.server.http._handshake import FrontEnds

ADD = 'call add {"a": 1, "b": 2}'


def enter(
    server: Server,
    path: str = "/lines",
    subprotocols: Sequence[Subprotocol] | None = None,
    **options: Any,
) -> ClientConnection:
    url = f"ws://127.0.0.1:{server.ports[0]}{path}"
    made: ClientConnection = connect(url, subprotocols=subprotocols, **options)
    return made


def received(client: ClientConnection) -> str:
    return str(client.recv(timeout=SECONDS))


def point(value: str) -> EntryPoint:
    return EntryPoint(value.rpartition(".")[2], value, "uoarm.front_ends")


def test_an_installed_front_end_is_found_and_served(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_handshake, "installed", lambda group: [point(lines.__name__)])
    server = serve()
    assert server.front_ends == (LINES,)
    with enter(server) as client:
        client.send(ADD)
        assert received(client) == '{"value":3}'


def test_messages_of_a_function_come_in_its_form(serve: Serve, robot: RobotManager) -> None:
    with enter(serve(front_ends=[LINES])) as client:
        client.send("open numbers")
        assert received(client) == "open"
        script.put({"value": 1}, {"value": 2}, END)
        assert [received(client) for _ in range(3)] == [
            '1 {"value": 1}', '2 {"value": 2}', "ended closed",
        ]  # fmt: skip
    eventually(lambda: not robot.status().connections, "the function is closed")


def test_what_a_client_of_it_holds_is_counted_and_let_go(serve: Serve) -> None:
    server = serve(Limits(memory_bytes=2000), front_ends=[LINES])
    with enter(server, close_timeout=0.1) as client:  # its goodbye waits behind what it sent
        for _ in range(100):
            client.send('call slow {"value": 1}' + " " * 400)
        assert received(client).startswith("limit: ")
        assert server.held_octets > 1500
    eventually(lambda: server.held_octets == 0, "everything was let go")


def test_its_own_port_has_its_endpoint_on_every_path(serve: Serve) -> None:
    server = serve(front_ends=[LINES], front_end_ports={"lines": 0})
    for path in ("/", "/lines", "/anything"):
        with connect(f"ws://127.0.0.1:{server.ports[1]}{path}") as client:
            client.send(ADD)
            assert received(client) == '{"value":3}'


@pytest.mark.parametrize(
    ("offered", "chosen"),
    [
        (["lines.v1", "lines.v2"], "lines.v1"),
        (["uoarm.v1.json", "lines.v2"], "lines.v2"),
        (["uoarm.v1.json"], "uoarm.v1.json"),
        (["other"], None),
        (None, None),
    ],
)
def test_the_client_chooses_among_its_subprotocols(
    serve: Serve, offered: list[str] | None, chosen: str | None
) -> None:
    wanted = None if offered is None else [Subprotocol(name) for name in offered]
    with enter(serve(front_ends=[LINES]), subprotocols=wanted) as client:
        assert client.subprotocol == chosen


def test_without_it_the_path_is_none_and_the_answer_says_what_there_is(serve: Serve) -> None:
    with pytest.raises(InvalidStatus) as refused:
        enter(serve(front_ends=[]))
    assert refused.value.response.status_code == 404
    with pytest.raises(InvalidStatus) as refused:
        enter(serve(front_ends=[LINES]), "/other")
    assert refused.value.response.body == b"there is no endpoint here; try / or /lines (UOA-705)\n"


@pytest.mark.parametrize("line", ["raise", "decode-raise", "quit", "decode-quit"])
def test_a_session_that_fails_ends_its_connection_and_is_named(
    serve: Serve, caplog: pytest.LogCaptureFixture, line: str
) -> None:
    server = serve(front_ends=[LINES])
    with enter(server) as other, enter(server) as client:
        client.send(line)
        with pytest.raises(ConnectionClosed) as closed:
            received(client)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1011
        other.send(ADD)
        assert received(other) == '{"value":3}'
    assert [
        record.message for record in caplog.records if "tests.server.lines failed" in record.message
    ]


def test_a_task_that_it_leaves_behind_ends_nothing_when_it_quits(
    serve: Serve, caplog: pytest.LogCaptureFixture
) -> None:
    with enter(serve(front_ends=[LINES])) as client:
        for _ in range(3):
            client.send("leave")
            client.send(ADD)
            assert received(client) == '{"value":3}'
    assert "a task that a front end left behind raised" in caplog.text


@pytest.mark.parametrize("fatal", lines.FATAL)
def test_a_listener_that_fails_is_handed_nothing_more_and_the_others_go_on(
    serve: Serve, robot: RobotManager, caplog: pytest.LogCaptureFixture, fatal: object
) -> None:
    server = serve(front_ends=[LINES])
    with enter(server) as failing, Talk(f"ws://127.0.0.1:{server.ports[0]}/") as talk:
        failing.send("open numbers")
        assert received(failing) == "open"
        connection = talk.open("numbers")
        opened(robot, 1)
        script.put(fatal, {"value": 14})
        assert talk.data(connection, 2) == [fatal, {"value": 14}]
        assert received(failing) == "ended failed"
    assert "a listener of tests.server.lines failed" in caplog.text


class Failing:
    """A session whose end fails."""

    def __init__(self, client: Client) -> None:
        client.account.hold(MemoryUse.DATA).resize(1000)

    def octets(self, frame: str | bytes) -> int:
        return len(frame)

    def decode(self, frame: str | bytes, spending: object) -> tuple[Callable[[], None], int]:
        return _nothing, 0

    def close(self) -> None:
        raise ValueError("a mistake of this front end")


def _nothing() -> None:
    """Do nothing."""


def _start_failing(backend: Backend) -> MakeSession:
    return Failing


def test_an_end_that_fails_leaves_nothing_held(
    serve: Serve, caplog: pytest.LogCaptureFixture
) -> None:
    server = serve(front_ends=[evolve(LINES, start=_start_failing)])
    with enter(server):
        eventually(lambda: server.held_octets == 1000, "it is held")
    eventually(lambda: server.held_octets == 0, "everything was let go")
    assert "failed when it was closed" in caplog.text


def _raise(*given: object) -> Session:
    raise ValueError("no licence")


def _start_raising(backend: Backend) -> MakeSession:
    raise ValueError("no licence")


def _start_refusing(backend: Backend) -> MakeSession:
    return _raise


def test_one_that_does_not_start_is_left_out_and_logged(
    serve: Serve, caplog: pytest.LogCaptureFixture
) -> None:
    broken = evolve(LINES, name="broken", path="/broken", start=_start_raising)
    server = serve(front_ends=[broken, LINES])
    assert server.front_ends == (LINES,)
    assert "the front end 'broken' did not start" in caplog.text
    with pytest.raises(InvalidStatus):
        enter(server, "/broken")
    with enter(server) as client:
        client.send(ADD)
        assert received(client) == '{"value":3}'
    with pytest.raises(ConfigurationError, match="'broken': no licence"):
        serve(front_ends=[broken], front_end_ports={"broken": 0})


def test_a_client_whose_session_cannot_be_made_is_sent_away_and_holds_nothing(
    serve: Serve, caplog: pytest.LogCaptureFixture
) -> None:
    server = serve(front_ends=[evolve(LINES, start=_start_refusing)])
    with enter(server) as client, pytest.raises(ConnectionClosed) as closed:
        received(client)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1011
    assert "no licence" in caplog.text


def found(*front_ends: FrontEnd) -> tuple[list[str], list[str]]:
    made = FrontEnds(front_ends)
    return [front_end.name for front_end in made.usable], [
        problem.cause for problem in made.problems
    ]


def test_what_cannot_be_served_is_a_problem_with_its_cause() -> None:
    older = evolve(LINES, name="older", contract=0)
    same_name = evolve(LINES, path="/other")
    same_path = evolve(LINES, name="other")
    reserved = evolve(LINES, name="greedy", path="/metrics")
    names, causes = found(LINES, older, same_name, same_path, reserved)
    assert names == ["lines"]
    assert [len(causes), "contract version 0" in causes[0]] == [4, True]
    assert all("already there: lines of text" in cause for cause in causes[1:3])
    assert "the server's own" in causes[3]


def test_what_is_installed_is_read_once_for_all_servers(monkeypatch: pytest.MonkeyPatch) -> None:
    found = FrontEnds().usable
    monkeypatch.setattr("importlib.metadata.distributions", lambda: pytest.fail("read again"))
    assert FrontEnds().usable == found


@pytest.mark.parametrize("path", ["", "lines", "/", "/a?b", "/a#b", "/a "])
def test_a_path_that_is_none_is_refused(path: str) -> None:
    with pytest.raises(ValueError, match="expected one such as"):
        evolve(LINES, path=path)


def test_a_plugin_that_cannot_be_loaded_affects_no_other(
    monkeypatch: pytest.MonkeyPatch, serve: Serve, caplog: pytest.LogCaptureFixture
) -> None:
    points = [point("no_such_module"), point("json"), point(lines.__name__)]
    monkeypatch.setattr(_handshake, "installed", lambda group: points)
    with caplog.at_level(logging.WARNING, "uoarm.server"):
        server = serve()
    assert server.front_ends == (LINES,)
    assert "'no_such_module' cannot be used: ModuleNotFoundError" in caplog.text
    assert (
        "'json' cannot be used: PluginError: it implements no uoarm_front_ends hook" in caplog.text
    )


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("rosbridge", "the front end 'rosbridge' is not installed: pip install "),
        ("nothing", "there is no front end 'nothing' (installed: lines)"),
    ],
)
def test_a_port_of_one_that_is_not_there_is_refused_with_what_to_do(
    serve: Serve, name: str, said: str
) -> None:
    with pytest.raises(ConfigurationError) as refused:
        serve(front_ends=[LINES], front_end_ports={name: 0})
    assert str(refused.value).startswith(said)


def test_one_with_http_of_its_own_is_served_on_its_port(
    serve: Serve,
) -> None:
    async def answer(place: HttpPlace) -> None:
        async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")
            try:
                async with place.stateless_clients.admitted(
                    "/", [("Host", "localhost")], None, "me"
                ) as client:
                    text = client.principal
            except RefusedError as error:
                text = str(error)
            writer.write(f"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n{text}".encode())
            writer.close()

        async with await asyncio.start_server(talk, sock=place.sockets[0]) as listening:
            await listening.serve_forever()

    own = FrontEnd(name="own", summary="", path="/own", serve=answer, contract=1)
    server = serve(front_ends=[own], front_end_ports={"own": 0})
    with urlopen(f"http://127.0.0.1:{server.ports[1]}/", timeout=SECONDS) as page:
        assert page.read() == b"local"
    with pytest.raises(InvalidStatus):
        enter(server, "/own")


@pytest.mark.parametrize(
    "headers",
    [
        lambda number: [("Authorization", f"Bearer {number}")],
        lambda number: [("Uoarm-Manager", f"{number:032x}")],
    ],
    ids=["token", "manager"],
)
def test_what_gives_a_request_no_right_makes_it_no_other_client(
    serve: Serve, headers: Callable[[int], list[tuple[str, str]]]
) -> None:
    async def answer(place: HttpPlace) -> None:
        async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")
            identities = set()
            for number in range(3):
                shown = [("Host", "localhost"), *headers(number)]
                async with place.stateless_clients.admitted("/", shown, None, "me") as client:
                    identities.add(client.identity)
            writer.write(f"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n{len(identities)}".encode())
            writer.close()

        async with await asyncio.start_server(talk, sock=place.sockets[0]) as listening:
            await listening.serve_forever()

    own = FrontEnd(name="own", summary="", path="/own", serve=answer, contract=1)
    server = serve(front_ends=[own], front_end_ports={"own": 0})
    with urlopen(f"http://127.0.0.1:{server.ports[1]}/", timeout=SECONDS) as page:
        assert page.read() == b"1"


def test_it_says_how_it_is_served() -> None:
    with pytest.raises(ValueError, match="expected either start or serve"):
        FrontEnd(name="none", summary="", path="/none", contract=1)
