"""Messages as ROS serialises them, by their structure alone: what is written is read again."""

from __future__ import annotations

import struct
from array import array
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.structures import closed

from uoarm.cdr import (
    RosDefinition,
    definition_of,
    deserialiser,
    ros_unit,
    serialiser,
    structure_of_definition,
)
from uoarm.cdr._layout import DDS, layout_of
from uoarm.errors import MessageError
from uoarm.model import Budget, MessageStructure
from uoarm.testing import same

RULE = "=" * 80
SCAN = RosDefinition(
    "lab/msg/Scan",
    f"""# a scan
Header header
string<=20 name
uint8 LASER=1
float64[3] place [0.0, 0.0, 0.0]
float32[] ranges
int16[<=4] few
bool[] hits
uint8[] picture
Part[] parts
Nothing nothing
wstring<=9 wide
char letter
{RULE}
MSG: lab/Header
int32 sec
uint32 nanosec
{RULE}
MSG: lab/Part
uint8 kind  # of it
float64 size
string text
{RULE}
MSG: lab/Nothing
""",
)
numbers = st.floats(width=32, allow_nan=False)
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)
scans = st.fixed_dictionaries(
    {
        "header": st.fixed_dictionaries(
            {"sec": st.integers(-(2**31), 2**31 - 1), "nanosec": st.integers(0, 2**32 - 1)}
        ),
        "name": st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=20),
        "place": st.lists(numbers, min_size=3, max_size=3),
        "ranges": st.lists(numbers, max_size=9),
        "few": st.lists(st.integers(-(2**15), 2**15 - 1), max_size=4),
        "hits": st.lists(st.booleans(), max_size=5),
        "picture": st.binary(max_size=20),
        "parts": st.lists(
            st.fixed_dictionaries({"kind": st.integers(0, 255), "size": numbers, "text": texts}),
            max_size=4,
        ),
        "nothing": st.just({}),
        "wide": texts.filter(lambda text: len(text.encode("utf-16-le")) <= 2 * 9),
        "letter": st.integers(0, 255),
    }
)


@given(scans)
def test_what_is_written_is_read_again(message: dict[str, Any]) -> None:
    structure = structure_of_definition(SCAN)
    octets = b"".join(serialiser(structure)(message))
    assert same(deserialiser(structure)(octets), message)


@given(scans, st.integers(0, 200))
def test_what_is_cut_short_is_refused(message: dict[str, Any], left: int) -> None:
    structure = structure_of_definition(SCAN)
    octets = b"".join(serialiser(structure)(message))
    if left < len(octets):
        with pytest.raises(MessageError):
            deserialiser(structure)(octets[:left])


def test_a_definition_and_its_structure_say_the_same() -> None:
    structure = structure_of_definition(SCAN)
    schema: Any = structure.schema
    assert structure.native_type == "lab/msg/Scan"
    assert schema["x-constants"] == {"LASER": 1}
    assert schema["properties"]["picture"]["x-octets"] is True
    assert schema["properties"]["few"]["maxItems"] == 4
    assert schema["properties"]["name"]["x-max-utf8"] == 20
    wide = schema["properties"]["wide"]
    assert (wide["x-max-utf16"], "x-max-utf8" in wide) == (9, False)
    assert structure_of_definition(definition_of(structure, "x/msg/Other")) == structure


def test_two_layouts_have_two_names_in_a_definition() -> None:
    other = {**closed(y={"type": "string"}), "x-native-type": "lab/msg/Part"}
    parts = closed(
        a_b=closed(c=closed(x={"type": "boolean"})),
        a=closed(b_c=closed(y={"type": "string"})),
        part={**closed(z={"type": "boolean"}), "x-native-type": "lab/msg/Part"},
        others={"type": "array", "items": other},
    )
    again = structure_of_definition(definition_of(MessageStructure(parts), "lab/msg/Whole"))
    assert layout_of(again.schema, DDS) == layout_of(parts, DDS)


def test_a_definition_without_fields_is_a_text_still() -> None:
    structure = MessageStructure(closed())
    definition = definition_of(structure, "x/msg/Nothing")
    assert definition.text == "# no fields\n", "viewers refuse an empty one"
    schema: Any = structure_of_definition(definition).schema
    assert schema["properties"] == {}


def test_the_octets_of_a_known_message() -> None:
    structure = structure_of_definition(
        RosDefinition("lab/msg/Known", "uint8 a\nfloat64 b\nstring c\nuint16[] d\n")
    )
    body = (
        b"\x07" + bytes(7)  # a, and what brings b to a multiple of eight
        + struct.pack("<d", 0.5)
        + b"\x03\0\0\0hi\0" + bytes(1)  # c, with the zero at its end
        + b"\x02\0\0\0\x01\x02\xff\xff"
    )  # fmt: skip
    message = {"a": 7, "b": 0.5, "c": "hi", "d": [0x0201, 0xFFFF]}
    assert b"".join(serialiser(structure)(message)) == b"\0\1\0\0" + body
    assert same(deserialiser(structure)(b"\0\1\0\0" + body), message)


def test_a_float_that_is_whole_is_an_integer() -> None:
    structure = structure_of_definition(
        RosDefinition("lab/msg/Whole", "uint8 a\nint32[] b\nfloat64 c\n")
    )
    octets = b"".join(serialiser(structure)({"a": 2.0, "b": [1.0, -2], "c": 3}))
    assert same(deserialiser(structure)(octets), {"a": 2, "b": [1, -2], "c": 3.0})
    with pytest.raises(MessageError, match="expected an integer"):
        serialiser(structure)({"a": 2.5, "b": [], "c": 3})


def test_the_other_byte_order_and_the_packed_form_are_read() -> None:
    structure = structure_of_definition(RosDefinition("lab/msg/Two", "uint8 a\nint32[] b\n"))
    message = {"a": 1, "b": array("i", [-2, 3])}
    big = b"\0\0\0\0\x01\0\0\0" + struct.pack(">Iii", 2, -2, 3)
    assert same(deserialiser(structure)(big), message)
    packed = b"\x01" + struct.pack("<Iii", 2, -2, 3)
    assert same(deserialiser(structure, is_packed=True)(packed), message)


def test_a_definition_of_ros_1_has_its_own_types() -> None:
    text = "Header header\nbyte level  # \u2028 \x0c \x85 end no line\ntime at\n"
    text += f"{RULE}\nMSG: std_msgs/Header\nuint32 seq\n"
    structure = structure_of_definition(RosDefinition("lab/One", text), is_ros_1=True)
    schema: Any = structure.schema
    assert structure.native_type == "lab/One"
    assert schema["properties"]["level"]["minimum"] == -128
    message = {"header": {"seq": 5}, "level": -1, "at": {"secs": 1, "nsecs": 2}}
    packed = struct.pack("<IbII", 5, -1, 1, 2)
    assert deserialiser(structure, is_packed=True)(packed) == message


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("Other o\n", "lab/Other is not defined"),
        ("Wrong w\n", "is not defined with it, or holds itself"),
        ("uint8\n", "is no field"),
        ("uint8 a\n" * 30_000, "more than 20,000 fields"),
        ("# " + "x" * 2_000_000, "letters"),
    ],
)
def test_a_definition_that_cannot_be_understood_says_why(text: str, why: str) -> None:
    with pytest.raises(MessageError, match=why):
        structure_of_definition(RosDefinition("lab/msg/Wrong", text))


def test_what_claims_more_than_its_octets_or_the_budget_hold_is_refused() -> None:
    structure = structure_of_definition(
        RosDefinition("lab/msg/Many", f"Nothing[] all\n{RULE}\nMSG: lab/Nothing\n")
    )
    claim = b"\0\1\0\0" + struct.pack("<I", 2**32 - 1)
    with pytest.raises(MessageError, match="more elements than are allowed"):
        deserialiser(structure)(claim)
    with pytest.raises(MessageError, match="octets"):
        deserialiser(structure, budget=Budget(octets=4))(claim)


@pytest.mark.parametrize(
    "schema",
    [True, {"type": "object"}, {"type": "array", "items": {"type": "array"}}, {"enum": [1]},
     {"type": "array", "prefixItems": [{"type": "integer"}], "items": False}],
)  # fmt: skip
def test_a_structure_without_a_layout_is_refused(schema: Any) -> None:
    for structure in (MessageStructure(schema), MessageStructure(closed(field=schema))):
        with pytest.raises(MessageError, match="has no fixed layout"):
            deserialiser(structure)
        with pytest.raises(MessageError, match="has no fixed layout"):
            definition_of(structure, "x/msg/Odd")


@pytest.mark.parametrize("schema", [{"type": "number"}, {"type": "array", "items": closed()}])
def test_what_is_no_record_has_a_layout_and_no_definition(schema: Any) -> None:
    structure = MessageStructure(schema)
    deserialiser(structure)
    with pytest.raises(MessageError, match="has no fields"):
        definition_of(structure, "x/msg/Odd")


@pytest.mark.parametrize(
    ("type_name", "member", "unit"),
    [
        ("geometry_msgs/Twist", "linear", "m/s"),
        ("geometry_msgs/msg/Twist", "angular", "rad/s"),
        ("time", "nsecs", "ns"),
        ("builtin_interfaces/msg/Time", "nanosec", "ns"),
        ("geometry_msgs/Twist", "other", None),
        ("lab/msg/Own", "linear", None),
    ],
)
def test_units_are_those_that_the_definitions_state(
    type_name: str, member: str, unit: str | None
) -> None:
    assert ros_unit(type_name, member) == unit
