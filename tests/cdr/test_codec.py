"""Serialising by structure: known octets, a slow writer to compare with, hostile octets, places."""

from __future__ import annotations

import json
import math
import struct
import sys
from array import array
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.hostile import misbehaviour
from tests.structures import closed

from uoarm.cdr import CORBA, DDS, NATIVE, ROS_1, ByteOrder, Codec, Encoding, _values, _writing
from uoarm.errors import MessageError
from uoarm.model import Budget, MessageStructure, from_json, to_json
from uoarm.testing import plain

ENCODINGS = [DDS, CORBA, ROS_1]
ORDERS: list[ByteOrder] = ["<", ">"]
INTEGERS = {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
            "int64": "q", "uint64": "Q"}  # fmt: skip
BOOLEAN, TEXT = {"type": "boolean"}, {"type": "string", "x-nul": False}


def number(name: str) -> dict[str, Any]:
    return {"type": "number" if name.startswith("float") else "integer", "x-native-type": name}


def listing(items: object, **more: int) -> dict[str, Any]:
    return {"type": "array", "items": items, **more}


def codec(encoding: Encoding, **members: object) -> Codec:
    return Codec(structure(**members), encoding)


def structure(**members: object) -> MessageStructure:
    return MessageStructure(closed(**members), native_type="t/Type")


MANY = {
    "first": number("uint8"),
    "wide": number("float64"),
    "text": TEXT,
    "short": number("int16"),
    "none": listing(number("float64")),
    "pair": listing(number("int16"), minItems=2, maxItems=2),
    "flags": listing(BOOLEAN),
    "parts": listing(closed(flag=BOOLEAN, at=number("float64"))),
    "empty": closed(),
    "octets": listing(number("uint8"), **{"x-octets": True}),
    "last": number("uint32"),
}
MESSAGE: dict[str, Any] = {
    "first": 1, "wide": 2.5, "text": "é", "short": -2, "none": [], "pair": [3, 4],
    "flags": [True, False], "parts": [{"flag": True, "at": 0.5}, {"flag": False, "at": 1.5}],
    "empty": {}, "octets": b"abc", "last": 9,
}  # fmt: skip


@pytest.mark.parametrize("order", ORDERS)
def test_every_number_lies_where_its_encoding_has_it(order: ByteOrder) -> None:
    text = "é".encode() + b"\0"
    # Behind the text: two octets of padding, or one, as the position is 19 or 20 then.
    head = struct.pack(f"{order}B7xdI3sxhxxI2hI2?xxI", 1, 2.5, 3, text, -2, 0, 3, 4, 2, 1, 0, 2)
    assert len(head) == 48
    parts = struct.pack(f"{order}?7xd?7xd", True, 0.5, False, 1.5)
    body = head + parts + struct.pack(f"{order}I3sxI", 3, b"abc", 9)
    assert codec(CORBA, **MANY).encode(MESSAGE, order) == body
    # Here an empty record takes an octet.
    body = head + parts + struct.pack(f"{order}B3xI3sxI", 0, 3, b"abc", 9)
    header = b"\0\1\0\0" if order == "<" else bytes(4)
    assert codec(DDS, **MANY).encode(MESSAGE, order) == header + body
    packed = struct.pack(f"{order}BdI2shI2hI2?I", 1, 2.5, 2, text[:2], -2, 0, 3, 4, 2, 1, 0, 2)
    packed += struct.pack(f"{order}?d?dI3sI", True, 0.5, False, 1.5, 3, b"abc", 9)
    assert codec(ROS_1, **MANY).encode(MESSAGE, order) == packed


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
def test_what_was_written_is_read(encoding: Encoding, order: ByteOrder) -> None:
    many = Codec(structure(**MANY), encoding, Budget())
    octets = many.encode(MESSAGE, order)
    for form in (octets, bytearray(octets), memoryview(octets)):
        message: Any = many.decode(form, order)
        assert plain(message) == {**MESSAGE, "octets": [97, 98, 99]}
        assert not message["pair"].flags.writeable or order != NATIVE
        assert message["pair"].dtype.isnative
    assert many.encode(message, order) == octets


def test_numbers_are_views_of_what_came() -> None:
    octets = codec(DDS, values=listing(number("float64"))).encode({"values": [1.0] * 1000})
    message: Any = codec(DDS, values=listing(number("float64"))).decode(octets)
    assert np.shares_memory(message["values"], np.frombuffer(octets, "u1"))


def reference(schema: Any, value: Any, encoding: Encoding, order: str) -> bytes:
    """The same again, octet by octet."""
    out = bytearray()

    def put(code: str, number: Any) -> None:
        size = struct.calcsize(code)
        if encoding.is_aligned:
            out.extend(bytes(-len(out) % size))
        out.extend(struct.pack(order + code, number))

    def walk(schema: Any, value: Any) -> None:
        kind, native = schema["type"], schema.get("x-native-type")
        if kind == "object":
            for name, member in schema["properties"].items():
                walk(member, value[name])
            if not schema["properties"] and encoding is DDS:
                out.append(0)
        elif kind == "array":
            if "minItems" not in schema:
                put("I", len(value))
            for item in value:
                walk(schema["items"], item)
        elif kind == "string":
            octets = value.encode() + (b"\0" if encoding.is_aligned else b"")
            put("I", len(octets))
            out.extend(octets)
        else:
            put({"float32": "f", "float64": "d", None: "?"}.get(native) or INTEGERS[native], value)

    walk(schema, value)
    header = b"" if encoding is not DDS else b"\0\1\0\0" if order == "<" else bytes(4)
    return header + out


def single() -> st.SearchStrategy[tuple[Any, st.SearchStrategy[Any]]]:
    def bounded(name: str) -> tuple[Any, st.SearchStrategy[Any]]:
        bits = 8 * struct.calcsize(INTEGERS[name])
        least = 0 if name.startswith("u") else -(2 ** (bits - 1))
        return number(name), st.integers(least, least + 2**bits - 1)

    texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=5)
    kinds = [
        (BOOLEAN, st.booleans()),
        (TEXT, texts),
        (number("float32"), st.floats(width=32, allow_nan=False)),
        (number("float64"), st.floats(allow_nan=False)),
        *map(bounded, INTEGERS),
    ]
    return st.sampled_from(kinds)


@st.composite
def structures(draw: st.DrawFn, depth: int = 3) -> tuple[Any, st.SearchStrategy[Any]]:
    """A schema of a record, with a strategy for its messages."""
    members, values = {}, {}
    for index in range(draw(st.integers(0 if depth < 3 else 1, 4))):
        schema, value = draw(structures(depth - 1) if depth and draw(st.booleans()) else single())
        many = draw(st.sampled_from(["no", "any", "fixed"]))
        if many == "any":
            schema, value = listing(schema), st.lists(value, max_size=3)
        elif many == "fixed":
            size = draw(st.integers(1, 3))
            schema = listing(schema, minItems=size, maxItems=size)
            value = st.lists(value, min_size=size, max_size=size)
        members[f"m{index}"], values[f"m{index}"] = schema, value
    return closed(**members), st.fixed_dictionaries(values)


@given(st.data(), structures(), st.sampled_from(ENCODINGS), st.sampled_from(ORDERS))
def test_any_structure_is_written_as_the_slow_writer_does_and_read_back(
    data: st.DataObject, made: Any, encoding: Encoding, order: ByteOrder
) -> None:
    schema, values = made
    message = data.draw(values)
    known = Codec(MessageStructure(schema), encoding, Budget())
    octets = known.encode(message, order)
    assert octets == reference(schema, message, encoding, order)
    assert plain(known.decode(octets, order)) == message


@given(st.binary(max_size=200), structures(), st.sampled_from(ENCODINGS), st.sampled_from(ORDERS))
def test_any_octets_are_read_or_refused_with_a_place(
    octets: bytes, made: Any, encoding: Encoding, order: ByteOrder
) -> None:
    known = Codec(MessageStructure(made[0]), encoding, Budget(elements=1000))
    header = b"" if encoding is not DDS else b"\0\1\0\0" if order == "<" else bytes(4)
    try:
        message = known.decode(header + octets, order)
    except MessageError as error:
        assert "cannot be read: $" in str(error)
    else:
        known.encode(message, order)


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
def test_what_is_cut_short_is_refused_wherever_it_is_cut(encoding: Encoding) -> None:
    many = codec(encoding, **MANY)
    octets = many.encode(MESSAGE)
    for end in range(4, len(octets)):
        with pytest.raises(MessageError, match="t/Type: cannot be read: "):
            many.decode(octets[:end])
    if encoding is not DDS:
        with pytest.raises(MessageError, match="octets came"):
            many.decode(octets + bytes(1))


def test_what_is_encapsulated_may_have_octets_behind_it() -> None:
    small = codec(DDS, a=number("uint8"))
    assert small.decode(small.encode({"a": 7}) + bytes(9)) == {"a": 7}
    with pytest.raises(MessageError, match=r"unknown way, b'\\x00\\x07' is no header"):
        small.decode(b"\0\7\0\0\1")
    with pytest.raises(MessageError, match="cannot be read"):
        small.decode(b"\0\1\0\0")


@pytest.mark.parametrize(
    ("schema", "octets", "why"),
    [
        (listing(TEXT), struct.pack("<I", 1000) + bytes(100), "1,000 elements|4,000 octets should"),
        (listing(BOOLEAN), b"\xff" * 4, "more elements|octets should follow"),
        (listing(closed()), struct.pack("<I", 2**31), "more elements than are allowed"),
        (listing(listing(BOOLEAN)), struct.pack("<II", 1, 999) + bytes(999), "more elements"),
        (listing(number("float64")), b"\xff" * 4, "cut short"),
        (listing(number("uint8"), maxItems=2), struct.pack("<I3B", 3, 1, 2, 3), "at most 2 elem"),
        ({**TEXT, "x-max-utf8": 2}, struct.pack("<I3s", 3, b"abc"), "at most 2 octets"),
        (number("uint8"), bytes(2001), "2,001 octets came, 2,000 are allowed"),
    ],
)
def test_bounds_and_budgets_hold_before_anything_is_made(
    schema: object, octets: bytes, why: str
) -> None:
    encoding = CORBA if schema == listing(listing(BOOLEAN)) else ROS_1
    with pytest.raises(MessageError, match=why):
        Codec(structure(a=schema), encoding, Budget(octets=2000, elements=900)).decode(octets, "<")


def test_without_a_budget_a_list_has_no_more_elements_than_octets() -> None:
    with pytest.raises(MessageError, match="octets should follow"):
        codec(ROS_1, a=listing(closed())).decode(struct.pack("<I", 2**31), "<")


def test_a_fixed_number_of_what_takes_no_octets_is_read_of_none() -> None:
    known = codec(ROS_1, a=listing(closed(), minItems=3, maxItems=3))
    assert known.encode({"a": [{}] * 3}) == b""
    assert known.decode(b"") == {"a": [{}] * 3}


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
def test_lists_lie_in_lists_however_deep(encoding: Encoding) -> None:
    schema: Any = closed(end=number("float64"), ends=listing(number("int32")))
    message: Any = {"end": 0.5, "ends": [1, 2]}
    for _ in range(28):
        schema, message = closed(list=listing(schema)), {"list": [message]}
    known = Codec(MessageStructure(schema), encoding, Budget())
    octets = known.encode(message)
    assert octets == reference(schema, message, encoding, NATIVE)
    assert plain(known.decode(octets)) == message
    inner = message
    while "list" in inner:
        inner = inner["list"][0]
    inner["end"] = "x"
    with pytest.raises(MessageError, match=r"(\.list\[0\]){28}\.end: expected a number"):
        known.encode(message)
    with pytest.raises(MessageError, match=r"\$(\.list\[0\]){28}\.ends: it is cut short"):
        known.decode(octets[:-1])


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"first": 256}, r"\$\.first: expected 0 to 255 \(uint8\), got 256"),
        ({"first": True}, r"\$\.first: expected an integer"),
        ({"first": 1.5}, r"\$\.first: expected an integer"),
        ({"last": 2**32}, r"\$\.last: expected 0 to 4294967295"),
        ({"wide": "1"}, r"\$\.wide: expected a number"),
        ({"wide": False}, r"\$\.wide: expected a number"),
        ({"text": 5}, r"\$\.text: expected a string, got int 5"),
        ({"text": "\ud800"}, r"\$\.text: cannot be written as utf-8"),
        ({"none": [1.0, "x"]}, r"\$\.none\[1\]: expected a number"),
        ({"none": [1.0, True]}, r"\$\.none\[1\]: expected a number"),
        ({"none": b"12345678"}, r"\$\.none: expected an array of float64, got octets"),
        ({"none": np.array([1j])}, r"\$\.none: expected an array of float64, got an array of com"),
        ({"none": np.zeros((1, 1))}, r"\$\.none: expected an array of one dimension, got 2"),
        ({"pair": [1]}, r"\$\.pair: expected 2 elements, got 1"),
        ({"pair": np.zeros(3, "h")}, r"\$\.pair: expected 2 elements, got 3"),
        ({"pair": np.array([1.0, 2.0**20])}, r"\$\.pair\[1\]: expected -32768 to 32767"),
        ({"pair": np.array([1, 0.5])}, r"\$\.pair\[1\]: expected an integer \(int16\), got 0.5"),
        ({"pair": np.array([np.nan, 1])}, r"\$\.pair\[0\]: expected an integer \(int16\), got n"),
        ({"pair": np.array([np.inf, 1])}, r"\$\.pair\[0\]: expected an integer \(int16\), got i"),
        ({"pair": np.array([1, 2**20])}, r"\$\.pair\[1\]: expected -32768 to 32767"),
        ({"flags": [True, 1]}, r"\$\.flags\[1\]: expected true or false"),
        ({"parts": [MESSAGE["parts"][0], {"flag": True}]}, r"\$\.parts\[1\]: field 'at' is miss"),
        ({"parts": {"a": 1}}, r"\$\.parts: expected an array"),
        ({"parts": [3]}, r"\$\.parts\[0\]: expected an object, got int 3"),
        ({"parts": [{"flag": True, "at": "x"}]}, r"\$\.parts\[0\]\.at: expected a number"),
        ({"empty": {"a": 1}}, r"\$\.empty: there is no field 'a'"),
        ({"octets": [1, 256]}, r"\$\.octets\[1\]: expected 0 to 255"),
        ({"more": 1}, r"\$: there is no field 'more'; the fields are first, "),
    ],
)
@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
def test_what_does_not_fit_is_refused_with_its_place(
    encoding: Encoding, change: dict[str, Any], where: str
) -> None:
    with pytest.raises(MessageError, match=where):
        codec(encoding, **MANY).encode({**MESSAGE, **change})


@pytest.mark.parametrize("kind", ["f4", "f8", ">f4", "list"])
@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
def test_floats_that_are_whole_are_integers_in_arrays_as_in_lists(
    encoding: Encoding, kind: str
) -> None:
    known = codec(encoding, **MANY)
    pair = [3.0, 4.0] if kind == "list" else np.array([3.0, 4.0], kind)
    assert known.encode({**MESSAGE, "pair": pair}) == known.encode(MESSAGE)


@pytest.mark.parametrize("name", ["first", "wide", "text", "none", "flags", "parts", "octets"])
@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda encoding: encoding.name)
def test_what_a_value_does_itself_is_a_refusal(encoding: Encoding, name: str) -> None:
    known = codec(encoding, **MANY)

    def write(value: Any) -> None:
        octets = known.encode({**MESSAGE, name: value})
        assert known.encode(known.decode(octets)) == octets  # as long as it says

    assert not misbehaviour(write)


def test_what_raises_is_named_with_its_place() -> None:
    class Wrong(list[Any]):
        def __len__(self) -> int:
            raise GeneratorExit("of mine")

    place = r"t/Type: \$\.parts: GeneratorExit: of mine$"
    with pytest.raises(MessageError, match=place) as raised:
        codec(DDS, **MANY).encode({**MESSAGE, "parts": Wrong()})
    assert isinstance(raised.value.__cause__, GeneratorExit)


def test_a_text_that_stands_in_a_list_too_often_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module in (_values, _writing):
        monkeypatch.setattr(module, "MOST_OCTETS", 2**20)
    with pytest.raises(MessageError, match="octets up to here: 1,048,576 are allowed"):
        codec(DDS, often=listing(TEXT)).encode({"often": ["x" * 2**16] * 2**10})


@pytest.mark.parametrize("message", [None, 5, [], "text", {"a": 1}])
def test_what_is_no_message_is_refused(message: Any) -> None:
    with pytest.raises(MessageError, match=r"\$: (expected an object|field 'x' is missing)"):
        codec(DDS, x=TEXT).encode(message)


def test_a_text_that_would_end_early_is_refused_where_texts_end_with_zero() -> None:
    for encoding in (DDS, CORBA):
        with pytest.raises(MessageError, match="without the character NUL"):
            codec(encoding, a=TEXT).encode({"a": "x\0y"})
    assert codec(ROS_1, a=TEXT).encode({"a": "x\0y"}, "<") == b"\3\0\0\0x\0y"


@pytest.mark.parametrize(
    "given",
    [
        [1, 2, 3], (1, 2, 3), [1, 2.0, np.int64(3)], array("i", [1, 2, 3]), array("q", [1, 2, 3]),
        array("I", [1, 2, 3]), memoryview(array("i", [1, 9, 2, 9, 3, 9]))[::2],
        np.array([1, 2, 3]), np.array([3, 2, 1], "i")[::-1], np.array([1, 2, 3], ">i4"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("order", ORDERS)
def test_numbers_come_in_any_buffer(given: object, order: ByteOrder) -> None:
    octets = codec(ROS_1, a=listing(number("int32"))).encode({"a": given}, order)
    assert octets == struct.pack(f"{order}I3i", 3, 1, 2, 3)


def test_not_a_number_and_infinities_pass_as_floats() -> None:
    kinds = {"a": number("float32"), "many": listing(number("float32"))}
    values = [math.nan, math.inf, -math.inf]
    for many in (values, np.array(values)):
        octets = codec(ROS_1, **kinds).encode({"a": math.inf, "many": many}, "<")
        message: Any = codec(ROS_1, **kinds).decode(octets, "<")
        assert message["a"] == math.inf
        assert np.array_equal(message["many"], np.array(values, "f"), equal_nan=True)
    for message in ({"a": 1e39, "many": []}, {"a": 0.0, "many": [1e39]}):
        with pytest.raises(MessageError, match=r"expected at most 3\.4e38 in size"):
            codec(ROS_1, **kinds).encode(message)


def test_long_arrays_stay_parts_and_what_follows_is_aligned() -> None:
    kinds = {"flag": BOOLEAN, "pixels": listing(number("uint8")), "wide": number("float64"),
             "points": listing(number("float64")), "last": listing(number("int32"))}  # fmt: skip
    pixels, points = bytearray(100_001), array("d", [0.5] * 10_000)
    message = {"flag": True, "pixels": pixels, "wide": 1.5, "points": points, "last": [7]}
    parts = codec(DDS, **kinds).encode_parts(message)
    assert any(part is pixels for part in parts)
    assert any(isinstance(part, memoryview) and part.obj is points for part in parts)
    wanted = reference(closed(**kinds), message, DDS, NATIVE)
    assert b"".join(parts) == codec(DDS, **kinds).encode(message) == wanted


def test_wide_texts_are_those_of_each_encoding() -> None:
    wide = {"type": "string", "x-native-type": "wstring"}
    units = "ä😀".encode("utf-16-le")
    octets = codec(DDS, a=wide).encode({"a": "ä😀"}, ">")
    assert octets == bytes(4) + struct.pack(">4I", 3, *struct.unpack("<3H", units))
    assert codec(DDS, a=wide).decode(octets) == {"a": "ä😀"}
    octets = codec(CORBA, a=wide).encode({"a": "ä😀"}, "<")
    assert octets == struct.pack("<I", 8) + b"\xff\xfe" + units
    assert codec(CORBA, a=wide).decode(octets, "<") == {"a": "ä😀"}
    assert codec(CORBA, a=wide).decode(struct.pack("<I", 2) + b"\0x", "<") == {"a": "x"}
    with pytest.raises(MessageError, match="has no wide texts"):
        codec(ROS_1, a=wide)


MOOD = {"type": "string", "enum": ["CALM", "ANGRY", "SAD"], "x-native-type": "IDL:Mood:1.0"}
UNION = {
    "oneOf": [
        closed(switch={"enum": ["ANGRY"]}, shout=TEXT),
        closed(switch={"enum": ["CALM"]}, rest=number("float64")),
        closed(switch={"enum": ["SAD"]}),
    ],
    "x-switch": MOOD,
}


def test_enumerations_and_unions_are_those_of_corba() -> None:
    known = codec(CORBA, mood=MOOD, choice=UNION)
    octets = known.encode({"mood": "SAD", "choice": {"switch": "CALM", "rest": 0.5}}, "<")
    assert octets == struct.pack("<IId", 2, 0, 0.5)
    for choice in ({"switch": "CALM", "rest": 0.5}, {"switch": "ANGRY", "shout": "!"},
                   {"switch": "SAD"}):  # fmt: skip
        message = {"mood": "CALM", "choice": choice}
        assert known.decode(known.encode(message)) == message
    with pytest.raises(MessageError, match=r"\$\.mood: enumerator number 3 does not exist"):
        known.decode(struct.pack("<IId", 3, 0, 0.5), "<")
    wrong: Any
    for wrong, why in (
        ({"switch": "GLAD"}, r"\$\.choice\.switch: expected one of CALM, ANGRY, SAD"),
        ({"switch": "CALM", "shout": ""}, r"\$\.choice: field 'rest' is missing"),
        ({"switch": "SAD", "rest": 1.0}, r"\$\.choice: there is no field 'rest'"),
        ({"switch": "ANGRY", "shout": 5}, r"\$\.choice\.shout: expected a string"),
        (5, r"\$\.choice: expected an object"),
        ({}, r"\$\.choice: field 'switch' is missing"),
    ):
        with pytest.raises(MessageError, match=why):
            known.encode({"mood": "CALM", "choice": wrong})
    assert codec(DDS, mood=MOOD).encode({"mood": "SAD"})[4:8] == struct.pack("=I", 4)


@pytest.mark.parametrize(
    ("schema", "why"),
    [
        (True, "the message has no fixed layout"),
        ({"oneOf": [{"type": "object"}]}, "no single type"),
        (closed(x=True), r"message\.x has no fixed"),
        (closed(x={"type": ["string", "null"]}), r"message\.x has no fixed"),
        (closed(x={"type": "array"}), "no single type"),
        (closed(x=listing(listing(TEXT))), "ROS has no arrays"),
        ({**closed(x=TEXT), "required": []}, "absent or added"),
    ],
)
def test_a_structure_without_a_layout_is_named(schema: Any, why: str) -> None:
    with pytest.raises(MessageError, match=why):
        Codec(MessageStructure(schema))


def test_members_keep_their_order_on_the_way_from_a_host() -> None:
    sent = json.dumps(to_json(structure(zebra=number("uint8"), ape=BOOLEAN)))
    back = from_json(json.loads(sent), MessageStructure)
    assert Codec(back).encode({"ape": True, "zebra": 7})[4:] == b"\7\1"


def test_two_structures_of_one_layout_share_what_was_generated() -> None:
    one, two = codec(DDS, a=number("int32")), codec(DDS, a={**number("int32"), "title": "A"})
    octets = one.encode({"a": 1})
    assert one.decode(octets) == two.decode(octets) == {"a": 1}
    assert {*map(id, one._readers.values())} == {*map(id, two._readers.values())}


def test_the_native_order_is_the_machines() -> None:
    assert {"little": "<", "big": ">"}[sys.byteorder] == NATIVE
