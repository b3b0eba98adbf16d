"""`uoarm serve` as a process of its own: it starts, answers, and ends on a signal."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from asyncio.selector_events import BaseSelectorEventLoop
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest.mock import AsyncMock, Mock, create_autospec

import pytest
from attrs import evolve
from click.testing import CliRunner, Result
from tests.processes import SIGNALS_AS_IT_OPENS, run_python
from tests.server.conftest import Connect, Serve
from tests.server.lines import LINES
from tests.server.robot import CONFIGURATION, script
from tests.server.talk import Talk, eventually, frame, open_socket
from websockets.exceptions import ConnectionClosed, ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from uoarm import RobotManager
from uoarm.cli import _serve, _up, main
from uoarm.errors import ConfigurationError, ListenError
from uoarm.model import ConfigurationChange
from uoarm.server import Limits, Server, ServerOptions, fingerprint_of, run, serve_in_thread
from uoarm.server.front_end import FrontEnd
from uoarm.testing import ResourceSnapshot, patience, wait

ROOT = Path(__file__).parents[2]
PATIENT = Path(__file__).parent / "patient"
Start = Callable[..., tuple[subprocess.Popen[str], int]]
Refuse = Callable[..., Result]


def page(server: Server, path: str, **headers: str) -> tuple[int, str]:
    url = f"http://127.0.0.1:{server.ports[0]}{path}"
    request = urllib.request.Request(url, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=patience()) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def figures(server: Server) -> str:
    return page(server, "/metrics")[1]


def test_health_and_pages(server: Server) -> None:
    assert page(server, "/healthz") == (200, '{"status":"ok","clients":0}')
    assert "uoarm serve" in page(server, "/")[1]
    assert "export async function connect" in page(server, "/uoarm.js")[1]
    assert "export function decode" in page(server, "/uoarm-cbor.js")[1]
    assert "export function connect" in page(server, "/uoarm.d.ts")[1]
    for path in ("/nowhere", "/../pyproject.toml", "/%2e%2e/__init__.py", "/static/index.html"):
        assert page(server, path)[0] == 404


def test_metrics_count_what_happens(server: Server, talk: Connect) -> None:
    client = talk()
    connection = client.open("numbers")
    script.put({"value": 1}, {"value": 2})
    client.data(connection, 2)
    # What a client has may be written still: messages count as sent from when all of a turn are.
    eventually(lambda: "uoarm_serve_sent_messages_total 4.0" in figures(server), "all are counted")
    text = figures(server)
    assert "uoarm_serve_clients 1.0" in text
    assert "uoarm_serve_received_messages_total 1.0" in text
    ends = f'consumer="{connection}",producer="numbers.default"'
    assert f"uoarm_route_received_total{{{ends}}} 2.0" in text


def test_metrics_count_who_was_refused_on_any_port(serve: Serve) -> None:
    server = serve(front_ends=[LINES], front_end_ports={"lines": 0})
    for port in server.ports:
        with pytest.raises(InvalidStatus):
            connect(f"ws://127.0.0.1:{port}/", origin=Origin("http://strange.example"))
    assert "uoarm_serve_refused_total 2.0" in page(server, "/metrics")[1]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start `uoarm serve`; whatever is left is killed."""
    processes: list[subprocess.Popen[str]] = []
    file = tmp_path / "robot.yaml"
    file.write_text(CONFIGURATION, encoding="utf-8")

    def begin(*arguments: str) -> tuple[subprocess.Popen[str], int]:
        process = subprocess.Popen(
            [sys.executable, "-m", "uoarm", "serve", str(file), "--port", "0", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={
                **os.environ,
                "PYTHONPATH": f"{PATIENT}{os.pathsep}{ROOT}",
                "UOARM_TEST_PATIENCE": str(patience()),
                "PYTHONUNBUFFERED": "1",
                "XDG_STATE_HOME": str(tmp_path / "state"),
            },
        )
        processes.append(process)
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.search(r"ws://127\.0\.0\.1:(\d+)/", line)
        return process, int(found.group(1)) if found else 0

    yield begin
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=patience())


@pytest.fixture
def refuse(tmp_path: Path) -> Refuse:
    """Run a command that serves in this process, where it ends at once."""
    file = tmp_path / "robot.yaml"
    file.write_text(CONFIGURATION, encoding="utf-8")

    def begin(*arguments: str, command: str = "serve") -> Result:
        state = {"XDG_STATE_HOME": str(tmp_path / "state")}
        return CliRunner().invoke(main, [command, str(file), *arguments], env=state)

    return begin


@pytest.mark.needs("node")
def test_a_program_of_node_that_closes_ends_though_the_server_hangs(start: Start) -> None:
    process, port = start()
    program = Path(__file__).parent / "clients" / "with_hang.mjs"
    flags = ["--experimental-websocket", "--no-warnings"]
    command = ["node", *flags, str(program), f"ws://127.0.0.1:{port}/", str(patience())]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as client:
        try:
            assert client.stdin is not None
            assert client.stdout is not None
            assert client.stdout.readline() == "open\n"
            process.send_signal(signal.SIGSTOP)
            client.stdin.write("close\n")
            client.stdin.flush()
            assert client.wait(patience()) == 0
        finally:
            process.send_signal(signal.SIGCONT)
            client.kill()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_closes_clients_properly_and_quickly(start: Start, number: signal.Signals) -> None:
    process, port = start()
    with Talk(f"ws://127.0.0.1:{port}/") as client:
        client.open("numbers")
        slow = client.send("Call", "slow", {"value": 1})
        client.ask("List")
        process.send_signal(number)
        with pytest.raises(ConnectionClosed) as closed:
            client.answer(slow)
        assert not isinstance(closed.value, ConnectionClosedError)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1001
        out, err = process.communicate(timeout=patience())
    assert (process.returncode, err) == (0, ""), out


def test_a_service_that_quits_does_not_end_it(start: Start) -> None:
    process, port = start()
    with Talk(f"ws://127.0.0.1:{port}/") as client:
        for number in range(4):
            assert client.refused("Call", "quits", {"value": number})["code"] == "bridge"
        assert client.ask("Call", "add", {"a": 2, "b": 3}) == {"value": 5}
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=patience())
    assert process.returncode == 0


def test_a_client_that_never_reads_does_not_hold_up_the_end(start: Start) -> None:
    process, port = start()
    with open_socket(port) as stuck:
        for _ in range(2000):
            stuck.sendall(frame(b'{"op":"List","id":"1"}'))
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=patience())
    assert process.returncode == 0


def test_it_says_where_the_page_is(start: Start) -> None:
    process, port = start()
    assert process.stdout is not None
    address = f"http://127.0.0.1:{port}/"
    assert process.stdout.readline() == f"open {address} in a browser\n"
    with urllib.request.urlopen(address, timeout=patience()) as answer:
        assert "uoarm" in answer.read().decode()


@pytest.mark.parametrize(
    ("host", "here"),
    [("0.0.0.0", "127.0.0.1"), ("", "127.0.0.1"), ("::", "[::1]"), ("0::0", "[::1]")],
)
def test_of_every_address_those_are_reported_that_can_be_opened(
    host: str, here: str, capsys: pytest.CaptureFixture[str]
) -> None:
    served = (LINES, evolve(LINES, name="pages", path="/pages", start=None, serve=AsyncMock()))
    server = create_autospec(Server, instance=True, ports=(9080, 9090, 9100), front_ends=served)
    ports, authority = {"lines": 0, "pages": 0}, Path("ca.pem")
    settings = ServerOptions(host, front_end_ports=ports, access=Path("access.yaml"))
    _serve.say(server, settings)
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        f"serving ws://{here}:9080/ and ws://{here}:9080/lines",
        f"serving ws://{here}:9090/ for lines clients",
        f"serving http://{here}:9100/pages for pages clients",
        (
            "listening on every address of this machine: elsewhere it is "
            f"{socket.gethostname()}, or an address of it, in place of {here}"
        ),
        f"every client needs a token of {Path('access.yaml').absolute()} (uoarm token makes one)",
        f"open http://{here}:9080/ in a browser",
    ]
    assert "without TLS, tokens and data can be read" in err
    _serve.say(server, evolve(settings, host="robot.local", client_authority=authority))
    named = capsys.readouterr().out
    assert "serving ws://robot.local:9080/ and " in named
    rests = f"or a certificate that rests on {authority.absolute()}\n"
    assert f"(uoarm token makes one), {rests}" in named
    assert "listening on" not in named
    warning = "through a proxy as robot.example may do everything: --access asks for tokens"
    _serve.say(server, evolve(settings, host="127.0.0.1", hosts=("robot.example",)))
    assert warning not in capsys.readouterr().err
    _serve.say(server, evolve(settings, host="127.0.0.1", hosts=("robot.example",), access=None))
    assert warning in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--port", "--front-end-port lines=PORT"])
def test_a_server_that_cannot_listen_says_at_which_port(robot: RobotManager, option: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        main_port, lines_port = (port, 0) if option == "--port" else (0, port)
        settings = ServerOptions(port=main_port, front_end_ports={"lines": lines_port})
        serving = serve_in_thread(robot, settings, front_ends=[LINES])
        with pytest.raises(OSError, match="Address already in use") as refused, serving:
            pass
    error = refused.value
    assert isinstance(error, ListenError)
    assert error.port == port
    error.name_option(_serve.port_options(settings))
    why = f"cannot listen on 127.0.0.1:{port}: Address already in use"
    assert str(error) == f"{why}; {option} takes another"


@pytest.mark.parametrize("command", ["serve", "up"])
def test_a_port_that_is_taken_is_reported_in_one_line(
    command: str, refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_up, "with_every_plugin", lambda robot, _: robot)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = refuse("--port", str(port), command=command)
    assert done.exit_code == 5
    why = f"cannot listen on 127.0.0.1:{port}: Address already in use"
    assert f"error: {why}; --port takes another\nuoarm explain UOA-709" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize(
    "words", ["--audit /dev/full", "--audit /dev/full/log", "--recordings /dev/full/folder"]
)
def test_no_part_of_the_robot_begins_where_what_is_kept_cannot_be_written(
    words: str, refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str] = []
    monkeypatch.setattr(RobotManager, "offer", lambda *_, **__: begun.append("offers"))
    done = refuse("--port", "0", *words.split())
    assert (done.exit_code, begun) == (3, []), done.output
    assert "cannot be written to /dev/full" in done.stderr


def test_what_cannot_be_printed_is_no_port_that_is_taken(
    refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_serve, "say", Mock(side_effect=OSError(errno.ENOSPC, "no room")))
    done = refuse("--port", "0")
    assert done.exit_code == 6
    assert "error: nothing more can be written: no room\nuoarm explain UOA-003" in done.stderr


def test_tls_auto_shows_the_fingerprint(start: Start, tmp_path: Path) -> None:
    process, _ = start("--tls", "auto")
    assert process.stdout is not None
    text = process.stdout.readline()
    path = tmp_path / "state" / "uoarm" / "tls" / "server.pem"
    assert text == f"certificate {path}, SHA-256 {fingerprint_of(path)}\n"


def test_off_loopback_it_refuses_to_start_without_an_access_file(refuse: Refuse) -> None:
    done = refuse("--host", "0.0.0.0", "--port", "0")
    assert done.exit_code == 3
    assert "--access" in done.stderr


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.2", "robot.example"])
def test_no_address_off_loopback_is_taken_for_loopback(robot: RobotManager, host: str) -> None:
    with pytest.raises(ConfigurationError, match="other machines"):
        serve_in_thread(robot, ServerOptions(host=host)).__enter__()


def test_a_server_can_be_started_and_stopped_again(serve: Serve, robot: RobotManager) -> None:
    for _ in range(3):
        with (
            serve_in_thread(robot, ServerOptions(port=0)) as server,
            Talk(f"ws://127.0.0.1:{server.ports[0]}/") as client,
        ):
            client.open("numbers")
    assert json.loads(page(serve(), "/healthz")[1])["clients"] == 0


def test_a_server_whose_start_hangs_is_an_error_and_leaves_no_thread(
    robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def hang(_: Server) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr(Server, "start", hang)
    monkeypatch.setattr("uoarm.server._running._START_SECONDS", 0.01)
    snapshot = ResourceSnapshot()
    with pytest.raises(TimeoutError, match="does not listen"):
        serve_in_thread(robot, ServerOptions(port=0)).__enter__()
    snapshot.check()


def test_a_server_that_does_not_end_is_reported(
    robot: RobotManager, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    go_on, stop = threading.Event(), Server.stop

    async def keep_the_loop(server: Server) -> None:
        go_on.wait(patience())
        await stop(server)

    monkeypatch.setattr(Server, "stop", keep_the_loop)
    monkeypatch.setattr("uoarm.server._running._END_SECONDS", 0.01)
    with serve_in_thread(robot, ServerOptions(port=0, limits=Limits(stop_seconds=0.01))):
        pass
    assert "the server has not ended" in caplog.text
    go_on.set()
    wait(lambda: all(thread.name != "uoarm-serve" for thread in threading.enumerate()))


def test_what_goes_wrong_while_reloading_ends_no_later_reload(
    caplog: pytest.LogCaptureFixture,
) -> None:
    robot = create_autospec(RobotManager)
    robot.reload.side_effect = [RuntimeError("a fault"), ConfigurationChange(1)]
    _serve._reload(robot)
    assert "a fault" in caplog.text
    _serve._reload(robot)
    assert robot.reload.call_count == 2


def test_the_switch_interval_is_short_while_it_serves(robot: RobotManager) -> None:
    before, during = sys.getswitchinterval(), []

    def ready(_: Server) -> None:
        during.append(sys.getswitchinterval())
        signal.raise_signal(signal.SIGTERM)

    run(robot, ServerOptions(port=0), ready)
    assert during[0] < before / 5
    assert sys.getswitchinterval() == before


def test_a_signal_while_its_loop_closes_is_no_exception(
    robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `make` and a terminal both signal the same Ctrl-C."""
    close = BaseSelectorEventLoop.close
    reports: list[object] = []

    def close_late(loop: BaseSelectorEventLoop) -> None:
        close(loop)  # and the handlers are still there
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(BaseSelectorEventLoop, "close", close_late)
    monkeypatch.setattr(sys, "unraisablehook", reports.append)
    monkeypatch.setitem(sys.modules, "uvloop", None)  # another loop
    run(robot, ServerOptions(port=0), lambda _: signal.raise_signal(signal.SIGTERM))
    assert not reports


def test_a_signal_while_front_ends_are_imported_is_raised_after_that(robot: RobotManager) -> None:
    """Python may drop what is raised there, or leave the lock of all imports taken for good."""
    imported = []

    def front_ends() -> Iterator[FrontEnd]:
        signal.raise_signal(signal.SIGINT)
        imported.append("front end")
        yield from ()

    with pytest.raises(KeyboardInterrupt):
        run(robot, ServerOptions(port=0), front_ends=front_ends())
    assert imported


def _torch(file: Path) -> None:
    """Give the robot one function more."""
    torch = "{name: torch, bridge: python, output: {endpoint: ['tests.server.robot:numbers']}}"
    text = f"{CONFIGURATION}\n  torch:\n    components: [{torch}]\n"
    fresh = file.with_suffix(".new")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(file)


def _until(process: subprocess.Popen[str], wanted: str) -> list[str]:
    """Return what a server writes on standard error up to the wanted line."""
    assert process.stderr is not None
    reports: list[str] = []
    ends = threading.Timer(patience(), process.kill)
    ends.start()
    try:
        while not reports or wanted not in reports[-1]:
            reports.append(process.stderr.readline())
            assert reports[-1], f"the server ended, or it never wrote {wanted!r}: {reports}"
    finally:
        ends.cancel()
        ends.join()
    return reports


@pytest.mark.parametrize("arguments", [(), ("--watch-config",)])
def test_the_configuration_is_read_again_when_it_is_asked_for_or_watched(
    start: Start, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    process, port = start(*arguments)
    with Talk(f"ws://127.0.0.1:{port}/") as client:
        client.open("numbers")
        _torch(tmp_path / "robot.yaml")
        if not arguments:
            process.send_signal(signal.SIGHUP)
        reports = _until(process, "+ function torch")
        assert "revision 1, applied" in "".join(reports)
        client.open("torch")


def test_two_signals_stop_what_moves_and_let_commands_through_again(start: Start) -> None:
    process, _ = start()
    process.send_signal(signal.SIGUSR1)
    reports = _until(process, "nothing open moves")
    assert "commands have been refused for" in "".join(reports)
    process.send_signal(signal.SIGUSR2)
    _until(process, "commands are let through again")


def test_the_stop_is_taken_before_there_is_a_manager_and_after_it() -> None:
    done = run_python(
        "-c",
        """
import os
import signal
from uoarm import RobotManager
from uoarm.cli._serve import stop_signals
from uoarm.config import loads
from uoarm.testing import wait

with stop_signals() as use:
    os.kill(os.getpid(), signal.SIGUSR1)
    with RobotManager(loads("{version: 1, bridges: {python: {}}, functions: {}}")) as manager:
        use(manager)
        wait(lambda: manager.is_stopped)
    os.kill(os.getpid(), signal.SIGUSR1)
""",
    )
    assert done.returncode == 0, done.stderr


def test_the_stop_is_taken_while_what_is_recorded_opens(start: Start, tmp_path: Path) -> None:
    (tmp_path / "early.py").write_text(SIGNALS_AS_IT_OPENS)
    (tmp_path / "robot.yaml").write_text("""
version: 1
bridges: {python: {}}
functions:
  early: {components: [{name: early, bridge: python, output: {endpoint: ["early:Early"]}}]}
record: {functions: [early], path: run.mcap}
""")
    process, _ = start()
    _until(process, "nothing open moves")


def test_what_was_stopped_is_stopped_after_a_restart_until_it_is_released(
    start: Start, tmp_path: Path
) -> None:
    process, port = start()
    with Talk(f"ws://127.0.0.1:{port}/") as client:
        client.ask("Stop")
        process.kill()  # right after the answer
    (kept,) = (tmp_path / "state" / "uoarm" / "stopped").iterdir()
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    process, port = start()
    reports = _until(process, "commands are refused")
    assert str(kept) in reports[-1]
    with Talk(f"ws://127.0.0.1:{port}/") as client:
        assert client.ask("Status")["held"] >= 0
        client.ask("Stop", message={"release": True})
        assert not kept.exists()
        process.kill()
    process, port = start()
    with Talk(f"ws://127.0.0.1:{port}/") as client:
        assert client.ask("Status")["held"] is None


def test_a_file_with_mistakes_leaves_the_configuration_as_it_is(
    start: Start, tmp_path: Path
) -> None:
    process, port = start()
    file = tmp_path / "robot.yaml"
    file.write_text("version: 1\nfunktions: {}\n", encoding="utf-8")
    process.send_signal(signal.SIGHUP)
    assert "stays as it is" in _until(process, "funktions")[0]
    with Talk(f"ws://127.0.0.1:{port}/") as client:
        client.open("numbers")


def test_a_file_that_says_the_same_makes_no_revision(start: Start) -> None:
    process, _ = start()
    process.send_signal(signal.SIGHUP)
    _until(process, "the file is what is in force: nothing changes")


def test_a_mistake_that_is_undone_in_a_watched_file_gets_a_word(
    start: Start, tmp_path: Path
) -> None:
    process, _ = start("--watch-config")
    file = tmp_path / "robot.yaml"
    text = file.read_text(encoding="utf-8")
    file.write_text("version: 1\nfunktions: {}\n", encoding="utf-8")
    _until(process, "stays as it is")
    file.write_text(text, encoding="utf-8")
    _until(process, "the file is again what is in force")
