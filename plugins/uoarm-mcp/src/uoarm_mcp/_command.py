"""`uoarm mcp`: a robot for one agent on standard input and output, or for several over HTTP."""

from __future__ import annotations

import argparse
import asyncio
import ctypes
import fcntl
import json
import os
import queue
import signal
import sys
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

from anyio import AsyncFile
from mcp.server.stdio import stdio_server
from mcp_types import (
    INVALID_REQUEST,
    PARSE_ERROR,
    jsonrpc_message_adapter,
)
from pydantic import ValidationError

from uoarm import RobotManager
from uoarm.bridge import on_failure
from uoarm.errors import CommandLineError, ControlMessageError, ListenError
from uoarm.model import Budget, BudgetUse, scan_json
from uoarm.plugins import Command, CommandParser, hookimpl
from uoarm.server import Limits, Server, ServerOptions, fingerprint_of, run
from uoarm.server.front_end import Discoveries, RefusedError
from uoarm_mcp._schemas import id_of
from uoarm_mcp._service import AgentService

_REFUSED = 1
_LAST_PORT = 65_535
_LINE_OCTETS = 1_048_576
_CHUNK_OCTETS = 65_536
_MOST_LINES = 64
_MOST_WAITING_OCTETS = 8_388_608
_DRAIN_SECONDS = 2.0


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status.

    Raises:
        UoarmError: it cannot be served, or the words are wrong.
    """
    parser = _parser()
    given = parser.parse_args(arguments)
    path = parser.configuration(given)
    try:
        options = ServerOptions(
            host=given.host,
            port=given.port,
            access=given.access,
            certificate=given.certificate,
            key=given.key,
            client_authority=given.client_authority,
            own_certificate=given.tls is not None,
            audit=given.audit,
            front_end_ports={} if given.http is None else {"mcp": given.http},
        )
        served: AbstractContextManager[tuple[int, int] | None] = nullcontext()
        if given.http is None:
            served = own_wire()
        with served as wire, RobotManager.from_file(path) as robot:

            def ready(server: Server) -> None:
                _say(server, options)
                robot.offer(timeout=0)

            if wire is None:
                run(robot, options, ready)
            else:
                token = os.environ.get("UOARM_TOKEN", "").strip()  # as it stands in a file
                asyncio.run(serve_stdio(wire, robot, options, token, ready))
    except RefusedError as error:
        raise CommandLineError(
            str(error), exit_code=_REFUSED, error_code=error.error_code
        ) from error
    except ListenError as error:
        error.name_option({given.port: "--port", given.http: "--http"})
        raise
    return 0


@hookimpl
def uoarm_commands() -> list[Command]:
    """Return `uoarm mcp`."""
    return [Command("mcp", main, contract=1)]


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="uoarm mcp",
        description=f"{__doc__} The token of the agent is UOARM_TOKEN. Approvals are given over "
        "WebSocket, with `uoarm approve`.",
    )
    parser.add_configuration()
    parser.add_argument(
        "--http", type=_port, metavar="PORT", help="serve agents over HTTP at /mcp; 0: a free port"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on")
    parser.add_argument(
        "--port", type=_port, default=9080, help="of the WebSocket server; 0: a free one"
    )
    parser.add_argument("--access", type=Path, help="access file with roles and tokens")
    parser.add_argument("--audit", type=Path, help="file that the audit log is appended to")
    parser.add_argument("--tls", choices=["auto"], help="speak TLS with a certificate made here")
    parser.add_argument("--certificate", type=Path, help="PEM file of the certificate, for TLS")
    parser.add_argument("--key", type=Path, help="PEM file of its key")
    parser.add_argument(
        "--client-authority", type=Path, help="PEM file that client certificates rest on"
    )
    return parser


def _port(given: str) -> int:
    number = int(given) if given.isdecimal() else -1
    if not 0 <= number <= _LAST_PORT:
        raise argparse.ArgumentTypeError(f"expected 0 to {_LAST_PORT}, got {given}")
    return number


def _say(server: Server, options: ServerOptions) -> None:
    s = "s" if options.secured else ""
    places = [options.place_from_here(port) for port in server.ports]
    sys.stderr.write(f"serving ws{s}://{places[0]}/\n")
    for place in places[1:]:
        sys.stderr.write(f"serving http{s}://{place}/mcp for agents\n")
    certificate = options.certificate_file()
    if certificate is not None:
        sys.stderr.write(f"certificate {certificate}, SHA-256 {fingerprint_of(certificate)}\n")
    elif not options.local:
        sys.stderr.write("warning: without TLS, tokens and data can be read on the network\n")
    if options.access is None:
        sys.stderr.write("without an access file nothing that moves can be approved\n")
    sys.stderr.flush()


async def serve_stdio(
    wire: tuple[int, int],
    robot: RobotManager,
    options: ServerOptions,
    token: str,
    serving: Callable[[Server], None],
) -> None:
    """Serve one agent until its input ends or a signal asks for the end, beside the WebSocket.

    Args:
        wire: of `own_wire`.
        robot: whose functions.
        options: of the WebSocket server, at which a person approves.
        token: of the agent.
        serving: called when the server listens.
    """
    incoming, outgoing = wire
    server = Server(robot, options)
    await server.start()
    loop = asyncio.get_running_loop()
    service = None
    try:
        client = server.stateless_clients.local(token)
        serving(server)
        service = AgentService(
            server.backend, Discoveries(server.backend), version("uoarm-mcp"), client
        )
        written = _OutputLines(outgoing)
        with on_failure(written.drain):
            lines = _InputLines(incoming, _budget(server.backend.limits), written)
        for number in (signal.SIGTERM, signal.SIGINT):
            # As if the client had closed its end: what is under way ends in the same way.
            loop.add_signal_handler(number, lines.end)
        client.on_end(lines.end)
        files = cast("AsyncFile[str]", lines), cast("AsyncFile[str]", written)
        protocol = service.protocol
        async with stdio_server(*files) as (messages, answers):
            await protocol.run(messages, answers, protocol.create_initialization_options())
        written.drain()
    finally:
        if service is not None:
            service.close()
        await server.stop()


@contextmanager
def own_wire() -> Iterator[tuple[int, int]]:
    """Give descriptors of standard input and output that nothing else in the process has.

    Meanwhile what is printed goes to standard error, and what reads standard input reads nothing.
    Components may do so from their import to their close. The descriptors stay open: a thread may
    wait on one of them for as long as the process lasts.
    """
    incoming, outgoing = (fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, 3) for number in (0, 1))
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    try:
        yield incoming, outgoing
    finally:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).fflush(None)  # what C code has printed, and not written yet
        os.dup2(incoming, 0)
        os.dup2(outgoing, 1)


def _budget(limits: Limits) -> Budget:
    octets = min(_LINE_OCTETS, limits.message_bytes)
    return Budget(octets, limits.elements, limits.depth, limits.dimensions)


class _InputLines:
    """Lines of a descriptor, read in a daemon thread, which no one waits for.

    `os.read` holds no lock of a file object: the interpreter can end while the thread waits in it.
    A line that is no message, or costs more than its budget, is answered here: the SDK leaves it
    out, and its client would wait. None is taken while as many answers wait as may.
    """

    def __init__(self, descriptor: int, budget: Budget, answers: _OutputLines) -> None:
        self._descriptor = descriptor
        self._budget = budget
        self._answers = answers
        self._loop = asyncio.get_running_loop()
        self._lines: deque[str | None] = deque()
        self._room = threading.Semaphore(_MOST_LINES)  # lines that the loop has not taken yet
        threading.Thread(target=self._read, name="uoarm-mcp-stdin", daemon=True).start()

    def end(self) -> None:
        """Have the input end here, whatever else comes. In the loop's thread. Idempotent."""
        self._take(None)
        # The answers that wait have a moment; a client that does not read holds up no end.
        self._loop.call_later(_DRAIN_SECONDS, self._answers.give_up)

    async def __aiter__(self) -> AsyncIterator[str]:
        while True:
            while not self._lines or self._answers.are_many:
                await self._answers.change()
            line = self._lines.popleft()
            if line is None:
                return
            self._room.release()
            error = self._error(line)
            if error is None:
                yield line
            else:
                self._answers.put(f"{json.dumps(error)}\n")

    def _error(self, line: str) -> Mapping[str, Any] | None:
        """Return the answer to what is no message, None where it is one."""
        try:
            scan_json(line, BudgetUse(self._budget))
            jsonrpc_message_adapter.validate_json(line, by_name=False)
            id_of(line, self._budget)
        except ControlMessageError as refused:
            code, text = INVALID_REQUEST, str(refused)
        except ValidationError as refused:
            kind = refused.errors(include_input=False)[0]["type"]
            code = PARSE_ERROR if kind in {"json_invalid", "string_unicode"} else INVALID_REQUEST
            most = f"{_LINE_OCTETS:,} octets at most"
            text = f"expected one message of JSON-RPC, in UTF-8, in a line of {most}"
        else:
            return None
        return {"jsonrpc": "2.0", "id": _id_in(line), "error": {"code": code, "message": text}}

    def _read(self) -> None:
        rest = bytearray()
        is_late = False  # whether a line is left out whose beginning was too long
        while chunk := self._chunk():
            *lines, last = chunk.split(b"\n")
            for line in lines:
                rest += line
                if not is_late:
                    self._put(rest.decode("utf-8", "surrogateescape"))
                is_late = False
                rest.clear()
            if not is_late:
                rest += last
            if len(rest) > _LINE_OCTETS:
                self._put("too long")  # no JSON, and answered as such
                is_late = True
                rest.clear()
        if rest:  # the last line may have no end
            self._put(rest.decode("utf-8", "surrogateescape"))
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self.end)

    def _chunk(self) -> bytes:
        try:
            return os.read(self._descriptor, _CHUNK_OCTETS)
        except OSError:
            return b""

    def _put(self, line: str) -> None:
        self._room.acquire()
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._take, line)

    def _take(self, line: str | None) -> None:
        self._lines.append(line)
        self._answers.changed.set()


def _id_in(line: str) -> str | int | None:
    """Return the id of a request that is refused: its client waits for the answer by that."""
    try:
        message = json.loads(line)  # which takes more than JSON
    except (ValueError, RecursionError):
        return None
    found = message.get("id") if isinstance(message, dict) and "method" in message else None
    return found if type(found) in {str, int} else None


class _OutputLines:
    """Writes to a descriptor in a daemon thread; what waits is bounded.

    So a client that does not read holds up nothing but its own requests and answers.

    Attributes:
        changed: set when something was written, and by the input when something came.
    """

    def __init__(self, descriptor: int) -> None:
        self.changed = asyncio.Event()
        self._descriptor = descriptor
        self._loop = asyncio.get_running_loop()
        self._waiting: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._octets = 0  # that wait; in the loop's thread alone
        self._is_given_up = False
        self._thread = threading.Thread(target=self._write, name="uoarm-mcp-stdout", daemon=True)
        self._thread.start()

    @property
    def are_many(self) -> bool:
        """Whether more octets wait than may; what is given up waits for no one."""
        return self._octets > _MOST_WAITING_OCTETS and not self._is_given_up

    async def change(self) -> None:
        """Wait until something was written, or came."""
        self.changed.clear()
        await self.changed.wait()

    async def write(self, text: str) -> None:
        """Have a text written after those before it."""
        while self.are_many:
            await self.change()
        self.put(text)

    def put(self, text: str) -> None:
        """Have a text written, however many wait."""
        if not self._is_given_up:
            data = text.encode()
            self._octets += len(data)
            self._waiting.put(data)

    def give_up(self) -> None:
        """Leave out what comes from now on, so that no writer waits. Idempotent."""
        self._is_given_up = True
        self.changed.set()

    async def flush(self) -> None:
        """Do nothing: nothing is held back."""

    def drain(self) -> None:
        """Wait a moment until all is written."""
        self._waiting.put(None)
        self._thread.join(_DRAIN_SECONDS)

    def _write(self) -> None:
        is_gone = False
        while (data := self._waiting.get()) is not None:
            rest = memoryview(data)
            while rest and not is_gone:
                try:
                    rest = rest[os.write(self._descriptor, rest) :]
                except OSError:
                    is_gone = True  # the client is; its input ends, too
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._written, len(data))

    def _written(self, octets: int) -> None:
        self._octets -= octets
        self.changed.set()
