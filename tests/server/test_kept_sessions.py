"""What the server keeps of a session, message by message: its key, its rights, its answers."""

from __future__ import annotations

import json
import re
import socket
import struct
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.server.conftest import Between, Connect, Serve
from tests.server.robot import script
from tests.server.serving import access_file
from tests.server.talk import Talk, eventually, frame, open_socket
from tests.server.test_serving import figures

from uoarm.server import Limits, Server
from uoarm.server.session._session_store import ReplyCache
from uoarm.server.streams._memory import ServerMemory


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
    assert [item["connection"] for item in taken["own"]] == [connection]
    assert second.answer("never sent")["jsonMessage"]["code"] == "closed"
    script.gate.set()
    assert second.answer(call)["jsonMessage"] == {"value": 1}
    script.put({"value": 5})
    assert second.data(connection, 1) == [{"value": 5}]
    second.ask("Kill", connection)


def test_an_answer_that_waits_is_not_sent_twice(server: Server, between: Between) -> None:
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
        assert not second.unanswered


def test_another_s_session_is_not_taken_up(serve: Serve, tmp_path: Path) -> None:
    access = access_file(tmp_path, ACCESS, {"one": "one", "other": "other"})
    url = f"ws://127.0.0.1:{serve(access=access).ports[0]}/"
    with Talk(f"{url}?token=one") as first, Talk(f"{url}?token=other") as second:
        key = first.ask("Resume")["key"]
        assert second.refused("Resume", message={"key": key})["code"] == "unknown"
        with Talk(f"{url}?token=one") as third:
            assert third.ask("Resume", message={"key": key})["session"] == first.hello["session"]


ACCESS = """
version: 1
roles: {{all: {{see: all, request: ["*"]}}}}
tokens: [{{name: one, role: all, sha256: {one}}}, {{name: other, role: all, sha256: {other}}}]
"""


@given(
    st.lists(st.tuples(st.sampled_from("abcdef"), st.integers(0, 9), st.booleans())),
    st.integers(1, 4),
    st.integers(1, 20),
)
def test_kept_answers_are_bounded_and_the_newest(
    steps: list[tuple[str, int, bool]], most: int, most_bytes: int
) -> None:
    answers = ReplyCache(most, most_bytes, ServerMemory(10**6, 10**6).open())
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
        assert sum(len(chunk or b"") for chunk in kept.values()) <= most_bytes


def test_sessions_that_wait_are_bounded_in_octets_and_those_that_hold_most_end_first(
    serve: Serve, between: Between
) -> None:
    server = serve(Limits(kept_bytes=2_000_000))
    proxy = between(server)
    with ExitStack() as stack:
        kept = [stack.enter_context(Talk(f"ws://127.0.0.1:{proxy.port}/")) for _ in range(4)]
        keys = [talk.ask("Resume")["key"] for talk in kept]
        text = "x" * 100_000
        for number, talk in enumerate(kept):  # answers of 0, 0.5, 1 and 1.5 MB are kept
            for _ in range(5 * number):
                assert talk.ask("Call", "parrot", {"text": text}) == {"text": text}
        proxy.cut()
        waiting = "uoarm_serve_kept_sessions 3.0"
        eventually(lambda: waiting in figures(server), "the one that holds most is ended")
        assert server.held_octets <= 2_000_000
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as late:
        assert late.refused("Resume", message={"key": keys[3]})["code"] == "unknown"
    for key in keys[:3]:
        with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as again:
            assert again.ask("Resume", message={"key": key})


def _receive(plain: socket.socket) -> Any:
    """Return the next message of the server, read without a library and its thread."""
    head = _octets(plain, 2)
    size = head[1]
    if size > 125:
        size = int.from_bytes(_octets(plain, 2 if size == 126 else 8), "big")
    return json.loads(_octets(plain, size))


def _octets(plain: socket.socket, count: int) -> bytes:
    came = b""
    while len(came) < count:
        came += plain.recv(count - len(came))
    return came


def _dropped(stack: ExitStack, server: Server, count: int, text: str = "") -> list[str]:
    """Have so many clients keep their sessions, with an answer each, and drop; returns the keys."""
    call = {"op": "Call", "type": "parrot", "id": "2", "jsonMessage": {"text": text}}
    sockets, keys = [], []
    for _ in range(count):
        plain = stack.enter_context(open_socket(server.ports[0]))
        plain.sendall(frame(b'{"op":"Resume","id":"1"}'))
        sockets.append(plain)
        assert _receive(plain)["type"] == "hello"
        keys.append(_receive(plain)["jsonMessage"]["key"])
        if text:
            plain.sendall(frame(json.dumps(call).encode()))
            assert _receive(plain)["jsonMessage"] == {"text": text}
    for plain in sockets:
        plain.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        plain.close()
    return keys


def _waiting(server: Server) -> int:
    found = re.search(r"^uoarm_serve_kept_sessions (\d+)", figures(server), re.MULTILINE)
    assert found is not None
    return int(found.group(1))


LARGE = pytest.mark.long


@pytest.mark.parametrize("most", [12, pytest.param(Limits().kept_sessions, marks=LARGE)])
def test_as_many_sessions_as_may_wait_do_and_no_more(serve: Serve, most: int) -> None:
    server = serve(Limits(kept_sessions=most, resume_seconds=600))
    with ExitStack() as stack:
        keys = _dropped(stack, server, most + 4)
        eventually(lambda: "uoarm_serve_clients 0.0" in figures(server), "all are gone")
        assert _waiting(server) == most
        answers = []
        for key in keys:
            with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as again:
                answers.append(again.answer(again.send("Resume", message={"key": key}))["op"])
        assert sorted(answers) == ["Error"] * 4 + ["Reply"] * most


@pytest.mark.parametrize("count", [26, pytest.param(256, marks=LARGE)])
def test_many_sessions_that_wait_hold_no_more_than_they_may(serve: Serve, count: int) -> None:
    """Of those that hold 40 KB each, as many stay as have room in the memory for some third."""
    room = count * 40_000 * 2 // 5
    server = serve(Limits(kept_bytes=room, resume_seconds=600))
    with ExitStack() as stack:
        _dropped(stack, server, count, "x" * 40_000)
        eventually(lambda: "uoarm_serve_clients 0.0" in figures(server), "all are gone")
        eventually(lambda: server.held_octets <= room, "what is too much was let go")
        assert room // 45_000 <= _waiting(server) <= room // 40_000
