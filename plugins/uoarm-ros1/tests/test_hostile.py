"""Hostile nodes, and a master that stalls, lies, answers late, or is started again."""

from __future__ import annotations

import os
import signal
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from endpoints import bridge_to, input_, output, service
from peers import Master, Peer, running
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros1 import _server, _services
from uoarm_ros1._master import call_api
from uoarm_ros1._node import Node
from uoarm_ros1._server import NodeServer, SocketLoop
from uoarm_ros1._subscription import text_of_connection
from uoarm_ros1._tcpros import encode_header
from uoarm_ros1._xmlrpc import decode_call, encode_call, encode_reply, http_reply

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError
from uoarm.model import Health, MessageStructure
from uoarm.testing import Collector, ResourceSnapshot, patience, slowness, wait

INT = "std_msgs/Int32"
ANY = MessageStructure(True)


@contextmanager
def listening(answer: Callable[[socket.socket], object]) -> Iterator[int]:
    """Something that listens on loopback, and answers each connection in a given way."""
    server = socket.create_server(("127.0.0.1", 0))
    threads: list[threading.Thread] = []
    ended = threading.Event()

    def serve(connection: socket.socket) -> None:
        with connection:
            try:
                answer(connection)
            except OSError:
                return

    def run() -> None:
        while not ended.is_set():
            try:
                connection, _ = server.accept()
            except OSError:
                return
            threads.append(threading.Thread(target=serve, args=(connection,)))
            threads[-1].start()

    accepting = threading.Thread(target=run)
    accepting.start()
    try:
        yield server.getsockname()[1]
    finally:
        ended.set()
        server.shutdown(socket.SHUT_RDWR)
        server.close()
        for thread in (accepting, *threads):
            thread.join(patience())


def calls(answers: dict[str, Any]) -> Callable[[socket.socket], None]:
    """Answer calls of XML-RPC: octets as they are, anything else as what is returned."""

    def answer(connection: socket.socket) -> None:
        octets = b""
        while b"</methodCall>" not in octets:
            part = connection.recv(65536)
            if not part:
                return
            octets += part
        method, _ = decode_call(octets.partition(b"\r\n\r\n")[2])
        reply = answers.get(method, [1, "", 0])
        if callable(reply):
            reply = reply()
        if not isinstance(reply, bytes):
            reply = http_reply(encode_reply(reply), keeps=False)
        connection.sendall(reply)

    return answer


def graph(uri: str) -> dict[str, Any]:
    """What a master answers of one node that publishes /t and serves /s."""
    return {
        "getSystemState": [1, "", [[["/t", ["/bad"]]], [], [["/s", ["/bad"]]]]],
        "getTopicTypes": [1, "", [["/t", INT]]],
        "lookupNode": [1, "", uri],
        "registerSubscriber": [1, "", [uri]],
    }


BOMB = (
    b'<?xml version="1.0"?><!DOCTYPE b [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;&a;">]>'
    b"<methodResponse><params><param><value>&b;</value></param></params></methodResponse>"
)
LIES: dict[str, Any] = {
    "no list": 5,
    "no code": ["a", "b", "c"],
    "half of it": [1, "", [[["/t"]], []]],
    "another type": [1, "", [[5], [], []]],
    "a refusal": [-1, "go away", 0],
    "a bomb": http_reply(BOMB, keeps=False),
    "no XML": http_reply(b"hello", keeps=False),
    "no HTTP": b"hello\r\n\r\n",
    "an error": http_reply(b"", keeps=False, status="500 Oops"),
    "nothing": b"",
    "endless": b"HTTP/1.0 200 OK\r\n\r\n" + b" " * (9 << 20),
    "a lie of length": b"HTTP/1.0 200 OK\r\nContent-Length: 99999999999\r\n\r\n",
}


@pytest.mark.parametrize("lie", LIES)
def test_a_master_that_lies_is_an_error_that_names_it(master: Master, lie: str) -> None:
    with listening(calls({"getSystemState": LIES[lie]})) as port:
        uri = f"http://127.0.0.1:{port}"
        with (
            bridge_to(master, master=uri) as bridge,
            pytest.raises(BridgeError, match=str(port)),
        ):
            bridge.describe(output("/t"))


@pytest.mark.usefixtures("short")
def test_a_master_that_answers_drop_by_drop_is_given_up(master: Master) -> None:
    """A limit on each receiving would never be met: the deadline is one for the whole call."""

    def drip(connection: socket.socket) -> None:
        connection.recv(65536)
        pause = threading.Event()
        for octet in b"HTTP/1.0 200 OK\r\n" + b"X-Header: a\r\n" * 1000:
            connection.sendall(bytes((octet,)))
            pause.wait(0.01)

    with listening(drip) as port:
        uri = f"http://127.0.0.1:{port}"
        with (
            bridge_to(master, master=uri) as bridge,
            pytest.raises(BridgeError, match="no answer in time"),
        ):
            bridge.describe(output("/t"))


def headers(*octets: bytes) -> Callable[[socket.socket], None]:
    def answer(connection: socket.socket) -> None:
        connection.recv(65536)
        for part in octets:
            connection.sendall(part)
        connection.shutdown(socket.SHUT_WR)
        connection.recv(65536)

    return answer


def typed(**more: str) -> bytes:
    fields = {"type": INT, "md5sum": "da5909fbe378aeaf85e547e830cc1bb7", "callerid": "/bad"}
    return encode_header({**fields, **more})


PUBLISHERS: dict[str, tuple[bytes, str]] = {
    "a header that never ends": (struct.pack("<I", 100), "unanswered"),
    "a header of gigabytes": (struct.pack("<I", 2**32 - 1), "are allowed"),
    "a header of noise": (struct.pack("<I", 8) + b"\xff" * 8, "more than it has"),
    "no header": (b"", "unanswered"),
    "no type": (encode_header({"callerid": "/bad"}), "no field md5sum"),
    "a refusal": (encode_header({"error": "not you"}), "not you"),
    "another type": (typed(type="std_msgs/String"), "std_msgs/String"),
    "a definition of another sum": (
        typed(message_definition="int8 data", md5sum="1" * 32),
        "md5sum 1111",
    ),
    "a definition without an end": (
        typed(message_definition="Other o", md5sum="1" * 32),
        "cannot be read",
    ),
}


@pytest.mark.parametrize("what", PUBLISHERS)
def test_a_publisher_that_lies_is_an_error_that_names_it(master: Master, what: str) -> None:
    octets, words = PUBLISHERS[what]
    with listening(headers(octets)) as port:
        api = {"requestTopic": [1, "", ["TCPROS", "127.0.0.1", port]]}
        with listening(calls(api)) as api_port:
            answers = graph(f"http://127.0.0.1:{api_port}/")
            with listening(calls(answers)) as master_port:
                uri = f"http://127.0.0.1:{master_port}"
                with bridge_to(master, master=uri) as bridge:
                    with pytest.raises(BridgeError, match=words) as caught:
                        bridge.describe(output("/t", INT))
                    assert "/bad" in str(caught.value)
                    assert len(str(caught.value)) < 3000


@pytest.mark.parametrize("definition", ["", "int8 data", "Other o", "\0"])
def test_a_definition_that_is_wrong_is_not_needed_where_the_sum_is_known(
    master: Master, definition: str
) -> None:
    """Nodes of other makes send no definition, or none that fits: the sum says which it is."""
    with listening(headers(typed(message_definition=definition))) as port:
        api = {"requestTopic": [1, "", ["TCPROS", "127.0.0.1", port]]}
        with listening(calls(api)) as api_port:
            answers = graph(f"http://127.0.0.1:{api_port}/")
            with (
                listening(calls(answers)) as master_port,
                bridge_to(master, master=f"http://127.0.0.1:{master_port}") as bridge,
            ):
                message: Any = bridge.describe(output("/t")).message
                assert message.schema["properties"]["data"]["x-native-type"] == "int32"


@pytest.mark.parametrize(
    "protocol", [[], ["TCPROS"], ["TCPROS", "h", 99999], ["TCPROS", 5, "h"], 7, ["UDPROS"]]
)
def test_a_node_that_offers_nonsense_is_refused(master: Master, protocol: Any) -> None:
    with listening(calls({"requestTopic": [1, "", protocol]})) as api_port:
        answers = graph(f"http://127.0.0.1:{api_port}/")
        with (
            listening(calls(answers)) as port,
            bridge_to(master, master=f"http://127.0.0.1:{port}") as bridge,
            pytest.raises(BridgeError, match="offers no TCPROS"),
        ):
            bridge.describe(output("/t", INT))


SERVERS: dict[str, tuple[bytes, str]] = {
    "no answer": (b"", "closed the connection"),
    "a header of gigabytes": (struct.pack("<I", 2**32 - 1), "4,294,967,295"),
    "a reply of gigabytes": (
        encode_header({"md5sum": "*"}) + b"\1" + struct.pack("<I", 2**32 - 1),
        "are allowed",
    ),
    "half a reply": (encode_header({"md5sum": "*"}) + b"\1\4\0\0\0ab", "closed the connection"),
    "two replies": (encode_header({"md5sum": "*"}) + 2 * b"\0\0\0\0\0", "a second reply"),
    "a refusal": (encode_header({"error": "not you"}), "not you"),
}


@pytest.mark.parametrize("what", SERVERS)
def test_a_server_that_lies_is_an_error(master: Master, what: str) -> None:
    octets, words = SERVERS[what]

    def answer(connection: socket.socket) -> None:
        if b"probe" in connection.recv(65536):
            connection.sendall(encode_header({"md5sum": "*", "type": "std_srvs/Empty"}))
            return
        connection.sendall(octets)
        connection.shutdown(socket.SHUT_WR)
        connection.recv(65536)

    with listening(answer) as port:
        answers = {"lookupService": [1, "", f"rosrpc://127.0.0.1:{port}"]}
        with (
            listening(calls(answers)) as master_port,
            bridge_to(master, master=f"http://127.0.0.1:{master_port}") as bridge,
            pytest.raises(BridgeError, match=words),
        ):
            bridge.call(service("/s", "std_srvs/Empty"), {})


NOISE = [
    b"",
    b"GET / HTTP/1.1\r\n\r\n",
    b"\xff" * 1000,
    struct.pack("<I", 2**31),
    encode_header({"topic": "/none"}),
    encode_header({"topic": "/t", "callerid": "/x", "type": "a/B", "md5sum": "1"}),
    encode_header({"service": "/none", "callerid": "/x", "md5sum": "*"}),
    encode_header({"topic": "/t"}) + b"more",
    b"POST / HTTP/1.1\r\nContent-Length: 5\r\n\r\nhello",
    b"POST / HTTP/1.1\r\nContent-Length: 999999999\r\n\r\n",
    b"POST / HTTP/1.1\r\n" + b"a" * 70_000,
    http_reply(BOMB, keeps=False).replace(b"HTTP/1.1 200 OK", b"POST / HTTP/1.1"),
]


def test_strangers_at_our_doors_disturb_no_channel(master: Master, lasting: Peer) -> None:
    lasting.do("subscribe", topic="/t", type=INT)
    with bridge_to(master) as bridge:
        sink = bridge.open_sink(input_("/t", INT, wait=patience()), ANY)
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        api = int(node.uri.rstrip("/").rpartition(":")[2])
        held = []
        for port in (api, node._api.port):
            for noise in NOISE:
                connection = socket.create_connection((node._api.host, port))
                with suppress(OSError):
                    connection.sendall(noise)
                held.append(connection)
        sink.send({"data": 1})
        lasting.wait_for("count", lambda count: count == 1, topic="/t")
        for connection in held:
            connection.close()


def test_strangers_who_hold_their_connections_keep_no_peer_out(
    master: Master, lasting: Peer
) -> None:
    """Those that have been silent longest make room: more than there is room for may come."""
    lasting.do("advertise", topic="/crowd/to", type=INT)
    with bridge_to(master) as bridge:
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        collector = Collector()
        bridge.open_source(output("/crowd/to"), ANY, collector.deliver)
        api = int(node.uri.rstrip("/").rpartition(":")[2])
        held = [socket.create_connection((node._api.host, api)) for _ in range(300)]
        held += [socket.create_connection((node._api.host, node._api.port)) for _ in range(300)]
        sink = bridge.open_sink(input_("/crowd", INT, peer="optional"), ANY)
        lasting.do("subscribe", topic="/crowd", type=INT)
        wait(lambda: sink.facts()["subscribers"], "no subscriber is let in")
        sink.send({"data": 1})
        lasting.wait_for("count", lambda count: count == 1, topic="/crowd")
        held[0].settimeout(patience())
        assert held[0].recv(1) == b""
        for connection in held:
            connection.close()


def test_calls_that_do_not_end_share_one_room(
    master: Master, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each may be large, as the description of a robot is; all together may not fill the memory."""
    monkeypatch.setattr(_server, "_ARRIVAL_SECONDS", 10 * patience())  # time alone ends none
    with bridge_to(master) as bridge:
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        api = int(node.uri.rstrip("/").rpartition(":")[2])
        head = b"POST / HTTP/1.1\r\nContent-Length: 8000000\r\n\r\n"
        held = [socket.create_connection((node._api.host, api)) for _ in range(8)]
        for connection in held:
            connection.settimeout(patience())
            with suppress(ConnectionError):
                for part in (head, *[bytes(1_000_000)] * 7):
                    connection.sendall(part)
        assert call_api(node.uri, "getPid", "/t", seconds=patience()) == os.getpid()
        wait(lambda: sum(map(is_ended, held)) >= len(held) // 2, "none goes")
        for connection in held:
            connection.close()


def test_calls_that_come_in_one_piece_are_answered_within_what_may_wait() -> None:
    """Each answer lists all topics: a few octets of many calls must not become a thousandfold."""
    loop = SocketLoop("test")
    answered = []

    def answer(method: str, _: object) -> object:
        answered.append(method)
        return [1, "", "x" * 2**20]

    server = NodeServer(loop, "127.0.0.1", answer, lambda connection, _: connection.close())
    body = encode_call("getPublications", ["/x"])
    call = b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n%b" % (len(body), body)
    with socket.create_connection(("127.0.0.1", server.api_port)) as connection:
        connection.sendall(call * 200)  # and no answer is read
        wait(lambda: answered and not server._unidentified._held, "it is kept")
    loop.close()
    assert len(answered) < 100


def test_a_call_of_many_values_holds_up_no_channel(master: Master) -> None:
    with bridge_to(master) as bridge:
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        with pytest.raises(BridgeError, match="XML of more than 20,000 values"):
            call_api(node.uri, "paramUpdate", "/t", "/x", [0] * 50_000, seconds=patience())
        description = "<robot/>" * 200_000
        call_api(node.uri, "paramUpdate", "/t", "/x", description, seconds=patience())


def test_requests_that_do_not_end_share_one_room(
    master: Master, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_services, "_REQUEST_SECONDS", 10 * patience())  # time alone ends none
    with bridge_to(master, max_octets=1_000_000) as bridge:
        served = bridge.serve(
            service("/served/part", "std_srvs/SetBool"), lambda _: {"success": True, "message": ""}
        )
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        header = {"callerid": "/x", "md5sum": "*", "service": "/served/part", "persistent": "1"}
        held = []
        for _ in range(12):
            connection = socket.create_connection((node._api.host, node._api.port))
            connection.settimeout(patience())
            connection.sendall(encode_header(header))
            (length,) = struct.unpack("<I", connection.recv(4))
            assert connection.recv(length)
            held.append(connection)
        for connection in held:
            with suppress(ConnectionError):
                connection.sendall(struct.pack("<I", 900_000) + bytes(500_000))
        wait(lambda: served.facts()["clients"] == 4, "all are kept")
        for connection in held:
            connection.close()


def test_a_listing_of_brackets_costs_no_more_than_it_is_long() -> None:
    """The interpreter's lock is held while it is looked through: for hours, if with its square."""
    ours = text_of_connection("10.0.0.7", 4000)
    assert ours.search("to [" * 500_000) is None
    assert ours.search("TCPROS connection on port 1 to [10.0.0.7:4000 on socket 9]")
    assert ours.search("TCPROS connection on port 1 to [robot.local:4000 on socket 9]")
    assert ours.search("TCPROS connection on port 1 to [10.0.0.7:40001 on socket 9]") is None


def is_ended(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


def test_a_client_that_asks_nothing_is_let_go(
    master: Master, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_services, "_REQUEST_SECONDS", 0.1)
    with bridge_to(master) as bridge:
        served = bridge.serve(
            service("/served/idle", "std_srvs/SetBool"), lambda _: {"success": True, "message": ""}
        )
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        header = {"callerid": "/x", "md5sum": "*", "service": "/served/idle"}
        with socket.create_connection((node._api.host, node._api.port)) as connection:
            connection.settimeout(patience())
            connection.sendall(encode_header(header))
            while connection.recv(4096):
                pass
        wait(lambda: served.facts()["clients"] == 0, "it is kept")


def test_a_thousand_publishers_that_come_and_are_killed_leave_nothing_behind(
    master: Master,
) -> None:
    def publish(connection: socket.socket) -> None:
        connection.recv(65536)
        connection.sendall(typed() + struct.pack("<Ii", 4, 7))
        # Ended by a reset, as by a machine that is started again.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")

    with listening(publish) as port:
        api = {
            "requestTopic": [1, "", ["TCPROS", "127.0.0.1", port]],
            "getBusInfo": [1, "", [[1, "/x", "o", "TCPROS", "/mortals", True]]],
        }
        with listening(calls(api)) as api_port, bridge_to(master, rosout=False) as bridge:
            collector = Collector()
            at = output("/mortals", INT, peer="optional")
            bridge.open_source(at, ANY, collector.deliver)
            node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge

            def come_and_go(number: int) -> None:
                uris = [f"http://127.0.0.1:{api_port}/{number}"]
                for named in (uris, []):
                    call_api(
                        node.uri, "publisherUpdate", "/m", "/mortals", named, seconds=patience()
                    )
                    if named:
                        collector.wait(number + 1)

            come_and_go(0)
            snapshot = ResourceSnapshot()
            for number in range(1, 1001):
                come_and_go(number)
            snapshot.check(patience())


def test_more_publishers_than_there_is_room_for_are_left_out(master: Master) -> None:
    """A peer that calls `publisherUpdate` again and again has no thread made for each address."""
    with bridge_to(master) as bridge:
        at = output("/flooded", INT, peer="optional")
        bridge.open_source(at, ANY, Collector().deliver)
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        before = threading.active_count()
        for turn in range(10):
            uris = [f"http://127.0.0.1:1/{turn}/{number}" for number in range(200)]
            call_api(node.uri, "publisherUpdate", "/m", "/flooded", uris, seconds=patience())
        assert threading.active_count() - before <= 600


def test_a_master_that_is_started_again_is_registered_with_again(tmp_path: Path) -> None:
    with running(tmp_path / "master") as world, bridge_to(world) as bridge:
        reports = Inbox(bridge)
        collector = Collector()
        pair = ("/pair", INT)
        bridge.open_source(output(*pair, peer="optional"), ANY, collector.deliver)
        sink = bridge.open_sink(input_(*pair, peer="optional"), ANY)
        bridge.serve(
            service("/served", "std_srvs/SetBool"), lambda _: {"success": True, "message": ""}
        )
        reports_ok(bridge, reports)
        world.kill()
        reports.event(Health.DEGRADED, world.host)
        sink.send({"data": 1})  # what is connected needs no master
        assert collector.wait(1) == [{"data": 1}]
        world.start()
        reports.event(Health.OK, "answers again")
        peer = world.peer("after")
        peer.do("subscribe", topic="/pair", type=INT)
        peer.do("advertise", topic="/pair", type=INT)
        peer.wait_for("connections", lambda count: count == 2, topic="/pair")  # itself, too
        wait(lambda: "/after" in sink.facts()["subscribers"])  # type: ignore[operator]  # a list
        sink.send({"data": 2})
        peer.wait_for("came", lambda came: {"data": 2} in came, topic="/pair")
        peer.do("publish", topic="/pair", type=INT, values={"data": 3})
        assert {"data": 3} in collector.wait(3)
        called = peer.do("call", service="/served", type="std_srvs/SetBool", values={"data": True})
        assert called["success"]


def reports_ok(bridge: Bridge, reports: Inbox) -> None:
    """The master has answered once, so that its death is one."""
    known: Any = bridge
    wait(lambda: known._master_health.is_up, "the master was not asked")
    assert not [event for event in reports.messages if event.health is Health.LOST]


@pytest.mark.usefixtures("short")
def test_a_master_that_stalls_holds_up_no_message_and_no_close(tmp_path: Path) -> None:
    with running(tmp_path / "master") as world:
        with bridge_to(world) as bridge:
            reports = Inbox(bridge)
            collector = Collector()
            at = ("/pair", INT)
            bridge.open_source(output(*at, peer="optional"), ANY, collector.deliver)
            sink = bridge.open_sink(input_(*at, peer="optional"), ANY)
            reports_ok(bridge, reports)
            world.send_signal(signal.SIGSTOP)
            reports.event(Health.DEGRADED, "no answer in time")
            sink.send({"data": 1})
            assert collector.wait(1) == [{"data": 1}]
            world.send_signal(signal.SIGCONT)
            reports.event(Health.OK, "answers again")
            world.send_signal(signal.SIGSTOP)
            with pytest.raises(BridgeError, match="no answer in time"):
                bridge.describe(output("/t"))
            bridge.close(timeout=10 * slowness())
        world.send_signal(signal.SIGCONT)
