"""`uoarm mcp` as a client starts it: on standard input and output, with a token of its own."""

from __future__ import annotations

import asyncio
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from agents import TOKENS, text_of
from click.testing import CliRunner
from components import CONFIGURATION
from mcp.client.client import Client
from mcp.client.stdio import StdioServerParameters, stdio_client
from tests.no_threads import no_threads  # type: ignore[import-not-found]
from uoarm_mcp import _command
from uoarm_mcp._command import serve_stdio

from uoarm import RobotManager
from uoarm.cli import main
from uoarm.client import connect
from uoarm.config import loads
from uoarm.model import Budget
from uoarm.server import ServerOptions, fingerprint_of
from uoarm.testing import ResourceSnapshot, patience, wait

FOLDER = Path(__file__).parent


def test_an_agent_for_whose_lines_there_is_no_thread_leaves_nothing() -> None:
    ends = *os.pipe(), *os.pipe()
    wire, before = (ends[0], ends[3]), ResourceSnapshot()
    robot = RobotManager(loads("{version: 1, bridges: {}, functions: {}}"))
    with robot, no_threads("uoarm-mcp-stdin"), pytest.raises(RuntimeError, match="new thread"):
        asyncio.run(serve_stdio(wire, robot, ServerOptions(port=0), "", lambda _: None))
    before.check()
    for end in ends:
        os.close(end)


async def _with(
    folder: Path, access: Path, token: str, act: Any, mode: str = "auto"
) -> tuple[Any, str]:
    configuration = folder / "robot.yaml"
    configuration.write_text(CONFIGURATION, encoding="utf-8")
    audit = folder / "audit.jsonl"
    words = ["mcp", str(configuration), "--port", "0", "--access", str(access)]
    parameters = StdioServerParameters(
        command=sys.executable,
        args=["-m", "uoarm", *words, "--audit", str(audit)],
        env={**os.environ, "UOARM_TOKEN": token, "PYTHONPATH": str(FOLDER)},
    )
    with tempfile.TemporaryFile("w+", dir=folder) as errors:
        transport = stdio_client(parameters, errlog=errors)
        async with Client(transport, mode=mode, read_timeout_seconds=patience()) as client:
            errors.seek(0)
            found = re.search(r"serving (wss?://\S+)", errors.read())
            assert found is not None
            answer = await act(client, found[1])
    return answer, audit.read_text(encoding="utf-8")


def test_an_agent_asks_and_a_person_approves_over_websocket(tmp_path: Path, access: Path) -> None:
    async def act(client: Client, url: str) -> list[Any]:
        asked = await client.call_tool("cuff", {"pressure": 90.0})
        handle = asked.structured_content["handle"]
        async with connect(url, token=TOKENS["nurse"]) as nurse:
            await nurse.approve(handle)
        done = await client.call_tool("cuff", {"pressure": 90.0, "x-approval": handle})
        again = await client.call_tool("cuff", {"pressure": 90.0, "x-approval": handle})
        return [done.structured_content["result"], text_of(again)]

    (result, refusal), audit = asyncio.run(_with(tmp_path, access, TOKENS["agent"], act))
    assert result == {"value": 90}
    assert "is used" in refusal
    lines = [json.loads(line) for line in audit.splitlines()]
    phases = [line["phase"] for line in lines if "phase" in line]
    assert phases == ["pending", "approved", "used"]
    assert [line["refused"] for line in lines if "requester" in line and "refused" in line]
    assert (tmp_path / "audit.jsonl").stat().st_mode & 0o777 == 0o600


def test_the_revision_before_speaks_there_too(tmp_path: Path, access: Path) -> None:
    async def act(client: Client, url: str) -> Any:
        del url
        return (await client.call_tool("add", {"a": 1, "b": 2})).structured_content["result"]

    result, _ = asyncio.run(_with(tmp_path, access, TOKENS["agent"], act, "legacy"))
    assert result == {"value": 3}


META = {
    "io.modelcontextprotocol/protocolVersion": "2026-07-28",
    "io.modelcontextprotocol/clientInfo": {"name": "test", "version": "1"},
    "io.modelcontextprotocol/clientCapabilities": {},
}


@contextmanager
def started(
    folder: Path, access: Path, text: str = CONFIGURATION, *more: str
) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start the command, and give its process and the address of its WebSocket server."""
    configuration = folder / "robot.yaml"
    configuration.write_text(text, encoding="utf-8")
    words = ["mcp", str(configuration), "--port", "0", "--access", str(access), *more]
    environment = {**os.environ, "UOARM_TOKEN": TOKENS["agent"] + "\n", "PYTHONPATH": str(FOLDER)}
    errors = folder / "errors.txt"
    with (
        errors.open("wb") as written,
        subprocess.Popen(
            [sys.executable, "-m", "uoarm", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=written,
            env=environment,
        ) as process,
    ):
        try:
            wait(
                lambda: process.poll() is not None or "serving ws" in errors.read_text("utf-8"),
                "it serves",
            )
            found = re.search(r"serving (wss?://\S+)", errors.read_text("utf-8"))
            assert found is not None
            yield process, found[1]
        finally:
            process.kill()


def ask(process: subprocess.Popen[bytes], number: int, arguments: dict[str, Any]) -> None:
    """Send the call of a tool."""
    parameters = {"name": "add", "arguments": arguments, "_meta": META}
    body = {"jsonrpc": "2.0", "id": number, "method": "tools/call", "params": parameters}
    assert process.stdin is not None
    process.stdin.write(json.dumps(body).encode() + b"\n")
    process.stdin.flush()


def answer(process: subprocess.Popen[bytes]) -> dict[str, Any]:
    """Return what the next line says."""
    assert process.stdout is not None
    found: dict[str, Any] = json.loads(process.stdout.readline())
    return found


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_it_though_its_input_stays_open(
    tmp_path: Path, access: Path, number: signal.Signals
) -> None:
    with started(tmp_path, access) as (process, _):
        ask(process, 1, {"a": 1, "b": 2})
        assert answer(process)["result"]["structuredContent"]["result"] == {"value": 3}
        process.send_signal(number)
        assert process.wait(patience()) == 0
        assert process.stdout is not None
        assert process.stdout.read() == b""
    errors = (tmp_path / "errors.txt").read_text("utf-8")
    assert "Traceback" not in errors
    assert "Fatal" not in errors


def test_what_clients_of_tls_must_know_is_printed(
    tmp_path: Path, access: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with started(tmp_path, access, CONFIGURATION, "--tls", "auto") as (_, url):
        errors = tmp_path / "errors.txt"
        path = tmp_path / "uoarm" / "tls" / "server.pem"
        said = f"certificate {path}, SHA-256 {fingerprint_of(path)}\n"
        wait(lambda: said in errors.read_text("utf-8"), "the fingerprint is printed")
    assert url.startswith("wss://")


def test_the_end_of_its_input_ends_it(tmp_path: Path, access: Path) -> None:
    with started(tmp_path, access) as (process, _):
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(patience()) == 0


def test_what_is_too_long_or_no_message_is_left_out(tmp_path: Path, access: Path) -> None:
    with started(tmp_path, access) as (process, _):
        assert process.stdin is not None
        process.stdin.write(b"x" * 3_000_000 + b"\nnothing\n\xff\xfe\n")
        ask(process, 7, {"a": 1, "b": 2})
        found = answer(process)
        while found.get("id") != 7:
            found = answer(process)
        assert found["result"]["structuredContent"]["result"] == {"value": 3}


def request(identity: str, more: bytes) -> bytes:
    return b'{"jsonrpc": "2.0", "id": %s, "method": "a"%s}' % (identity.encode(), more)


NO_MESSAGES = (
    (b'{"jsonrpc": "2.0", "id": 1, "meth', None, -32700, "one message of JSON-RPC"),
    (b"{}", None, -32600, "one message of JSON-RPC"),
    (b'{"jsonrpc": "1.0", "id": "a", "method": "b"}', "a", -32600, "one message of JSON-RPC"),
    (request('"\\ud800"', b""), "\ud800", -32700, "one message of JSON-RPC"),
    (request("1", b', "params": {"a": "\xff"}'), 1, -32700, "JSON-RPC, in UTF-8"),
    (request("1", b', "params": {"a": NaN}'), 1, -32600, "not JSON"),
    (request("1", b', "params": {"a": 1, "a": 2}'), 1, -32600, "given twice"),
    (b"[" * 200, None, -32600, "nested more than 64 levels deep"),
    (request('"all"', b', "params": [0' + b",0" * 510_000 + b"]"), "all", -32600, "500,000 values"),
    (b"x" * 3_000_000, None, -32700, "1,048,576 octets at most"),
    (request("1.5", b""), None, -32600, "string or a whole number"),
    (request("null", b""), None, -32600, "string or a whole number"),
    (b'{"jsonrpc": "2.0", "id": 1, "result": NaN}', None, -32600, "one message of JSON-RPC"),
)


def test_a_line_that_is_no_message_is_answered_by_its_id(tmp_path: Path, access: Path) -> None:
    with started(tmp_path, access) as (process, _):
        assert process.stdin is not None
        for number, (line, identity, code, reason) in enumerate(NO_MESSAGES, 2):
            process.stdin.write(line + b"\n")
            ask(process, number, {"a": 1, "b": 2})
            found = answer(process)
            assert (found["id"], found.get("error", {}).get("code")) == (identity, code), line[:80]
            assert reason in found["error"]["message"]
            assert answer(process)["id"] == number


async def test_the_last_line_needs_no_end() -> None:
    (incoming, going), (coming, outgoing) = os.pipe(), os.pipe()
    written = _command._OutputLines(outgoing)
    lines = _command._InputLines(incoming, Budget(1000, 1000, 10, 2), written)
    os.write(going, b'{"jsonrpc": "2.0", "method": "a"}\n{"jsonrpc": "2.0", "method": "b"}')
    os.close(going)
    assert [json.loads(line)["method"] async for line in lines] == ["a", "b"]
    written.drain()
    for end in (incoming, coming, outgoing):
        os.close(end)


def test_an_agent_that_reads_nothing_holds_up_no_person(tmp_path: Path, access: Path) -> None:
    async def approvals(url: str) -> Any:
        async with connect(url, token=TOKENS["nurse"]) as nurse:
            return await nurse.approvals()

    with started(tmp_path, access) as (process, url):
        for number in range(200):  # more than a pipe holds
            ask(process, number, {"a": 1, "b": 2})
        assert asyncio.run(asyncio.wait_for(approvals(url), patience())) == []
        assert sorted(answer(process)["id"] for _ in range(200)) == list(range(200))


def test_a_signal_ends_it_though_its_client_reads_nothing(tmp_path: Path, access: Path) -> None:
    with started(tmp_path, access) as (process, _):
        assert process.stdin is not None
        body = {"jsonrpc": "2.0", "id": 1, "method": "tools/list", "params": {"_meta": META}}
        line = json.dumps(body).encode() + b"\n"
        os.set_blocking(process.stdin.fileno(), False)
        answers = 10_000_000 // 20_000  # more octets than may wait
        sent = 0
        while sent < answers * len(line):
            rest = line[sent % len(line) :] + line
            if select.select([], [process.stdin], [], 1)[1]:
                sent += os.write(process.stdin.fileno(), rest)
            else:
                break  # it takes no more
        process.send_signal(signal.SIGTERM)
        assert process.wait(patience()) == 0


async def test_while_many_answers_wait_no_line_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_command, "_MOST_WAITING_OCTETS", 1)
    monkeypatch.setattr(_command, "_DRAIN_SECONDS", 0)
    (incoming, going), (coming, outgoing) = os.pipe(), os.pipe()
    written = _command._OutputLines(outgoing)
    written.put("x" * 1_000_000)  # more than a pipe holds
    lines = _command._InputLines(incoming, Budget(1000, 1000, 10, 2), written)
    os.write(going, b'{"jsonrpc": "2.0", "method": "a"}\n{\n')
    taken = aiter(lines)
    first = asyncio.ensure_future(anext(taken))
    while len(lines._lines) < 2:
        await written.change()
    await asyncio.sleep(0)
    assert not first.done()
    lines.end()
    assert "method" in await first
    assert await anext(taken, None) is None
    await written.write("more")
    os.close(going)
    unread = 1_000_000
    while unread:
        unread -= len(os.read(coming, unread))
    written.drain()
    os.close(coming)
    os.close(incoming)
    os.close(outgoing)


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["-f", "none.yaml", "--http", "0"], 3, "none.yaml: the file cannot be read"),
        (["robot.yaml", "-f", "none.yaml"], 2, "the configuration is named twice"),
        (["--http", "65536"], 2, "argument --http: expected 0 to 65535, got 65536"),
        (["--port", "-1"], 2, "argument --port: expected 0 to 65535, got -1"),
    ],
)
def test_wrong_words_are_one_clear_error(words: list[str], code: int, text: str) -> None:
    done = CliRunner().invoke(main, ["mcp", *words])
    assert (done.exit_code, done.stdout) == (code, ""), done.output
    assert text in done.stderr


NOISY = """
import ctypes, os
def say(when):
    print("Python says", when)
    os.system(f"echo a program says {when}")
    ctypes.CDLL(None).printf(f"C says {when}\\n".encode())
say("import")
def add(numbers: dict[str, int]) -> dict[str, int]:
    say("call")
    return {"value": sum(numbers.values())}
"""


def test_nothing_that_components_print_stands_among_the_answers(
    tmp_path: Path, access: Path
) -> None:
    (tmp_path / "noisy.py").write_text(NOISY)
    text = CONFIGURATION.replace("components:add", "noisy:add")
    with started(tmp_path, access, text) as (process, _):
        ask(process, 1, {"a": 1, "b": 2})
        assert answer(process)["result"]["structuredContent"]["result"] == {"value": 3}
        assert process.communicate(timeout=patience())[0] == b""
    errors = (tmp_path / "errors.txt").read_text("utf-8")
    for who in ("Python", "a program", "C"):
        assert f"{who} says import\n" in errors
        assert f"{who} says call\n" in errors


@pytest.mark.parametrize("option", ["--http", "--port"])
def test_a_port_that_is_taken_is_said_without_a_number_of_the_system(
    tmp_path: Path, option: str
) -> None:
    (tmp_path / "robot.yaml").write_text("version: 1\nbridges: {}\nfunctions: {}\n")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        words = ["mcp", str(tmp_path / "robot.yaml"), "--http", "0", "--port", "0", option, port]
        done = CliRunner().invoke(main, words)
    assert done.exit_code == 5, done.output
    assert (
        f"error: cannot listen on 127.0.0.1:{port}: Address already in use; {option} takes another"
        in done.stderr
    )
