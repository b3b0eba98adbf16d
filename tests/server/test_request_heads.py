"""Whatever stands in the head of a request: an answer, never a traceback or a 500."""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.server.conftest import Serve
from tests.server.talk import BESIDE, SECONDS

from uoarm.server import Server, hash_token

pytestmark = BESIDE
ACCESS = "version: 1\nroles: {all: {see: ['*']}}\ntokens: [{name: t, role: all, sha256: %s}]\n"
UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    "Sec-WebSocket-Version": "13",
}


class Log(logging.Handler):
    """Keeps what was logged as an error, or with a traceback."""

    def __init__(self) -> None:
        super().__init__()
        self.bad: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info or record.levelno >= logging.ERROR:
            self.bad.append(self.format(record))


@pytest.fixture
def log() -> Iterator[Log]:
    log = Log()
    logging.getLogger().addHandler(log)
    yield log
    logging.getLogger().removeHandler(log)


@pytest.fixture
def guarded(serve: Serve, tmp_path: Path) -> Server:
    access = tmp_path / "access.yaml"
    access.write_text(ACCESS % hash_token("secret"), encoding="utf-8")
    return serve(access=access)


def status(server: Server, head: bytes, *, whole: bool = True) -> int:
    """Send the head of a request and return the status of its answer, 0 for none.

    One that is not whole is ended by closing, so that the server does not wait for the rest.
    """
    with socket.create_connection(("127.0.0.1", server.ports[0]), timeout=SECONDS) as plain:
        plain.sendall(head)
        if not whole:
            plain.shutdown(socket.SHUT_WR)
        answer = b""
        while b"\r\n" not in answer:
            try:
                more = plain.recv(4096)
            except ConnectionResetError:
                more = b""
            if not more:
                return 0
            answer += more
    return int(answer.split(b" ", 2)[1])


def head(path: str, *headers: tuple[str, str], method: str = "GET") -> bytes:
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers)]
    return "\r\n".join([*lines, "", ""]).encode("latin-1")


HOST = ("Host", "127.0.0.1")
TOKEN = ("Authorization", "Bearer secret")
OPENING = tuple(UPGRADE.items())


@pytest.mark.parametrize("more", [(), OPENING], ids=["page", "websocket"])
@pytest.mark.parametrize("path", ["/", "/metrics", "/rosbridge"])
@pytest.mark.parametrize("twice", [HOST, ("Origin", "http://127.0.0.1"), TOKEN], ids=lambda h: h[0])
def test_a_header_that_decides_and_comes_twice_is_a_bad_request(
    guarded: Server, log: Log, twice: tuple[str, str], path: str, more: tuple[tuple[str, str], ...]
) -> None:
    rest = [pair for pair in (HOST, TOKEN) if pair != twice]
    assert status(guarded, head(path, *rest, twice, twice, *more)) == 400
    other = (twice[0], "another")
    assert status(guarded, head(path, *rest, twice, other, *more)) == 400
    assert log.bad == []


@pytest.mark.parametrize("more", [(), OPENING], ids=["page", "websocket"])
@pytest.mark.parametrize("path", ["//[x", "http://[", "/?" + "&".join("abcdefghijklm"), "//[::1"])
def test_a_path_that_is_none_is_a_bad_request(
    guarded: Server, log: Log, path: str, more: tuple[tuple[str, str], ...]
) -> None:
    assert status(guarded, head(path, HOST, *more)) == 400
    assert log.bad == []


def test_a_token_in_a_path_that_cannot_be_read_is_not_logged(
    guarded: Server, caplog: pytest.LogCaptureFixture
) -> None:
    for path in ("//[?token=secret", "/?token=secret" + "&x=1" * 20):
        assert status(guarded, head(path, HOST)) == 400
    assert "cannot be read" in caplog.text
    assert "secret" not in caplog.text


NAMES = [*UPGRADE, "Host", "Origin", "Authorization", "Sec-WebSocket-Protocol", "Cookie"]
NAMES += ["Sec-WebSocket-Extensions", "Content-Length", "Transfer-Encoding", "Connection", "X"]
VALUES = [*UPGRADE.values(), "127.0.0.1", "[::1", "[", "@", "127.0.0.1:x", "null", "http://["]
VALUES += ["Bearer secret", "Bearer", "bearer  ", "Basic x", "uoarm.token.", "uoarm.token.secret"]
VALUES += ["uoarm.v1.json", "uoarm.v9.json", ",", ";", '"', "", "0", "chunked", "é", "permessage-"]
TEXT = st.text(st.characters(min_codepoint=0x20, max_codepoint=0xFF), max_size=20)
HEADERS = st.lists(st.tuples(st.sampled_from(NAMES), st.sampled_from(VALUES) | TEXT), max_size=8)
STEPS = [
    "/",
    "//",
    "[",
    "]",
    "x",
    "?",
    "#",
    "%",
    "%00",
    "%ff",
    "\xe9",
    "token=",
    "&",
    ";",
    "=",
    ":",
    "@",
    ".",
]
PATHS = st.sampled_from(["/", "/rosbridge", "/metrics", "/healthz", "*"]) | st.lists(
    st.sampled_from(STEPS), max_size=8
).map("".join)


@settings(suppress_health_check=list(HealthCheck), deadline=None)
@given(
    method=st.sampled_from(["GET", "GET", "GET", "POST", "HEAD", "", "\x00"]),
    path=PATHS,
    base=st.sampled_from([(HOST,), (HOST, *OPENING), (HOST, TOKEN, *OPENING), ()]),
    headers=HEADERS,
)
def test_no_head_of_a_request_makes_a_traceback_or_a_500(
    guarded: Server,
    log: Log,
    method: str,
    path: str,
    base: tuple[tuple[str, str], ...],
    headers: list[tuple[str, str]],
) -> None:
    answered = status(guarded, head(path, *base, *headers, method=method))
    assert answered < 500 or answered == 505
    assert log.bad == []
    assert status(guarded, head("/healthz", HOST)) == 200


@settings(suppress_health_check=list(HealthCheck), deadline=None)
@given(st.binary(max_size=200))
def test_no_octets_instead_of_a_request_make_a_traceback(
    guarded: Server, log: Log, data: bytes
) -> None:
    answered = status(guarded, data, whole=False)
    assert answered < 500 or answered == 505
    assert log.bad == []
