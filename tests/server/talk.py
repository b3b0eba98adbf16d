"""A plain client for tests: one blocking WebSocket, answers by id, everything else in order."""

from __future__ import annotations

import itertools
import json
import select
import socket
import ssl
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from typing_extensions import Self
from websockets.frames import Frame, Opcode
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from uoarm import RobotManager
from uoarm._wire import protocol_schema, read_binary, write_binary
from uoarm.client._requests import checked_answer
from uoarm.model import Budget, BudgetUse, ConnectionState
from uoarm.testing import patience, wait

SECONDS = patience()
# The server's thread makes random ping payloads while hypothesis draws in this one.
BESIDE = pytest.mark.filterwarnings("ignore:Do not use the .random. module")
REPORTS = {
    op: Draft202012Validator({**protocol_schema(), "$ref": f"#/$defs/server.{op}"})
    for op in ("Reply", "Error", "Data", "Status")
}


class TlsSocket(ssl.SSLSocket):
    """Is read and written by one thread at a time, as `context.sslsocket_class`.

    The blocking client of websockets does both at once, which OpenSSL does not allow: of a hundred
    connections one loses an answer to it, and waits for ever. Of 800 in turns with this, none did.
    """

    def __new__(cls, *arguments: Any, **options: Any) -> Self:
        made = super().__new__(cls, *arguments, **options)
        made._turn = threading.Lock()
        return made

    _turn: threading.Lock

    def recv(self, buflen: int = 1024, flags: int = 0) -> bytes:
        while True:
            with self._turn:
                limit = self.gettimeout()
                self.settimeout(0)
                try:
                    return super().recv(buflen, flags)
                except ssl.SSLWantReadError:  # what came was no data of the other side yet
                    pass
                finally:
                    self.settimeout(limit)
            select.select([self], [], [])

    def sendall(self, data: Any, flags: int = 0) -> None:
        with self._turn:
            super().sendall(data, flags)


class Talk:
    """Speaks the native protocol and checks each message of the server against the schema."""

    def __init__(self, url: str, *, binary: bool = False, **options: Any) -> None:
        self.binary = binary
        protocols = [Subprotocol("uoarm.v1.cbor" if binary else "uoarm.v1.json")]
        options = {
            "subprotocols": protocols,
            "max_size": None,
            "compression": None,
            "ping_interval": None,  # a machine that has other work answers late, too
        } | options
        if "ssl" in options:
            options["ssl"].sslsocket_class = TlsSocket
        self._open = ExitStack()
        self.socket = self._open.enter_context(connect(url, **options))
        self._ids = itertools.count(1)
        self._answers: dict[str | None, dict[str, Any]] = {}
        self._others: deque[dict[str, Any]] = deque()
        self.hello = self.next("hello")["jsonMessage"]

    def raw(self, frame: str | bytes) -> None:
        self.socket.send(frame)

    def send(self, op: str, kind: str = "", message: object = None, **more: object) -> str:
        identity = str(next(self._ids))
        fields: dict[str, Any] = {"op": op, "id": identity, **more}
        if kind:
            fields["type"] = kind
        if message is not None:
            fields["jsonMessage"] = message
        self.raw(write_binary(fields) if self.binary else json.dumps(fields))
        return identity

    def answer(self, identity: str | None) -> dict[str, Any]:
        while identity not in self._answers:
            self._receive()
        return self._answers.pop(identity)

    def ask(self, op: str, kind: str = "", message: object = None, **more: object) -> Any:
        """Return the reply's message, or fail with the error.

        What the clients rely on of an answer is there in each.
        """
        reply = self.answer(self.send(op, kind, message, **more))
        assert reply["op"] == "Reply", reply
        asked = {"op": op, "type": kind, "jsonMessage": message}
        return checked_answer(asked, reply.get("jsonMessage"))

    def refused(self, op: str, kind: str = "", message: object = None, **more: object) -> Any:
        """Return code and text of the error."""
        reply = self.answer(self.send(op, kind, message, **more))
        assert reply["op"] == "Error", reply
        return reply["jsonMessage"]

    def open(self, name: str, **options: object) -> str:
        connection: str = self.ask("Request", name, options or None)["connection"]
        return connection

    def next(self, kind: str) -> dict[str, Any]:
        """Return the next message that is no answer and has this type."""
        while True:
            for item in self._others:
                if item["type"] == kind:
                    self._others.remove(item)
                    return item
            self._receive()

    def data(self, connection: str, count: int) -> list[Any]:
        return [self.next(connection)["jsonMessage"] for _ in range(count)]

    @property
    def unanswered(self) -> list[str | None]:
        """Ids of answers that came and that were not asked for yet."""
        return list(self._answers)

    def close(self) -> None:
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _receive(self) -> None:
        frame = self.socket.recv(timeout=SECONDS)
        assert isinstance(frame, bytes) == self.binary
        if isinstance(frame, bytes):
            report = read_binary(frame, BudgetUse(Budget()))
        else:
            report = json.loads(frame)
        REPORTS[report["op"]].validate(report)
        if report["op"] in {"Reply", "Error"}:
            assert report.get("id") not in self._answers, "a second answer"
            self._answers[report.get("id")] = report
        else:
            self._others.append(report)


def eventually(condition: Callable[[], object], what: str) -> None:
    """Wait until something is so; fail with its name when it does not come about."""
    wait(condition, f"never: {what}")


def opened(robot: RobotManager, count: int) -> None:
    """Wait until so many connections run, and no others are there."""

    def all_run() -> bool:
        states = [connection.state for connection in robot.status().connections]
        return states == [ConnectionState.RUNNING] * count

    eventually(all_run, f"{count} are open")


def request(port: int, path: str = "/") -> bytes:
    """Return the head of an opening handshake."""
    return (
        f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n"
    ).encode()


def open_socket(port: int, path: str = "/") -> socket.socket:
    """Return a socket after its handshake, without anything that would read from it."""
    plain = socket.create_connection(("127.0.0.1", port), timeout=patience())
    plain.sendall(request(port, path))
    answer = b""
    while b"\r\n\r\n" not in answer:
        answer += plain.recv(1)
    assert answer.startswith(b"HTTP/1.1 101")
    return plain


def frame(data: bytes, opcode: Opcode = Opcode.TEXT) -> bytes:
    return Frame(opcode, data).serialize(mask=True)
