"""Every decoder of octets or text that come from elsewhere, with inputs to begin from.

A decoder may refuse its input with the errors of its contract; whatever else it raises is a
finding, and so is a message that its budget did not allow, or an error of more than 2,000
characters.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgpack
import orjson
from attrs import frozen
from websockets.datastructures import Headers
from websockets.exceptions import InvalidHeader
from websockets.http11 import Request

from uoarm._dataplane import make_check
from uoarm._host.transport.codec import pack, unpack
from uoarm._wire import BINARY_FORM, TEXT_FORM, Form, check_asked, write_binary
from uoarm.config import loads
from uoarm.errors import BridgeError, ConfigurationError, ControlMessageError, MessageError
from uoarm.model import (
    Budget,
    BudgetUse,
    MessageStructure,
    StatusMap,
    ValidationMode,
    from_json,
    message_octets,
    read_control,
    scan_json,
)
from uoarm.server.access._admission import RefusedError, read_head

BUDGET = Budget(octets=65_536, elements=200, depth=12, dimensions=4)
_LONGEST_LINE = 2000  # of an error
_MOST_LINES = 51  # what is wrong with a configuration, and how many more there are
_STRUCTURE = MessageStructure(
    {
        "type": "object",
        "properties": {
            "data": {"type": "string", "x-octets": True},
            "wide": {"type": "integer"},
            "real": {"type": "number", "x-nonfinite": True},
            "rows": {"type": "array", "items": {"type": "array", "items": {"type": "integer"}}},
            "more": {"type": "object", "additionalProperties": {"$ref": "#"}},
        },
    }
)


@frozen
class Target:
    """One decoder.

    Attributes:
        decode: takes any octets.
        refuses: what it may raise.
        seeds: inputs that it takes, or almost.
    """

    decode: Callable[[bytes], object]
    refuses: tuple[type[Exception], ...]
    seeds: tuple[bytes, ...]

    def run(self, data: bytes) -> bool:
        """Decode once; False when it was refused. Raises what is a finding."""
        try:
            self.decode(data)
        except self.refuses as error:
            lines = str(error).splitlines()
            is_short = len(lines) <= _MOST_LINES and len(max(lines, key=len)) <= _LONGEST_LINE
            assert is_short, "an error that quotes its input"
            return False
        return True


def within(value: object, budget: Budget) -> None:
    """Fail when a value holds more than a budget allows; counted without the decoders."""
    elements, depth, level = 0, 0, [value]
    while level:
        elements += len(level)
        inner: list[object] = []
        for item in level:
            if isinstance(item, dict):
                elements += len(item)
                inner += item.values()
            elif isinstance(item, list):
                inner += item
        depth += any(isinstance(item, dict | list) for item in level)
        level = inner
    assert elements <= budget.elements, f"{elements} values"
    assert depth <= budget.depth, f"{depth} levels"
    assert message_octets(value) > 0


def text_of(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _form(form: Form) -> Callable[[bytes], object]:
    def decode(data: bytes) -> None:
        fields = form.read(text_of(data) if form.text else data, BudgetUse(BUDGET))
        within(fields, BUDGET)
        asked = check_asked(fields)
        written = form.write(dict(fields))
        again = form.read(written.decode() if form.text else written, BudgetUse(Budget()))
        assert form.write(dict(again)) == written, asked

    return decode


def _scan(data: bytes) -> None:
    """Whatever the parser of Python makes of a text, the scan has counted."""
    text = text_of(data)
    scan_json(text, BudgetUse(BUDGET))
    with suppress(ValueError):
        within(json.loads(text), BUDGET)


def _logical(data: bytes) -> None:
    message = orjson.loads(text_of(data))
    reader = TEXT_FORM.reader(_STRUCTURE.schema)
    assert reader is not None
    check = make_check(_STRUCTURE, ValidationMode.ALWAYS, "here")
    assert check is not None
    check(reader(message))


def _host_frame(data: bytes) -> None:
    value = unpack(data)
    with suppress(MessageError):  # it may hold what only a foreign writer makes
        unpack(pack(value))


def _status(data: bytes) -> None:
    from_json(orjson.loads(text_of(data)), StatusMap)


def _head(data: bytes) -> None:
    path, *lines = text_of(data).split("\n")
    headers = Headers()
    for line in lines:
        name, _, value = line.partition(":")
        headers[name] = value
    read_head(Request(path, headers))


def _frame(tree: bytes, *buffers: bytes) -> bytes:
    parts = (len(tree).to_bytes(4, "little") + tree, *buffers)
    return b"".join(part + bytes(-len(part) % 8) for part in parts)


def _asked(**fields: object) -> dict[str, object]:
    return {"op": "Data", "type": "c1", "id": "1", "jsonMessage": fields}


_JSON_SEEDS = (
    b'{"op":"Request","type":"f.out","id":"1","jsonMessage":{"every":1,"queue":{"length":2}}}',
    b'{"op":"Resume","id":"1","jsonMessage":{"key":"k","waiting":["1","2"]}}',
    b'{"op":"Call","type":"f","id":"1","jsonMessage":[[],{},"[\\"{\\\\"],"x-timeout":1.5}',
    b'{"op":"Data","type":"c1","id":"1","jsonMessage":{"a":[1,-2.5e3,true,null,"\\ud83d\\ude00"]}}',
)
_CBOR_SEEDS = (
    write_binary(_asked(a=[1, 2.5, None, True, -7, 2**70], b=b"octets", c="text")),
    write_binary(_asked()) + b"",
    bytes.fromhex("a1626f70d828828202028401020304"),
    bytes.fromhex("a1626f70d82882820102d84042abcd"),
    bytes.fromhex("a1626f70d8544400000001"),
    bytes.fromhex("a1626f70d85648000000000000f03f"),
    bytes.fromhex("a1626f709f01ff"),
    bytes.fromhex("bf626f707f6161ffff"),
    bytes.fromhex("a1626f70c249010000000000000000"),
)
_CONFIGURATION = b"""\
version: 1
bridges: {python: {}}
functions:
  f:
    components:
      - {name: a, bridge: python, output: {endpoint: [m:f]}}
"""
_FRAGMENTS = b"""\
{"op":"fragment","id":"a","num":1,"total":2,"data":"p\\":1}"}
{"op":"fragment","id":"a","num":0,"total":2,"data":"{\\"o"}"""
_CATALOGUE = b"""<catalogue profile="uoarm-rocos/1" device="d" heartbeat="1.0" seq="1" id="1">\
<api name="a" kind="call"><text>t</text></api></catalogue>"""
_CORE: Mapping[str, Target] = {
    "JSON of the native protocol": Target(_form(TEXT_FORM), (ControlMessageError,), _JSON_SEEDS),
    "CBOR of the native protocol": Target(_form(BINARY_FORM), (ControlMessageError,), _CBOR_SEEDS),
    "scan of JSON against a parser": Target(_scan, (ControlMessageError,), _JSON_SEEDS),
    "text to logical values": Target(
        _logical,
        (MessageError, orjson.JSONDecodeError),
        (
            b'{"data":"aGVsbG8=","wide":"-9223372036854775808","real":"NaN","rows":[[1,2],["3"]]}',
            b'{"more":{"a":{"more":{"b":{"wide":1}}}}}',
        ),
    ),
    "control messages of the model": Target(read_control, (ControlMessageError,), _JSON_SEEDS),
    "frames of hosts": Target(
        _host_frame,
        (MessageError,),
        (
            pack({"a": [1, 2.5, None, "x", b"octets", 2**80], "b": {"c": [True]}}),
            _frame(
                msgpack.packb(msgpack.ExtType(1, msgpack.packb(("<f8", [2], 16)))),
                struct.pack("<2d", 1, 2),
            ),
            _frame(msgpack.packb([msgpack.ExtType(1, msgpack.packb(("|u1", [2, 2], 4)))]), b"abcd"),
        ),
    ),
    "status of hosts": Target(
        _status,
        (ValueError,),
        (b'{"bridges":[],"components":[],"connections":[],"routes":[],"machines":[]}',),
    ),
    "heads of requests": Target(
        _head,
        (RefusedError, InvalidHeader),
        (b"/uoarm?token=a&b=%41\nHost: localhost\nUpgrade: websocket\nAuthorization: Bearer t",),
    ),
    "configuration files": Target(
        lambda data: loads(text_of(data)),
        (ConfigurationError,),
        (
            _CONFIGURATION,
            b"a: &b [1, *b]\n? {c: !!str 1}\n: >-\n  d\n",
            b"bridges: {%s}" % b", ".join(b"a b%d" % number for number in range(30)),
        ),
    ),
}


def _web() -> Mapping[str, Target]:
    """Return the decoders of `uoarm-rosbridge`, where it is installed."""
    if find_spec("uoarm_rosbridge") is None:
        return {}
    from uoarm_rosbridge._topics import read_options
    from uoarm_rosbridge._wire import Fragments, check_fields, read_operation

    from uoarm.cdr import Codec

    laid_out = MessageStructure(
        {
            "type": "object",
            "properties": {
                "width": {"type": "integer", "minimum": 0, "maximum": 2**32 - 1},
                "name": {"type": "string"},
                "data": {"type": "array", "items": {"type": "number", "x-float": 64}},
            },
            "required": ["width", "name", "data"],
            "additionalProperties": False,
        }
    )

    def operations(data: bytes) -> None:
        fragments = Fragments(4096, 60.0)
        for line in text_of(data).split("\n"):
            fields = read_operation(line, BudgetUse(BUDGET))
            within(fields, BUDGET)
            check_fields(fields, ("op",))
            read_options(fields)
            if fields["op"] == "fragment":
                check_fields(fields, ("id", "data", "num", "total"))
                whole = fragments.add(fields)
                assert 0 <= fragments.octets <= 4096
                if whole is not None:
                    read_operation(whole, BudgetUse(BUDGET))

    return {
        "rosbridge with fragments": Target(
            operations,
            (ControlMessageError,),
            (
                b'{"op":"publish","topic":"/t","msg":{"a":[1]}}',
                b'{"op":"subscribe","topic":"/t","throttle_rate":5,"queue_length":2,"compression":"cbor"}',
                _FRAGMENTS,
            ),
        ),
        "cbor-raw (CDR) from messages": Target(
            lambda data: Codec(laid_out).encode(orjson.loads(text_of(data))),
            (MessageError, orjson.JSONDecodeError),
            (b'{"width":7,"name":"abc","data":[1,2.5]}',),
        ),
    }


def _devices() -> Mapping[str, Target]:
    """Return the decoders of `uoarm-rocos`, where it is installed."""
    if find_spec("uoarm_rocos") is None:
        return {}
    from uoarm_rocos._codec import XmlCodec
    from uoarm_rocos._framing import LengthFramer, StuffedFramer, WireError
    from uoarm_rocos.devices._blood_pressure import Ua767Decoder
    from uoarm_rocos.devices._oximeters import ContecDecoder, Nonin1Decoder, Nonin2Decoder

    codec = XmlCodec()

    def xml(data: bytes) -> None:
        codec.write(codec.read(data))

    def in_two(make: Callable[[], Any]) -> Callable[[bytes], None]:
        """A line arrives in pieces: where it is cut must make no difference."""

        def feed(data: bytes) -> None:
            whole, cut = make(), make()
            middle = len(data) // 2
            first = [*cut.feed(data[:middle]), *cut.feed(data[middle:])]
            assert repr(whole.feed(data)) == repr(first)

        return feed

    return {
        "XML of devices": Target(
            xml,
            (WireError,),
            (
                b'<call seq="1" id="2" api="a"><v name="x">1</v></call>',
                b'<heartbeat seq="1"/>',
                _CATALOGUE,
            ),
        ),
        "frames on serial lines": Target(
            in_two(StuffedFramer), (WireError,), (StuffedFramer().frame(b"abc}~"),)
        ),
        "frames over TCP": Target(
            in_two(LengthFramer), (WireError,), (LengthFramer().frame(b"abc"),)
        ),
        "oximeters": Target(
            lambda data: [
                in_two(item)(data) for item in (ContecDecoder, Nonin1Decoder, Nonin2Decoder)
            ],
            (),
            (bytes(range(128, 136)), b"\x01\x81\x3c\x62\x00\x10" * 5),
        ),
        "blood-pressure monitors": Target(in_two(Ua767Decoder), (), (b"8050494650\r\n\x02\x03",)),
    }


def _openrtm() -> Mapping[str, Target]:
    """Return the decoder of `uoarm-rtm`, where it is installed."""
    if find_spec("uoarm_rtm") is None:
        return {}
    from uoarm_rtm._shape import (
        BIG,
        IdlEnum,
        IdlMember,
        IdlScalar,
        IdlSequence,
        IdlString,
        IdlStruct,
        IdlUnion,
        IdlUnionMember,
        codec_of,
    )

    kind = IdlEnum("Kind", ("A", "B"))
    shape = IdlStruct(
        "IDL:Fuzz:1.0",
        (
            IdlMember("time", IdlScalar("unsigned long")),
            IdlMember("texts", IdlSequence(IdlString())),
            IdlMember("wide", IdlString(wide=True)),
            IdlMember("numbers", IdlSequence(IdlScalar("double"))),
            IdlMember("flags", IdlSequence(IdlScalar("boolean"), 3)),
            IdlMember(
                "choice",
                IdlUnion(
                    "C",
                    kind,
                    (
                        IdlUnionMember("a", ("A",), IdlScalar("long")),
                        IdlUnionMember("b", ("B",), IdlString()),
                    ),
                ),
            ),
        ),
    )
    codec = codec_of(shape)
    message = {
        "time": 1, "texts": ["a", "b"], "wide": "w", "numbers": [1.0, 2.0],
        "flags": [True, False],
    }  # fmt: skip
    seeds = tuple(
        codec.encode({**message, "choice": choice})
        for choice in ({"switch": "A", "a": 1}, {"switch": "B", "b": "x"})
    )

    def decode(data: bytes) -> None:
        with suppress(MessageError):
            codec.decode(data, BIG)
        codec.encode(codec.decode(data))

    return {"CDR of OpenRTM": Target(decode, (MessageError,), seeds)}


def _ros1() -> Mapping[str, Target]:
    """Return the decoders of `uoarm-ros1`, where it is installed."""
    if find_spec("uoarm_ros1") is None:
        return {}
    from uoarm_ros1._definitions import DefinitionError, record_of, service_of
    from uoarm_ros1._tcpros import (
        ProtocolError,
        ReplyReader,
        TcprosReader,
        decode_header,
        encode_header,
        frames_of,
    )
    from uoarm_ros1._types import framed_writer, reader
    from uoarm_ros1._xmlrpc import (
        Fault,
        HttpReader,
        NodeApi,
        decode_call,
        decode_reply,
        encode_call,
        encode_reply,
        http_request,
    )

    record = record_of(
        "fuzz/Message",
        "bool on\nint64[] many\nfloat32[3] three\nstring[] texts\nPart[] parts\ntime[2] at\n"
        f"{'=' * 80}\nMSG: fuzz/Part\nbool[] flags\nchar[] octets\n",
    )
    read, write = reader(record, BUDGET), framed_writer(record)
    message = {
        "on": True, "many": [1], "three": [0.5, 1.0, 2.0], "texts": ["a", "bc"],
        "parts": [{"flags": [True], "octets": b"abc"}], "at": 2 * [{"secs": 1, "nsecs": 2}],
    }  # fmt: skip
    header = encode_header({"callerid": "/a", "md5sum": "*", "topic": "/t", "type": "*"})
    calls = tuple(
        encode_call(method, ["/m", *given])
        for method, given in (
            ("requestTopic", ["/t", [["TCPROS"]]]),
            ("publisherUpdate", ["/t", ["http://h:1/"]]),
            ("paramUpdate", ["/p/", {"a": [1, 2.5, True, b"x"]}]),
        )
    )

    def frames(data: bytes) -> None:
        """However a stream is cut, the same frames come, in runs or one by one."""
        came = []
        for in_runs, most in ((False, len(data)), (True, 7)):
            reading, at = TcprosReader(BUDGET.octets), 0
            reading.in_runs = in_runs
            came.append(b"")
            while at < len(data):
                buffer = reading.buffer()
                count = min(most, len(buffer), len(data) - at)
                buffer[:count] = data[at : at + count]
                at += count
                for frame in reading.received(count):
                    parts = frames_of(memoryview(frame)) if in_runs else ()
                    came[-1] += b"".join(part[4:] for part in parts) if in_runs else frame
        assert came[0] == came[1]

    def call(data: bytes) -> None:
        node = NodeApi("/me", "http://m:1/", 1, "h", 2)
        node.answer(*decode_call(data, BUDGET))

    def definition(data: bytes) -> None:
        text = text_of(data)
        with suppress(DefinitionError):
            service_of("fuzz/Service", text, lambda _: None)
        reader(record_of("fuzz/Other", text), BUDGET)

    return {
        "headers of TCPROS": Target(
            lambda data: decode_header(data[4:]), (ProtocolError,), (header,)
        ),
        "frames of TCPROS": Target(frames, (ProtocolError,), (header + b"\1\0\0\0a" * 9,)),
        "replies of ROS 1": Target(
            lambda data: ReplyReader(BUDGET.octets).received(data),
            (ProtocolError,),
            (b"\1\3\0\0\0abc",),
        ),
        "HTTP of ROS 1": Target(
            lambda data: HttpReader(BUDGET.octets).received(data),
            (ProtocolError,),
            (http_request("h", 1, b"<a/>"),),
        ),
        "calls of XML-RPC": Target(call, (ProtocolError,), calls),
        "answers of XML-RPC": Target(
            lambda data: decode_reply(data, BUDGET),
            (ProtocolError, Fault),
            (encode_reply([1, "", [["/t", ["/a"]], []]]), encode_reply(Fault("no"))),
        ),
        "definitions of ROS 1": Target(
            definition, (DefinitionError,), (b"string[] a\nint8 B=1\n", b"int8 a\n---\n")
        ),
        "messages of ROS 1": Target(
            lambda data: write(read(data)),
            (MessageError,),
            (bytes(write(message))[4:],),  # without the length before it
        ),
    }


def _recordings() -> Mapping[str, Target]:
    if find_spec("mcap") is None:
        return {}
    from uoarm.record._file import McapFile
    from uoarm.record._forms import form_of, reading_of
    from uoarm.record._reading import McapReader

    def read(data: bytes) -> None:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "x.mcap"
            path.write_bytes(data)
            reader = McapReader(path)
            octets = 0
            for topic, channel in reader.channels.items():
                with suppress(BridgeError):
                    decode = reading_of(channel).decode
                    for message in reader.messages(topic, 0, lambda _: None):
                        octets += len(message.data)
                        with suppress(MessageError):
                            decode(message.data)
            # No more than what the file has, unpacked.
            assert octets <= 1000 * len(data) + 65_536

    def written(compression: str) -> bytes:
        with TemporaryDirectory() as folder:
            file = McapFile(Path(folder) / "x.mcap", compression, 64)
            file.begin("")
            form = form_of("x", MessageStructure({"type": "object"}), {})
            file.add_channel(form)
            for n in range(3):
                file.add_message(form, n, b'{"n":%d}' % n, n)
            file.add_metadata("a", {"b": "c"})
            file.attach("a", b"b", "text/plain", 1)
            file.finish()
            return file.path.read_bytes()

    seeds = tuple(map(written, ("none", "lz4", "zstd")))
    return {"recording": Target(read, (BridgeError,), seeds)}


TARGETS: Mapping[str, Target] = {
    **_CORE,
    **_web(),
    **_devices(),
    **_openrtm(),
    **_ros1(),
    **_recordings(),
}
