"""The engine without any ROS: headers, frames, XML-RPC, definitions, health; hostile input."""

from __future__ import annotations

import os
import re
import struct
import xmlrpc.client
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.hostile import misbehaviour  # type: ignore[import-not-found]
from uoarm_ros1._definitions import DefinitionError, record_of, service_of
from uoarm_ros1._health import LostComponents, MasterHealth
from uoarm_ros1._options import (
    Names,
    NodeIdentity,
    Ros1BridgeOptions,
    Ros1Options,
    mistake,
    topic_name,
)
from uoarm_ros1._parameters import value_for
from uoarm_ros1._tcpros import (
    ProtocolError,
    ReplyReader,
    TcprosReader,
    decode_header,
    encode_header,
    frames_of,
    publisher_problem,
    subscriber_problem,
)
from uoarm_ros1._types import LENGTH, TypeStore, framed_writer, reader
from uoarm_ros1._xmlrpc import (
    Fault,
    HttpReader,
    NodeApi,
    ParameterUpdate,
    PublisherUpdate,
    Shutdown,
    TransportRefusal,
    decode_call,
    decode_reply,
    encode_call,
    encode_reply,
    http_reply,
    http_request,
)

from uoarm.errors import ConfigurationError, MessageError
from uoarm.model import Budget, Health
from uoarm.testing import instances

MANY = """
# Everything that a message of ROS 1 may hold. \u2028 \x0b \x0c \x1c \x85 end no line of it.
uint8 LIMIT=7
string NAME=a # is no comment
float32 RATIO = 0.5
Header header
bool on
byte signed
char unsigned
int64[] whole
float32[3] three
string[] texts
Inner[] inner
time at
duration[2] lasting
uint8[] SOME_OCTETS
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: test/Inner
bool[] flags
"""
RECORD = record_of("test/Many", MANY)


def written(message: Any) -> bytes:
    return framed_writer(RECORD)(message)[LENGTH.size :]


def test_a_header_is_read_as_it_was_written() -> None:
    fields = {"topic": "/a", "message_definition": "string s=1\n# =\n", "md5sum": "*", "empty": ""}
    octets = encode_header(fields)
    assert struct.unpack_from("<I", octets)[0] == len(octets) - 4
    assert decode_header(octets[4:]) == fields


@pytest.mark.parametrize(
    ("octets", "why"),
    [
        (b"\1\0", "within the length"),
        (b"\xff\xff\xff\xff", "more than it has"),
        (b"\3\0\0\0abc", "without a name"),
        (b"\2\0\0\0=b", "without a name"),
        (bytes(1 << 21), "are allowed"),
        (b"".join(struct.pack("<I", 4) + b"%03d=" % n for n in range(200)), "more than 100 fields"),
    ],
)
def test_a_header_that_is_none_is_refused_in_words(octets: bytes, why: str) -> None:
    with pytest.raises(ProtocolError, match=why):
        decode_header(octets)


@given(
    st.lists(st.binary(max_size=200_000), max_size=5),
    st.lists(st.integers(1, 100_000), min_size=1, max_size=50),
)
def test_frames_come_whole_however_they_are_cut(frames: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(struct.pack("<I", len(frame)) + frame for frame in frames)
    assert received(stream, cuts, in_runs=False) == frames
    runs = received(stream, cuts, in_runs=True)
    assert b"".join(runs) == stream
    assert [bytes(frame[4:]) for run in runs for frame in frames_of(memoryview(run))] == frames


def received(stream: bytes, cuts: list[int], *, in_runs: bool) -> list[bytes]:
    came: list[bytes | bytearray] = []
    reading, at, turn = TcprosReader(1 << 20), 0, 0
    reading.in_runs = in_runs
    while at < len(stream):
        buffer = reading.buffer()
        count = min(len(buffer), cuts[turn % len(cuts)], len(stream) - at)
        assert count > 0
        buffer[:count] = stream[at : at + count]
        came += reading.received(count)
        at, turn = at + count, turn + 1
    assert reading.is_between_frames
    return [bytes(frame) for frame in came]


def test_a_frame_that_is_too_long_is_refused_before_it_comes() -> None:
    reading = TcprosReader(1000)
    reading.buffer()[:4] = struct.pack("<I", 1001)
    with pytest.raises(ProtocolError, match=r"1,000 are allowed \(max_octets\)"):
        reading.received(4)
    with pytest.raises(ProtocolError, match=r"1,000 are allowed \(max_octets\)"):
        ReplyReader(1000).received(b"\1" + struct.pack("<I", 1001))


def test_a_reply_comes_whole_however_it_is_cut() -> None:
    octets = b"\0" + struct.pack("<I", 3) + b"why"
    for cut in range(len(octets)):
        replies = ReplyReader(100)
        first = replies.received(octets[:cut])
        assert first is None
        assert replies.received(octets[cut:]) == (False, b"why")


VALUES: Any = st.recursive(
    st.booleans()
    | st.integers(-(2**31), 2**31 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(min_codepoint=32, exclude_categories=["Cs", "Cn"]), max_size=20)
    | st.binary(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text("abcde<&", max_size=5), inner, max_size=4)
    ),
    max_leaves=12,
)


@pytest.mark.parametrize("value", ["a\r\nb", "\r", {"\r": "\n\t"}])
def test_a_carriage_return_stays_one(value: Any) -> None:
    assert decode_call(encode_call("setParam", ["/text", value]))[1][1] == value
    theirs, _ = xmlrpc.client.loads(encode_call("setParam", ["/text", value]))
    assert theirs == ("/text", value)


@given(st.lists(VALUES, max_size=4))
def test_calls_are_those_of_pythons_own_library(arguments: list[Any]) -> None:
    method, came = decode_call(encode_call("a.method", arguments))
    assert (method, came) == ("a.method", arguments)
    theirs, name = xmlrpc.client.loads(encode_call("a.method", arguments), use_builtin_types=True)
    assert (list(theirs), name) == (arguments, "a.method")
    written = xmlrpc.client.dumps(tuple(arguments), "a.method").encode()
    assert decode_call(written) == ("a.method", arguments)


def test_replies_and_faults_pass() -> None:
    assert decode_reply(encode_reply([1, "ready", ["TCPROS", "host", 4]])) == [
        1,
        "ready",
        ["TCPROS", "host", 4],
    ]
    with pytest.raises(Fault, match="it cannot"):
        decode_reply(encode_reply(Fault("it cannot")))
    fault = xmlrpc.client.dumps(xmlrpc.client.Fault(3, "no such method")).encode()
    with pytest.raises(Fault, match="no such method"):
        decode_reply(fault)
    with pytest.raises(Fault, match="it says not why"):
        decode_reply(xmlrpc.client.dumps(xmlrpc.client.Fault(3, "")).encode())


BOMB = b"""<?xml version="1.0"?><!DOCTYPE b [<!ENTITY a "aaaaaaaaaa"><!ENTITY c "&a;&a;&a;&a;">]>
<methodCall><methodName>&c;</methodName></methodCall>"""


@pytest.mark.parametrize(
    ("octets", "why"),
    [
        (BOMB, "document type"),
        (b'<!DOCTYPE b SYSTEM "file:///etc/passwd"><methodCall/>', "document type"),
        (b"<methodCall><methodName>a</methodName>" + b"<params>" * 1000, "deep"),
        (b"<methodCall>" + b"<a/>" * 10, "has not"),
        (b"<methodCall>", "no XML"),
        (b"\xff\xfe\0", "no XML"),
        (b"", "no XML"),
        (encode_call("a", [list(range(100))]), "more than 20 values"),
        (encode_call("a", ["x" * 10_000]), "octets"),
        (encode_reply(1), "expected a call"),
        (encode_call("a", [1]).replace(b">1<", b">one<"), "for a int"),
    ],
)
def test_xml_that_is_no_call_or_too_much_is_refused(octets: bytes, why: str) -> None:
    elements = 2000 if b"<params>" * 9 in octets else 20
    with pytest.raises(ProtocolError, match=why):
        decode_call(octets, Budget(octets=9000, elements=elements))


def test_what_xml_cannot_say_is_refused_before_it_is_sent() -> None:
    for value in (2**31, float("nan"), "\0", "\ud800", None, object(), {1: 2}):
        with pytest.raises(ValueError, match="XML"):
            encode_call("a", [value])


def test_http_comes_whole_however_it_is_cut() -> None:
    stream = http_request("h", 1, b"<one/>") + http_request("h", 1, b"<two/>")
    for cut in range(len(stream)):
        reading = HttpReader(1000)
        came = [*reading.received(stream[:cut]), *reading.received(stream[cut:])]
        assert [message.body for message in came] == [b"<one/>", b"<two/>"]
    reading = HttpReader(1000)
    (reply,) = reading.received(http_reply(b"<a/>", keeps=True))
    assert reply.is_ok
    assert reply.keeps
    reading = HttpReader(1000)
    assert reading.received(b"HTTP/1.0 200 OK\r\n\r\n<a/>") == []
    last = reading.ended()
    assert last is not None
    assert last.body == b"<a/>"


@pytest.mark.parametrize(
    "octets",
    [
        b"x" * 20_000,
        b"GET nothing\r\n\r\n",
        b"POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n",
        b"POST / HTTP/1.1\r\nContent-Length: 99999999999999999999999\r\n\r\n",
        b"POST / HTTP/1.1\r\nContent-Length: 2000\r\n\r\n",
        b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"HTTP/1.0 200 OK\r\n\r\n" + bytes(2000),
    ],
)
def test_http_that_is_none_or_too_much_is_refused(octets: bytes) -> None:
    with pytest.raises(ProtocolError):
        HttpReader(1000).received(octets)


@given(st.binary(max_size=300))
def test_random_octets_are_read_or_refused_and_nothing_else(octets: bytes) -> None:
    for decode in (decode_header, decode_call, decode_reply, HttpReader(100).received):
        try:
            decode(octets)
        except (ProtocolError, Fault):
            continue
    with suppress(MessageError):
        reader(RECORD, Budget(octets=200, elements=50))(octets)


@given(st.binary(max_size=40), st.integers(0, 10_000))
def test_a_message_with_octets_of_another_is_read_or_refused(noise: bytes, at: int) -> None:
    octets = bytearray(written(example()))
    at %= len(octets)
    octets[at : at + len(noise)] = noise
    try:
        reader(RECORD, Budget(octets=10_000, elements=1000))(bytes(octets))
    except MessageError as error:
        assert "test/Many" in str(error)


def example() -> dict[str, Any]:
    return {
        "header": {"seq": 1, "stamp": {"secs": 2, "nsecs": 3}, "frame_id": "world"},
        "on": True,
        "signed": -1,
        "unsigned": 255,
        "whole": [1, -(2**63)],
        "three": [0.5, 1.0, -2.0],
        "texts": ["Kia ora", ""],
        "inner": [{"flags": [True, False]}, {"flags": []}],
        "at": {"secs": 2**32 - 1, "nsecs": 0},
        "lasting": [{"secs": -1, "nsecs": 5}, {"secs": 0, "nsecs": 0}],
        "SOME_OCTETS": b"\0\xff",
    }


@given(instances(RECORD.schema))
def test_every_message_of_a_structure_comes_back(message: Any) -> None:
    octets = written(message)
    came = reader(RECORD, Budget())(octets)
    assert written(came) == octets


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"on": 1}, "$.on: expected true or false"),
        ({"signed": 128}, "$.signed: expected -128 to 127"),
        ({"unsigned": -1}, "$.unsigned: expected 0 to 255"),
        ({"unsigned": True}, "$.unsigned: expected an integer"),
        ({"whole": [1, 2**63]}, "$.whole[1]: expected"),
        ({"three": [1.0]}, "$.three: expected 3 elements, got 1"),
        ({"three": [1e39, 0.0, 0.0]}, "$.three[0]: expected at most"),
        ({"texts": ["a", 5]}, "$.texts[1]: expected a string"),
        ({"texts": ["\ud800"]}, "$.texts[0]: cannot be written as utf-8"),
        ({"inner": [{"flags": [1]}]}, "$.inner[0].flags[0]: expected true or false"),
        ({"inner": [{}]}, "$.inner[0]: field 'flags' is missing"),
        ({"at": None}, "$.at: expected an object"),
        ({"more": 1}, "$: there is no field 'more'"),
        ({"SOME_OCTETS": [256]}, "$.SOME_OCTETS[0]: expected 0 to 255"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(change: dict[str, Any], where: str) -> None:
    with pytest.raises(MessageError, match=re.escape(where)):
        written({**example(), **change})


def test_lists_of_a_message_have_a_budget_before_they_are_made() -> None:
    record = record_of("test/Lists", "Inner[] inner\n" + "=" * 80 + "\nMSG: test/Inner\n")
    octets = struct.pack("<I", 2**31)  # of nothing, of which there may be any number
    with pytest.raises(MessageError, match="more elements than are allowed"):
        reader(record, Budget(elements=1000))(octets)
    texts = record_of("test/Texts", "string[] texts")
    with pytest.raises(MessageError, match="cut short"):
        reader(texts, Budget())(struct.pack("<I", 1000) + bytes(100))
    with pytest.raises(MessageError, match="are allowed"):
        reader(texts, Budget(octets=10))(bytes(11))


def test_a_definition_is_read_as_genmsg_reads_it() -> None:
    schema = RECORD.schema
    assert schema["x-constants"] == {"LIMIT": 7, "NAME": "a # is no comment", "RATIO": 0.5}
    octets, three = (schema["properties"][name] for name in ("SOME_OCTETS", "three"))
    assert octets["items"]["x-native-type"] == "uint8"  # capitals make no constant
    assert three["items"]["x-native-type"] == "float32"
    assert (octets.get("maxItems"), three["minItems"], three["maxItems"]) == (None, 3, 3)
    again = record_of("test/Many", RECORD.definition)
    assert (again.md5, again.definition) == (RECORD.md5, RECORD.definition)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("int32", "line 1: 'int32' is no field"),
        ("\nint32 a b", "line 2"),
        ("time NOW=5", "line 1"),
        ("Other o", "test/Other, which test/Bad holds, is not defined"),
        ("Bad b", "nested within itself"),
        ("int32 a\nint8 a", "two fields of one name"),
        ("uint8 A=x", "is no uint8"),
        ("uint8[99999999] a", "16,777,216 are allowed"),
        ("int8 a\n" + "=" * 80 + "\nnothing", "expected a line `MSG"),
        ("#" * (1 << 21), "longer than"),
    ],
)
def test_a_definition_that_is_none_is_refused_with_its_line(text: str, why: str) -> None:
    with pytest.raises(DefinitionError, match=re.escape(why)):
        record_of("test/Bad", text)


def test_a_definition_that_grows_is_refused() -> None:
    parts = [f"L{n + 1} a\nL{n + 1} b" for n in range(30)] + ["int8 a"]
    text = parts[0] + "".join(
        f"\n{'=' * 80}\nMSG: test/L{n}\n{part}" for n, part in enumerate(parts[1:], 1)
    )
    with pytest.raises(DefinitionError, match="more than 20,000 fields"):
        record_of("test/L0", text)


@given(st.text(max_size=200))
def test_random_definitions_are_read_or_refused(text: str) -> None:
    with suppress(DefinitionError):
        record_of("test/A", text)
    with suppress(DefinitionError):
        service_of("test/A", text, lambda _: None)


def test_services_have_the_sums_of_ros() -> None:
    sums = {
        "std_srvs/Empty": "d41d8cd98f00b204e9800998ecf8427e",
        "std_srvs/SetBool": "09fb03525b03e7ea1fd3992bafd87e16",
        "std_srvs/Trigger": "937c9679a518e3a18d831e57125ea522",
    }
    store = TypeStore(())
    assert {name: store.require_service(name).md5 for name in sums} == sums


def test_what_cannot_be_read_of_an_installation_costs_its_own_type_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A workspace has links to files that were removed; those of `definitions` are a mistake."""
    for name in ("own_msgs/msg", "own_msgs/msg/Folder.msg"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "own_msgs/msg/Own.msg").write_text("int32 a\n")
    gone = tmp_path / "own_msgs/msg/Gone.msg"
    gone.symlink_to(tmp_path / "nowhere")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    store = TypeStore(())
    assert [store.message(f"own_msgs/{name}") is None for name in ("Own", "Gone")] == [False, True]
    with pytest.raises(ConfigurationError, match=f"definitions: {gone} cannot be read: No such"):
        TypeStore([str(tmp_path)])
    gone.unlink()
    assert TypeStore([str(tmp_path)]).message("own_msgs/Own") is not None
    os.mkfifo(gone)
    with pytest.raises(ConfigurationError, match=r"definitions: .*long is no folder"):
        TypeStore([str(tmp_path / ("long" * 100))])
    with pytest.raises(ConfigurationError, match=f"{gone} cannot be read: no regular file"):
        TypeStore([str(tmp_path)])


def test_names_are_resolved_as_ros_does() -> None:
    names = Names("/robot/me", "/robot", {"/robot/old": "/new"})
    assert [names.resolve(name) for name in ("/a", "a", "~a", "old", "/robot/old")] == [
        "/a",
        "/robot/a",
        "/robot/me/a",
        "/new",
        "/new",
    ]


def test_the_environment_says_what_the_options_leave_out() -> None:
    environment = {
        "ROS_MASTER_URI": "http://robot:4000",
        "ROS_IP": "10.0.0.5",
        "ROS_NAMESPACE": "lab",
    }
    found = NodeIdentity.of("a bridge", Ros1BridgeOptions(), environment)
    assert (found.master, found.host) == ("http://robot:4000/", "10.0.0.5")
    assert re.fullmatch(r"/lab/uoarm_a_bridge_\d+_[0-9a-f]{8}", found.names.node)
    options = Ros1BridgeOptions(master="http://here:1", node="n", host="h")
    stated = NodeIdentity.of("b", options, environment)
    assert (stated.master, stated.host, stated.names.node) == ("http://here:1/", "h", "/lab/n")
    with pytest.raises(ConfigurationError, match="expected a master such as"):
        NodeIdentity.of("b", Ros1BridgeOptions(), {"ROS_MASTER_URI": "robot"})


def test_addresses_and_options_are_checked_in_words() -> None:
    assert mistake(("/a", "std_msgs/Int32"), {}) == ""
    assert mistake(("/a", "parameter"), {}) == ""
    for of_ros_2, meant in (("msg/Int32", "Int32"), ("srv/Set", "Set"), ("action/Do", "DoAction")):
        text = mistake(("/a", f"std_msgs/{of_ros_2}"), {})
        assert "is not a type of ROS 1" in text
        assert text.endswith(f"did you mean 'std_msgs/{meant}'?")
    assert mistake(("/a", "Int32"), {}).endswith("nor `parameter`")
    assert "is not a name" in mistake(("a b",), {})
    with pytest.raises(ValueError, match=r"option \$\.queue"):
        Ros1Options.of({"queue": 0})
    assert topic_name(("a", "std_msgs/Int32"), {}) == "/a"
    assert topic_name(("/a", "x/DoAction"), {}) == ""
    assert topic_name(("/a", "parameter"), {}) == ""


def test_headers_are_judged_by_type_and_sum() -> None:
    header = {"callerid": "/a", "topic": "/t", "type": "x/Y", "md5sum": "1"}
    assert subscriber_problem(header, "/t", "x/Y", "1") == ""
    assert subscriber_problem({**header, "md5sum": "*", "type": "*"}, "/t", "x/Y", "1") == ""
    assert "md5sum 1" in subscriber_problem(header, "/t", "x/Y", "2")
    assert "no field md5sum" in subscriber_problem({"callerid": "/a"}, "/t", "x/Y", "2")
    assert publisher_problem(header, "/t", "x/Y", "") == ""
    assert "as x/Y" in publisher_problem(header, "/t", "x/Z", "")
    assert "md5sum 2" in publisher_problem(header, "/t", "x/Y", "2")
    assert "because" in publisher_problem({"error": "because"}, "/t", "", "")


def test_the_node_answers_and_says_what_it_means() -> None:
    node = NodeApi("/me", "http://master:1/", 7, "here", 4)
    node.publications["/t"] = "x/Y"
    assert node.answer("getPid", ["/a"]) == ([1, "", 7], None)
    tcp = [["UDPROS"], ["TCPROS"]]
    assert node.answer("requestTopic", ["/a", "/t", tcp])[0] == [1, "ready", ["TCPROS", "here", 4]]
    assert node.answer("requestTopic", ["/a", "/other", tcp])[0][0] == -1
    refused, event = node.answer("requestTopic", ["/a", "/t", [["UDPROS"]]])
    assert (refused[0], event) == (0, TransportRefusal("/t"))
    update = node.answer("publisherUpdate", ["/master", "/t", ["http://a:1/"]])[1]
    assert update == PublisherUpdate("/t", ("http://a:1/",))
    assert node.answer("paramUpdate", ["/m", "/p/", 5])[1] == ParameterUpdate("/p/", 5)
    assert node.answer("shutdown", ["/m", "why"])[1] == Shutdown("why")


@given(st.text(max_size=20), st.lists(VALUES, max_size=4))
def test_the_node_survives_any_call(method: str, arguments: list[Any]) -> None:
    node = NodeApi("/me", "http://master:1/", 7, "here", 4)
    known = ("requestTopic", "publisherUpdate", "paramUpdate", "shutdown", "getBusInfo", method)
    for name in known:
        result, _ = node.answer(name, ["/a", *arguments])
        assert isinstance(result, list | Fault)
        node.answer(name, arguments)


def test_a_master_that_no_channel_relied_upon_is_not_missed() -> None:
    health = MasterHealth()
    assert [health.failed("no", is_used=False) for _ in range(2)] == [None, None]
    assert health.answered() == (Health.OK, "the ROS master answers again")
    assert health.failed("gone", is_used=False) == (Health.DEGRADED, "gone")
    assert health.failed("gone", is_used=False) is None


def test_a_master_that_took_a_registration_is_missed_before_the_first_look() -> None:
    for looks in (0, 1):
        health = MasterHealth()
        assert [health.failed("no", is_used=False) for _ in range(looks)] == [None] * looks
        assert health.failed("gone", is_used=True) == (Health.DEGRADED, "gone")
        assert health.failed("gone", is_used=True) is None
        assert health.answered() == (Health.OK, "the ROS master answers again")


def test_what_was_killed_is_back_with_another_address_or_an_answer() -> None:
    lost, key = LostComponents(), ("camera", "publishers", "/image")
    dead = [("/camera", "http://a:1/")]
    lost.remember(key)
    assert [lost.look(key, dead, answers=False) for _ in range(3)] == ["", "", ""]
    assert lost.look(key, [("/camera", "http://a:2/")], answers=False) == "camera"
    assert lost.keys == ()
    lost.remember(key)
    assert lost.look(key, dead, answers=True) == ""  # the first look is what it was lost with
    assert lost.look(key, dead, answers=True) == "camera"
    lost.remember(key, may_answer=False)
    assert [lost.look(key, dead, answers=True) for _ in range(3)] == ["", "", ""]
    lost.forget("camera")
    assert lost.keys == ()


def test_what_a_value_of_a_parameter_does_itself_is_a_refusal() -> None:
    assert not misbehaviour(lambda value: value_for("/x", value))
    assert not misbehaviour(lambda value: value_for("/x", {"x": [value]}))
