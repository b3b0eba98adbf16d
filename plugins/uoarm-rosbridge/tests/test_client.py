"""The client's bridge, case by case: before a server of ours, and one that answers as written."""

from __future__ import annotations

import json
import re
import socket
import threading
from contextlib import ExitStack, suppress
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trustme
from attrs import evolve
from played import LISTEN, STRING, TALK, Played, asked, bridge_to, stream
from ros import Serve, url
from tests.hostile import misbehaviour  # type: ignore[import-not-found]
from tests.inbox import health_events  # type: ignore[import-not-found]
from tests.redirects import redirecting  # type: ignore[import-not-found]
from tests.server.talk import eventually  # type: ignore[import-not-found]
from uoarm_rosbridge._wire import write_publish_cbor, write_ros
from uoarm_rosbridge.client import _connection, _options
from uoarm_rosbridge.client._connection import json_text
from uoarm_rosbridge.client._options import ClientOptions, Port, mistake
from uoarm_rosbridge.client._types import read_types, reader, structure_of, writer

from uoarm import RobotManager
from uoarm.bridge import HealthEvent, options_table
from uoarm.config import loads
from uoarm.errors import BridgeError, ConfigurationError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, MessageStructure, Role
from uoarm.server import ServerOptions, hash_token, make_token, serve_in_thread
from uoarm.testing import Collector, patience

ACCESS = """
version: 1
roles: {{driver: {{see: ["*"], request: ["*"], send: ["*"]}}}}
tokens: [{{name: robot, role: driver, sha256: {token}}}]
"""


def test_auth_comes_first_and_on_every_connection_anew(
    played: Played, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret, reads = tmp_path / "secret", count()
    secret.write_text("kiwi\n")
    auth = {"secret_file": str(secret), "client": "10.0.0.1", "dest": "robot"}
    read = _options._secret
    monkeypatch.setattr(_options, "_secret", lambda *given: (next(reads), read(*given))[1])
    with bridge_to(played.url, auth=auth) as bridge:
        assert next(reads) == 1, "as it is made, a mistake in them is refused, once"
        bridge.describe(TALK)
        assert played.came[0]["op"] == "auth"
        assert played.came[0]["end"] > played.came[0]["t"]
        assert len(played.came[0]["mac"]) == len("f" * 128)
        played.sockets[0].close()
        eventually(lambda: len(asked(played, "auth")) > 2, "auth on a new connection")
    first, second = asked(played, "auth")[:2]
    assert first["rand"] != second["rand"]
    assert "kiwi" not in json.dumps(played.came)


def test_a_secret_is_read_of_a_file_only() -> None:
    auth = {"secret_file": "/dev/zero", "client": "10.0.0.1", "dest": "robot"}
    with (
        pytest.raises(ConfigurationError, match=r"/dev/zero: .*not a regular file"),
        bridge_to("ws://127.0.0.1:9090", auth=auth),
    ):
        pass


@pytest.mark.parametrize("host", ["robot.example", "localhost.example", "127.example"])
def test_a_secret_goes_nowhere_in_the_clear(tmp_path: Path, host: str) -> None:
    secret = tmp_path / "secret"
    secret.write_text("kiwi")
    with (
        pytest.raises(ConfigurationError, match="in the clear: use wss://"),
        bridge_to(f"ws://{host}:9090", token_file=str(secret)),
    ):
        pass


def test_tls_is_spoken_and_the_token_shown(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for limit in ("_STEP_SECONDS", "_CONNECT_SECONDS"):  # a handshake on a busy machine
        monkeypatch.setattr(_connection, limit, patience())
    authority, token = trustme.CA(), make_token()
    certificate, trusted, secret = (tmp_path / name for name in ("own.pem", "ca.pem", "token"))
    authority.cert_pem.write_to_path(trusted)
    issued = authority.issue_cert("localhost", "127.0.0.1")
    issued.private_key_and_cert_chain_pem.write_to_path(certificate)
    access = tmp_path / "access.yaml"
    access.write_text(ACCESS.format(token=hash_token(token)))
    secret.write_text(token)
    address = url(serve(certificate=certificate, access=access)).replace("ws://", "wss://")
    source = Endpoint("far", "numbers", Role.OUTPUT, ("/uoarm/numbers",))
    with bridge_to(address, tls={"ca": str(trusted)}, token_file=str(secret)) as bridge:
        assert bridge.describe(source).message is not None
    refused = (
        ({"tls": {"ca": str(trusted)}}, "401: this server needs a token"),
        ({"token_file": str(secret)}, "not trusted: .*; give its authority as `ca`"),
    )
    for options, why in refused:
        with bridge_to(address, **options) as bridge, pytest.raises(BridgeError, match=why):
            bridge.describe(source)


def test_files_that_were_renewed_count_from_the_next_connection_on(
    robot: RobotManager, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for limit in ("_STEP_SECONDS", "_CONNECT_SECONDS"):
        monkeypatch.setattr(_connection, limit, patience())
    certificate, trusted, access, secret = (
        tmp_path / name for name in ("own.pem", "ca.pem", "access.yaml", "token")
    )

    def renew() -> None:
        authority, token = trustme.CA(), make_token()
        authority.cert_pem.write_to_path(trusted)
        issued = authority.issue_cert("127.0.0.1")
        issued.private_key_and_cert_chain_pem.write_to_path(certificate)
        access.write_text(ACCESS.format(token=hash_token(token)))
        secret.write_text(token)

    renew()
    options = ServerOptions(port=0, certificate=certificate, access=access)
    source = Endpoint("far", "numbers", Role.OUTPUT, ("/uoarm/numbers",))
    with ExitStack() as bridges:
        with serve_in_thread(robot, options) as server:
            address = url(server).replace("ws://", "wss://")
            shown = {"tls": {"ca": str(trusted)}, "token_file": str(secret)}
            bridge = bridges.enter_context(bridge_to(address, grace=60, **shown))
            events: list[HealthEvent] = []
            bridge.watch(events.append)
            assert bridge.describe(source).message is not None
        eventually(lambda: bool(events), "the break is reported")
        renew()
        with serve_in_thread(robot, evolve(options, port=server.ports[0])):
            eventually(lambda: events[-1].health is Health.OK, "it is connected again")


def test_a_redirection_is_said_with_what_to_do() -> None:
    with redirecting("http://robot.example/ros/") as place:
        why = f"{place}: it redirects: give ws://robot.example/ros/ as the address"
        with bridge_to(place) as bridge, pytest.raises(BridgeError, match=why):
            bridge.describe(TALK)


def test_a_message_of_a_topic_comes_once_to_each_source(played: Played) -> None:
    first, second = Collector(), Collector()
    with bridge_to(played.url) as bridge:
        structure = stream(bridge, TALK)
        sources = [bridge.open_source(TALK, structure, to.deliver) for to in (first, second)]
        assert len(asked(played, "subscribe")) == 1  # the server sends one message to one client
        message = {"op": "publish", "topic": "/chatter", "msg": {"data": "Kia ora"}}
        played.sockets[0].send(json.dumps(message))
        assert first.wait(1) == second.wait(1) == [{"data": "Kia ora"}]
        sources[0].close()
        assert not asked(played, "unsubscribe")
        sources[1].close()
        eventually(lambda: len(asked(played, "unsubscribe")) == 1, "the topic is let go")


def test_what_the_server_refuses_is_said(played: Played) -> None:
    played.refuse("publish", "denied")
    with bridge_to(played.url) as bridge:
        events = health_events(bridge)
        sink = bridge.open_sink(LISTEN, stream(bridge, LISTEN))
        sink.send({"data": "x"})
        eventually(lambda: events, "a refused message is reported")
        assert events[0].health is Health.DEGRADED
        assert events[0].cause == "refused: /chatter: the server says: denied"
        assert sink.facts()["refused_by_server"] == 1


@pytest.mark.parametrize("ends_with", ["another message", "another connection"])
def test_a_refusal_is_over_with_what_came_after_it(played: Played, ends_with: str) -> None:
    played.refuse("publish", "denied", "x")
    with bridge_to(played.url, check=0.05) as bridge:
        structure = stream(bridge, LISTEN)
        events = health_events(bridge)
        sink = bridge.open_sink(LISTEN, structure)
        sink.send({"data": "x"})
        eventually(lambda: events, "a refused message is reported")
        looks = len(asked(played, "call_service"))
        eventually(lambda: len(asked(played, "call_service")) > looks + 2, "it looks")
        assert [event.health for event in events] == [Health.DEGRADED], "it was the last message"
        if ends_with == "another message":
            for _ in range(2):  # the first may be taken for the one that was refused
                sink.send({"data": "y"})
        else:
            played.sockets[-1].close()
        eventually(
            lambda: any(event.health is Health.OK and event.channel is sink for event in events),
            "it is well again",
        )


def test_a_type_is_compared_as_soon_as_it_is_known_again(played: Played) -> None:
    with bridge_to(played.url, check=0.05) as bridge:
        structure = stream(bridge, LISTEN)
        events = health_events(bridge)
        sink = bridge.open_sink(LISTEN, structure)
        details = played.answers.pop("message_details")
        played.sockets[-1].close()
        eventually(lambda: events and events[-1].health is Health.OK, "it is connected again")
        looks = len(asked(played, "call_service"))
        eventually(lambda: len(asked(played, "call_service")) > looks + 2, "it looks")
        assert details == {"typedefs": [STRING]}
        played.answers["message_details"] = {"typedefs": [{**STRING, "fieldtypes": ["uint32"]}]}
        eventually(lambda: events[-1].channel is sink, "it has another type")
        assert events[-1].health is Health.LOST
        assert "it has another type since the break" in events[-1].cause


def test_a_plan_says_what_the_server_does_not(played: Played) -> None:
    text = f"""
version: 1
bridges: {{far: {{plugin: rosbridge, options: {{url: "{played.url}"}}}}}}
functions:
  talk: {{components: [{{name: talker, bridge: far, output: {{endpoint: [/chatter]}}}}]}}
  listen:
    components:
      - {{name: listener, bridge: far, input: {{from: talk, endpoint: [/chatter]}}}}
"""
    with RobotManager(loads(text)) as manager:
        warnings = manager.resolve("listen").warnings
    said = "a rosbridge server does not say"
    assert sorted(warnings) == [
        f"listener.input.default: {said} whether it publishes what it is sent",
        f"talker.output.default: {said} what it loses of a topic",
    ]


def test_an_advertisement_that_is_refused_opens_nothing(played: Played) -> None:
    played.refuse("advertise", "glob")
    with bridge_to(played.url) as bridge:
        structure = stream(bridge, LISTEN)
        with pytest.raises(BridgeError, match="advertised: glob") as caught:
            bridge.open_sink(LISTEN, structure)
        assert caught.value.reason is FailureReason.REFUSED


def test_a_server_without_rosapi_is_named(played: Played) -> None:
    played.answers = {}
    with bridge_to(played.url) as bridge, pytest.raises(BridgeError, match="does rosapi run there"):
        bridge.describe(TALK)


@pytest.mark.parametrize("listed", [["/chatter", "/map"], None])
def test_a_name_that_is_nearly_right_is_proposed(played: Played, listed: object) -> None:
    absent: dict[str, object] = {"type": "", "publishers": [], "subscribers": []}
    names = dict.fromkeys(("topic_type", "service_type", "publishers", "subscribers"), absent)
    lists = (
        {} if listed is None else {"topics": {"topics": listed}, "services": {"services": listed}}
    )
    played.answers = {**played.answers, **names, **lists}
    meant = r"; did you mean '/chatter'\?" if listed else ""
    with bridge_to(played.url) as bridge:
        for role, address, text in (
            (Role.OUTPUT, ("/chater",), "its type is in no address"),
            (Role.OUTPUT, ("/chater", "std_msgs/String"), "no node publishes /chater"),
            (Role.INPUT, ("/chater", "std_msgs/String"), "no node subscribes to /chater"),
            (Role.SERVICE, ("/chater",), "no node serves it"),
        ):
            with pytest.raises(BridgeError, match=f"{text}{meant}$"):
                bridge.describe(Endpoint("far", "talker", role, address))


def test_a_reply_that_does_not_fit_is_refused_with_the_service(played: Played) -> None:
    details = {"typedefs": [STRING]}
    played.answers |= {
        "service_type": {"type": "x_srvs/Say"}, "service_request_details": details,
        "service_response_details": details, "say": {"data": "yes", "more": 1},
    }  # fmt: skip
    say = Endpoint("far", "speaker", Role.SERVICE, ("/say",))
    text = r"at \['/say'\]: the reply: .*: expected an object of data, got dict"
    with bridge_to(played.url) as bridge, pytest.raises(MessageError, match=text):
        bridge.call(say, {"data": "?"})


def test_that_a_server_speaks_another_protocol_is_said() -> None:
    """Such as one with TLS, or a proxy that is no server of WebSockets."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        place = f"ws://127.0.0.1:{listener.getsockname()[1]}"

        def greet() -> None:
            with suppress(OSError):  # it is closed
                while True:
                    peer, _ = listener.accept()
                    with peer, suppress(OSError):
                        peer.recv(1)
                        peer.sendall(b"SSH-2.0-OpenSSH_9\r\n")

        thread = threading.Thread(target=greet)
        thread.start()
        text = f"no connection to {place}: no HTTP/1.1 is spoken there: with TLS it is wss://"
        with bridge_to(place) as bridge, pytest.raises(BridgeError, match=re.escape(text)):
            bridge.describe(TALK)
        listener.shutdown(socket.SHUT_RDWR)
        thread.join()


def test_a_server_that_is_not_there_is_named() -> None:
    with bridge_to("ws://127.0.0.1:1") as bridge:
        with pytest.raises(BridgeError, match=r"no connection to .*:1: Connection refus") as caught:
            bridge.describe(TALK)
        assert caught.value.reason is FailureReason.UNAVAILABLE


HEADER = {
    "type": "std_msgs/Header", "fieldnames": ["seq", "stamp", "frame_id"],
    "fieldtypes": ["uint32", "time", "string"], "fieldarraylen": [-1, -1, -1],
}  # fmt: skip
ONE = {
    "type": "x_msgs/All", "fieldnames": ["header", "pixels", "small", "letter", "gaps", "for"],
    "fieldtypes": ["std_msgs/Header", "uint8", "byte", "char", "duration", "float32"],
    "fieldarraylen": [-1, 0, -1, -1, 2, 0], "constnames": ["MOST"], "constvalues": ["3"],
}  # fmt: skip
ONE_VALUE = {
    "header": {"seq": 1, "stamp": {"secs": 2, "nsecs": 3}, "frame_id": "map"},
    "pixels": b"\0\xff", "small": -1, "letter": 200, "gaps": [{"secs": -1, "nsecs": 0}] * 2,
    "for": [0.5, 1.5],
}  # fmt: skip


def test_types_of_ros_1_are_those_of_ros_1() -> None:
    made = read_types("x_msgs/All", [ONE, HEADER])
    schema: Any = structure_of(made).schema
    small = schema["properties"]["small"]
    assert (small["minimum"], small["maximum"]) == (-128, 127)
    assert schema["properties"]["pixels"]["x-octets"] is True
    assert schema["x-constants"] == {"MOST": 3}
    written = json.loads(json.dumps(writer(made)(ONE_VALUE)))
    assert written["pixels"] == "AP8="
    read = reader(made)(written)
    assert {**read, "for": list(read["for"])} == ONE_VALUE


@pytest.mark.parametrize("name", ["pixels", "small", "gaps", "for"])
def test_what_a_value_does_itself_is_a_refusal(name: str) -> None:
    write = writer(read_types("x_msgs/All", [ONE, HEADER]))
    assert not misbehaviour(lambda value: json_text(write({**ONE_VALUE, name: value})))


def test_what_a_value_of_no_known_type_does_itself_is_a_refusal() -> None:
    assert not misbehaviour(lambda value: json_text({"args": writer(None)(value)}))
    assert writer(None)({"x": np.arange(2)}) == {"x": [0, 1]}


@pytest.mark.parametrize("write", [write_ros, partial(write_publish_cbor, "/x", 1)])
def test_what_a_value_does_itself_is_a_refusal_of_the_server(write: Any) -> None:
    assert not misbehaviour(lambda value: write({"x": [value]}))


def test_what_a_value_of_a_parameter_does_itself_is_a_refusal(played: Played) -> None:
    at = Endpoint("far", "robot", Role.INPUT, ("/speed", "parameter"))
    played.answers["set_param"] = {"successful": True}
    with bridge_to(played.url) as bridge:
        sink = bridge.open_sink(at, MessageStructure(True))
        assert not misbehaviour(sink.send)
        assert not misbehaviour(lambda value: sink.send({"x": [value]}))


def test_what_raises_is_named_with_its_place() -> None:
    class Wrong(list[Any]):
        def __iter__(self) -> Any:
            raise GeneratorExit("of mine")

    with pytest.raises(MessageError, match=r"^\$\.gaps: GeneratorExit: of mine"):
        writer(read_types("x_msgs/All", [ONE, HEADER]))({**ONE_VALUE, "gaps": Wrong([1, 2])})


def test_types_of_ros_2_are_those_of_ros_2() -> None:
    time = {
        "type": "builtin_interfaces/Time", "fieldnames": ["sec", "nanosec"],
        "fieldtypes": ["int32", "uint32"], "fieldarraylen": [-1, -1],
    }  # fmt: skip
    two = {
        "type": "x_msgs/All", "fieldnames": ["stamp", "one", "wide", "yes"],
        "fieldtypes": ["builtin_interfaces/Time", "octet", "double", "boolean"],
        "fieldarraylen": [-1, -1, -1, -1],
    }  # fmt: skip
    made = read_types("x_msgs/msg/All", [two, time])
    schema: Any = structure_of(made).schema
    assert schema["properties"]["stamp"]["x-type"] == "builtin_interfaces/msg/Time"
    value = {"stamp": {"sec": -1, "nanosec": 2}, "one": 255, "wide": 0.5, "yes": True}
    assert reader(made)(writer(made)(value)) == value


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"small": 128}, r"\$\.small: expected -128 to 127"),
        ({"gaps": []}, r"\$\.gaps: expected 2 elements"),
        ({"for": [1e39]}, r"\$\.for\[\]: expected at most"),
        ({"for": [float("nan")]}, r"\$\.for\[\]: expected a finite number"),
        ({"more": 1}, r"\$: there is no member 'more'"),
        ({"header": None}, r"\$\.header: expected an object"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(change: Any, where: str) -> None:
    write = writer(read_types("x_msgs/All", [ONE, HEADER]))
    with pytest.raises(MessageError, match=where):
        write({**ONE_VALUE, **change})


@pytest.mark.parametrize(
    "typedefs",
    [
        None,
        [],
        [{}],
        [{"type": "a/A", "fieldnames": ["x"], "fieldtypes": [], "fieldarraylen": []}],
        [{"type": "a/A", "fieldnames": ["x"], "fieldtypes": ["a/A"], "fieldarraylen": [-1]}],
        [{"type": "a/A", "fieldnames": ["x"], "fieldtypes": ["a/B"], "fieldarraylen": [-1]}],
        [{"type": "a/A", "fieldnames": [1], "fieldtypes": [1], "fieldarraylen": [-1]}],
    ],
)
def test_descriptions_that_are_none_are_refused(typedefs: object) -> None:
    with pytest.raises(BridgeError, match="as nothing that can be used"):
        read_types("a/A", typedefs)


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ((), "expected .name. or .name, type."),
        (("/a b",), "is not a name of ROS"),
        (("/a", "String"), "is not a type of ROS"),
    ],
)
def test_addresses_are_checked_in_words(address: tuple[str, ...], why: str) -> None:
    assert re.search(why, mistake(address, {}))


def test_options_are_checked_in_words() -> None:
    with pytest.raises(ValueError, match="queue: expected at least 1, got 0") as caught:
        Port.of({"queue": 0, "speed": 1})
    assert 'unknown key "speed"' in str(caught.value)


def test_the_table_of_options_is_what_the_plugin_declares() -> None:
    page = Path(__file__).parents[3] / "docs" / "rosbridge.md"
    for kind in (Port, ClientOptions):
        assert options_table(kind.schema()) in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("value", ["\ud800", {"\udfff": 1}, float("nan"), object()])
def test_what_json_cannot_hold_is_refused_before_it_is_sent(value: object) -> None:
    with pytest.raises(MessageError, match="no form as JSON"):
        _connection.json_text({"op": "call_service", "args": value})
