"""Clients that misbehave cost bounded memory and time, and hurt no other."""

from __future__ import annotations

import os
import socket
import struct
import threading
from contextlib import ExitStack, suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.server.conftest import Connect, Hurry, Serve
from tests.server.hostile import resident
from tests.server.robot import script
from tests.server.serving import url
from tests.server.talk import BESIDE, Talk, eventually, frame, open_socket
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Frame, Opcode

from uoarm import RobotManager
from uoarm._wire import ASKED
from uoarm.server import Limits, Server, _server
from uoarm.testing import patience, slowness


def test_a_client_that_never_reads_costs_bounded_memory_and_starves_no_other(serve: Serve) -> None:
    for_ever = 100 * patience()
    server = serve(Limits(queue_bytes=8_000_000, stall_seconds=for_ever, ping_seconds=for_ever))
    picture = {"width": 1, "data": os.urandom(200_000)}
    with Talk(url(server), binary=True) as healthy, open_socket(server.ports[0]) as stuck:
        connection = healthy.open("picture")
        stuck.sendall(frame(b'{"op":"Request","type":"picture","id":"1"}'))
        eventually(lambda: len(healthy.ask("Status")["own"]) == 1, "open")
        script.put(*[picture] * 20)
        healthy.data(connection, 20)
        before = resident()
        for _ in range(20):  # 80 MB in all
            script.put(*[picture] * 20)
            healthy.data(connection, 20)
        # What is under way besides may be let go late.
        eventually(lambda: resident() - before < 30_000_000, "it costs little")
        assert healthy.ask("Status")["own"][0]["dropped"] == 0


def test_a_client_that_never_reads_is_cut_off_in_time(serve: Serve, robot: RobotManager) -> None:
    server = serve(Limits(queue_bytes=100_000, stall_seconds=0.5, ping_seconds=patience()))
    with open_socket(server.ports[0]) as stuck:
        stuck.sendall(frame(b'{"op":"Request","type":"picture","id":"1"}'))
        eventually(lambda: len(robot.status().connections) == 1, "open")

        def freed() -> bool:
            script.put({"width": 1, "data": bytes(200_000)})
            return not robot.status().connections

        eventually(freed, "freed")


def test_a_client_that_answers_no_ping_gets_replies_only_until_it_does(serve: Serve) -> None:
    """So what is to be new does not wait where it cannot be dropped."""
    for_ever = 100 * patience()
    server = serve(Limits(stall_seconds=for_ever, ping_seconds=for_ever))
    picture = {"width": 1, "data": bytes(100_000)}
    with Talk(url(server), binary=True) as client:
        connection = client.open("picture", queue={"length": 1, "policy": "latest"})
        script.put(picture)
        client.next(connection)
        send_frame, pongs = client.socket.protocol.send_frame, list[Frame]()
        client.socket.protocol.send_frame = (  # type: ignore[method-assign]
            lambda frame: (pongs.append if frame.opcode is Opcode.PONG else send_frame)(frame)
        )

        def dropped() -> int:
            script.put(picture)
            count: int = client.ask("Status")["own"][0]["dropped"]
            return count

        eventually(lambda: dropped() > 3, "nothing goes to it")
        before = client.ask("Status")["own"][0]["sent"]
        with client.socket.protocol_mutex:
            client.socket.protocol.send_frame = send_frame  # type: ignore[method-assign]
        for pong in pongs:
            client.socket.pong(pong.data)

        def sent() -> int:
            script.put(picture)  # the one that waited may have gone before it was counted
            count: int = client.ask("Status")["own"][0]["sent"]
            return count

        eventually(lambda: sent() > before, "it goes on")


def test_a_client_that_leaves_its_replies_is_cut_off(serve: Serve) -> None:
    server = serve(Limits(control_messages=16, queue_bytes=100_000))
    with open_socket(server.ports[0]) as stuck, suppress(OSError):
        while True:  # until the server cuts it off; the limit is the socket's
            stuck.sendall(frame(b'{"op":"List","id":"1"}'))


@pytest.mark.parametrize("how", ["reset", "vanish"])
def test_a_client_that_dies_frees_what_only_it_used(
    serve: Serve, hurry: Hurry, robot: RobotManager, how: str
) -> None:
    server = serve()
    with Talk(url(server)) as other:
        shared = other.open("numbers")
        with hurry(slowness() if how == "vanish" else patience()):
            dying = _opened(server)
        with dying:
            if how == "reset":
                dying.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                dying.close()
            eventually(lambda: len(robot.status().connections) == 1, "its own is closed")
        script.put({"value": 1})
        assert other.data(shared, 1) == [{"value": 1}]


def _opened(server: Server) -> socket.socket:
    """Return a client that is in a call, has two functions open, and does nothing more.

    Where it was given up before it had them, on a machine that is starved, it is another one.
    """
    while True:
        plain = open_socket(server.ports[0])
        plain.sendall(frame(b'{"op":"Request","type":"numbers","id":"1"}'))
        plain.sendall(frame(b'{"op":"Request","type":"picture","id":"2"}'))
        plain.sendall(frame(b'{"op":"Call","type":"slow","jsonMessage":{"value":1},"id":"3"}'))
        received = b""
        with suppress(ConnectionError):
            while part := plain.recv(65536):
                received += part
                if received.count(b'"op":"Reply"') == 2:
                    return plain
        plain.close()


def test_a_client_that_goes_while_its_function_opens_leaves_nothing(
    server: Server, robot: RobotManager
) -> None:
    for _ in range(20):
        with open_socket(server.ports[0]) as plain:
            plain.sendall(frame(b'{"op":"Request","type":"doubled","id":"1"}'))
    eventually(lambda: not robot.status().connections, "nothing is open")
    eventually(lambda: not robot.status().components, "no component is open")


def test_one_client_cannot_touch_what_another_holds(talk: Connect) -> None:
    owner, stranger = talk(), talk()
    connection = owner.open("echo")
    assert stranger.refused("Kill", connection)["code"] == "unknown"
    assert stranger.refused("Data", connection, {"value": 1})["code"] == "unknown"
    assert stranger.ask("Status")["own"] == []
    owner.ask("Data", connection, {"value": 7})
    assert owner.data(connection, 1) == [{"value": 7}]


def test_killing_for_everyone_notifies_everyone(talk: Connect) -> None:
    owner, operator = talk(), talk()
    connection = owner.open("numbers")
    operator.ask("Kill", connection, {"everyone": True})
    received = owner.next("connection")["jsonMessage"]
    assert (received["connection"], received["state"]) == (connection, "closed")
    who = f"killed by session {operator.hello['session']} (local)"
    assert received["cause"] == who
    past = owner.ask("Status", "watch")["past"]
    assert [event["cause"] for event in past if event["change"] == "closed"] == [who]
    assert operator.refused("Kill", connection, {"everyone": True})["code"] == "unknown"


def test_who_gave_a_connection_back_is_said(talk: Connect, robot: RobotManager) -> None:
    watcher, killing, leaving = talk(), talk(), talk()
    watcher.ask("Status", "watch")

    def end_of(connection: str) -> str:
        while (received := watcher.next("change")["jsonMessage"])["change"] != "closed":
            pass
        assert received["subject"] == f"connection {connection}"
        cause: str = received["cause"]
        return cause

    connection = killing.open("numbers")
    killing.ask("Kill", connection)
    last = f"session {killing.hello['session']} (local)"
    assert end_of(connection) == f"killed by {last}, who used it last"
    connection = leaving.open("numbers")
    leaving.close()
    last = f"session {leaving.hello['session']} (local)"
    assert end_of(connection) == f"{last} has gone, who used it last"
    own = robot.request("numbers")
    own.kill()
    assert (end_of(own.id), own.cause) == ("", "")


def test_what_the_application_itself_opened_can_be_killed_too(
    talk: Connect, robot: RobotManager
) -> None:
    operator = talk()
    with robot.request("numbers") as own:
        operator.ask("Kill", own.id, {"everyone": True})
        assert own.ended
        assert list(own) == []
        assert own.cause.startswith("killed by session ")
    received = operator.refused("Kill", own.id, {"everyone": True})
    assert received["code"] == "unknown"


def test_a_message_that_is_too_long_ends_the_connection_plainly(serve: Serve) -> None:
    server = serve(Limits(message_bytes=2000))
    with Talk(url(server)) as client:
        client.raw("x" * 3000)
        with pytest.raises(ConnectionClosed) as closed:
            client.answer(None)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009


def test_a_handshake_that_takes_too_long_is_given_up(serve: Serve) -> None:
    server = serve(Limits(handshake_seconds=0.2))
    with socket.create_connection(("127.0.0.1", server.ports[0]), timeout=patience()) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert slow.recv(100) == b""


def test_clients_are_limited_in_number(serve: Serve) -> None:
    server = serve(Limits(connections=2))
    with Talk(url(server)), Talk(url(server)):
        with pytest.raises(InvalidStatus) as refused:
            Talk(url(server))
        assert refused.value.response.status_code == 503
    eventually(lambda: _connects(server), "a place is free again")


def test_clients_of_one_address_are_limited(serve: Serve) -> None:
    server = serve(Limits(connections_per_address=1))
    with Talk(url(server)), pytest.raises(InvalidStatus) as refused:
        Talk(url(server))
    assert refused.value.response.status_code == 429


def test_a_client_that_sends_too_fast_is_read_more_slowly_and_loses_nothing(serve: Serve) -> None:
    server = serve(Limits(messages_per_second=200))
    with Talk(url(server)) as client:
        sent = [client.send("Kill", "c9") for _ in range(300)]
        assert all(client.answer(question)["op"] == "Error" for question in sent)


def test_many_clients_come_and_go_and_leave_no_threads(server: Server, robot: RobotManager) -> None:
    def visit() -> None:
        with Talk(url(server)) as client:
            client.open("numbers")
            client.ask("Call", "add", {"a": 1, "b": 1})

    visit()
    before = threading.active_count()
    visitors = [threading.Thread(target=visit) for _ in range(12)]
    for visitor in visitors:
        visitor.start()
    for visitor in visitors:
        visitor.join(patience())
    eventually(lambda: not robot.status().connections, "all is closed")
    assert threading.active_count() <= before + Limits().workers


garbage = st.one_of(
    st.binary(max_size=60),
    st.builds(
        lambda opcode, data, first: bytes([first | opcode]) + frame(data)[1:],
        st.integers(0, 15),
        st.binary(max_size=60),
        st.sampled_from([0x00, 0x80, 0x70, 0xF0]),
    ),
    st.builds(frame, st.binary(max_size=60)),
    st.builds(frame, st.text(max_size=60).map(lambda text: text.encode())),
)


@BESIDE
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(frames=st.lists(garbage, min_size=1, max_size=5))
def test_no_frames_at_all_harm_the_server(server: Server, frames: list[bytes]) -> None:
    with open_socket(server.ports[0]) as plain, suppress(ConnectionError):
        plain.sendall(b"".join(frames))
    assert _connects(server)


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=6,
)
wild = st.fixed_dictionaries(
    {"id": st.just("9")},
    optional={
        "op": st.sampled_from(ASKED) | values,
        "type": st.sampled_from(["numbers", "echo", "add", "numbers.x", "c1", ".", ""]) | values,
        "jsonMessage": values
        | st.fixed_dictionaries({"key": values}, optional={"waiting": values}),
        "x-timeout": values,
    },
)


@BESIDE
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100)
@given(message=wild, binary=st.booleans())
def test_every_wild_message_has_one_answer(server: Server, message: object, binary: bool) -> None:
    import json

    from uoarm._wire import write_binary

    with Talk(url(server), binary=binary) as client:
        client.raw(write_binary(message) if binary else json.dumps(message))
        try:
            received = client.answer("9")
        except KeyError:
            pytest.fail("no answer")
        assert received["op"] in {"Reply", "Error"}
        assert received.get("jsonMessage", {}) is None or "internal" not in str(received)
        assert client.ask("List")


def _connects(server: Server) -> bool:
    try:
        with Talk(url(server)) as client:
            return bool(client.ask("List"))
    except InvalidStatus:
        return False


def test_what_a_crowd_took_goes_back_to_the_system_once_it_has_gone(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    returned = threading.Event()
    monkeypatch.setattr(_server, "give_memory_back", returned.set)
    server = serve()
    with Talk(url(server)) as stays:
        with ExitStack() as crowd:
            for _ in range(_server._CROWD):
                crowd.enter_context(Talk(url(server)))
            eventually(lambda: server._crowd > _server._CROWD, "they are seen")
            assert not returned.is_set()
        assert returned.wait(patience())
        assert stays.ask("List")
