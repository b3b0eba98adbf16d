"""What is written is read back the same and is what the XSD says; nothing else is read."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any

import pytest
import uoarm_rocos
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree
from strategies import messages
from uoarm_rocos._catalogue import (
    CallMessage,
    CatalogueMessage,
    DataMessage,
    HeartbeatMessage,
    ResultMessage,
    WireMessage,
)
from uoarm_rocos._catalogue_xml import load_catalogue
from uoarm_rocos._codec import WrittenForm, XmlCodec
from uoarm_rocos._framing import MessageLimits, WireError

from uoarm.errors import ConfigurationError

PAGE = Path(__file__).parents[1] / "docs" / "profile.md"
XSD = etree.XMLSchema(etree.parse(Path(uoarm_rocos.__file__).with_name("profile.xsd")))
CODEC = XmlCodec()


@given(messages)
def test_every_message_comes_back_the_same(message: WireMessage) -> None:
    again = CODEC.read(CODEC.write(message))
    assert again == message
    if isinstance(message, CatalogueMessage):
        assert isinstance(again, CatalogueMessage)
        assert again.catalogue.apis == message.catalogue.apis
    elif isinstance(message, CallMessage | DataMessage):
        assert isinstance(again, CallMessage | DataMessage)
        assert again.values == message.values
        assert repr(again.values) == repr(message.values)  # 1, 1.0 and True are equal, not the same


@given(messages)
def test_what_is_written_is_valid_by_the_xsd(message: WireMessage) -> None:
    XSD.assertValid(etree.fromstring(CODEC.write(message)))


@given(messages, st.data())
def test_a_message_cut_anywhere_is_refused(message: WireMessage, data: st.DataObject) -> None:
    written = CODEC.write(message)
    cut = data.draw(st.integers(0, len(written) - 1))
    with pytest.raises(WireError):
        CODEC.read(written[:cut])


@given(messages, st.data())
def test_a_changed_octet_gives_a_message_or_a_wire_error(
    message: WireMessage, data: st.DataObject
) -> None:
    written = bytearray(CODEC.write(message))
    for _ in range(data.draw(st.integers(1, 3))):
        written[data.draw(st.integers(0, len(written) - 1))] = data.draw(st.integers(0, 255))
    try:
        read = CODEC.read(bytes(written))
    except WireError:
        return
    CODEC.write(read)


NUMBERS = [0.5, -1e300, float("inf"), 3.0]


@pytest.mark.parametrize(
    "values",
    [NUMBERS, [NUMBERS, NUMBERS], [*NUMBERS, "text"], [*NUMBERS, 1], [0.5, NUMBERS], [[], NUMBERS]],
    ids=str,
)
def test_numbers_in_lists_are_read_at_once_and_among_others_too(values: list[Any]) -> None:
    written = CODEC.write(DataMessage(1, 1, {"a": values, "b": values}, None))
    read = WrittenForm(MessageLimits()).read(written)
    assert isinstance(read, DataMessage)
    assert repr(read.values) == repr({"a": values, "b": values})


def test_the_numbers_of_a_list_count_as_elements() -> None:
    written = CODEC.write(DataMessage(1, 1, {"a": NUMBERS}, None))
    fitting, most = MessageLimits(elements=6), MessageLimits(elements=5)
    assert WrittenForm(fitting).read(written) is not None
    with pytest.raises(WireError, match="elements"):
        XmlCodec(most).read(written)


@pytest.mark.parametrize("number", ["1_0", " 1", "0x1", "1e999", "nan"])
def test_what_is_no_number_of_the_profile_is_none_in_a_list_either(number: str) -> None:
    text = f'<data id="1" seq="1"><list name="a"><number>1</number><number>{number}</number></list>'
    with pytest.raises(WireError):
        CODEC.read(f"{text}</data>".encode())


@given(messages)
def test_what_the_codec_writes_needs_no_xml_parser_and_reads_the_same(message: WireMessage) -> None:
    written = CODEC.write(message)
    quick = WrittenForm(MessageLimits()).read(written)
    if isinstance(message, DataMessage | CallMessage | ResultMessage) and not re.search(
        rb"/>|&|base64=", written
    ):
        assert quick is not None
    if quick is not None:
        assert repr(quick) == repr(CODEC._read_any(written))


@pytest.mark.parametrize("time", [0.0, -1.5e300, math.inf, -math.inf, math.nan])
def test_every_time_is_read_without_the_parser(time: float) -> None:
    quick = WrittenForm(MessageLimits()).read(CODEC.write(DataMessage(0, 1, {}, time)))
    assert isinstance(quick, DataMessage)
    assert repr(quick.time) == repr(time)


@given(messages, st.data())
def test_what_is_read_without_the_parser_is_what_the_parser_reads(
    message: WireMessage, data: st.DataObject
) -> None:
    written = bytearray(CODEC.write(message))
    pieces = (b"<", b">", b'"', b" ", b"&", b"1", b"]]>", b"\r", b"\x01", b"</list>", b"<list>")
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(written) - 1))
        end = place + data.draw(st.integers(0, 12))
        written[place:end] = data.draw(st.sampled_from(pieces))
    quick = WrittenForm(MessageLimits()).read(bytes(written))
    if quick is not None:
        assert repr(quick) == repr(CODEC._read_any(bytes(written)))


@pytest.mark.parametrize(
    "written",
    [
        b'<data id="1" seq="0"><string name="a">one\r\ntwo</string></data>',
        b'<data id="1" seq="0"><string name="a">\x01</string></data>',
        b'<data id="1" seq="4294967296"></data>',
        b'<data id="4294967296" seq="0"></data>',
        b'<data id="0" seq="0"></data>',
        b'<data id="1" seq="0"><boolean name="a">yes</boolean></data>',
        b'<data id="1" seq="0"><list name="a"></struct></data>',
        b'<data id="1" seq="0"></list></data>',
        b'<data id="1" seq="0"><list name="a"></data>',
        b'<data id="1" seq="0"></data> ',
        b'<data id="1" seq="0" api="a"></data>',
        b'<call id="1" seq="0"></call>',
        b'<result id="1" seq="0" time="1.0"></result>',
        b'<data id="1" seq="0" time="1-1"></data>',
        b'<data id="1" seq="0"><list name="a">' + b"<list>" * 31 + b"</list>" * 32 + b"</data>",
        b'<data id="1" seq="0"><list name="a">' + b"<list></list>" * 40 + b"</list></data>",
    ],
)
def test_what_only_the_parser_may_judge_is_left_to_it(written: bytes) -> None:
    assert WrittenForm(MessageLimits(elements=40)).read(written) is None


@given(st.binary(max_size=200))
def test_garbage_is_refused(data: bytes) -> None:
    with pytest.raises(WireError):
        CODEC.read(data)


def test_nonfinite_numbers_cross() -> None:
    read = CODEC.read(
        CODEC.write(DataMessage(0, 1, {"a": math.nan, "b": math.inf, "c": -math.inf}))
    )
    assert isinstance(read, DataMessage)
    assert math.isnan(read.values["a"])
    assert (read.values["b"], read.values["c"]) == (math.inf, -math.inf)


def test_the_page_shows_a_valid_catalogue() -> None:
    shown = re.search(r"```xml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert shown
    message = CODEC.read(shown[1].strip().encode())
    assert isinstance(message, CatalogueMessage)
    XSD.assertValid(etree.fromstring(CODEC.write(message)))


BOMB = (
    b'<!DOCTYPE b [<!ENTITY a "aaaaaaaaaa"><!ENTITY c "&a;&a;&a;&a;">]>'
    b'<error id="0" seq="0" code="failed">&c;</error>'
)
OPEN = b'<data id="1" seq="0">'


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (BOMB, "document type"),
        (b'<!DOCTYPE x SYSTEM "file:///etc/passwd"><heartbeat seq="0"/>', "document type"),
        (b'<error id="0" seq="0" code="failed">&undefined;</error>', "no XML"),
        (OPEN + b"<struct>" * 40, "deep"),
        (OPEN + b"<list>" * 100_000, "deep"),
        (b'<heartbeat seq="' + b"0" * 2000 + b'"/>', "octets"),
        (b"<heartbeat " + b" ".join(b'a%d="1"' % n for n in range(20)) + b"/>", "attributes"),
        (OPEN + b"<boolean/>" * 100_001, "elements"),
        (b"<?php x ?>" + b'<heartbeat seq="0"/>', "processing"),
        (b'<?xml version="1.0" encoding="UTF-16"?><heartbeat seq="0"/>', "encoding"),
        ('<heartbeat seq="0"/>'.encode("utf-16"), "UTF-8"),
        (b"\xff\xfe", "UTF-8"),
        (b" " * 2_000_000, "octets"),
        (b'<heartbeat seq="-1"/>', "seq"),
        (b'<heartbeat seq="4294967296"/>', "seq"),
        (b'<heartbeat seq="0" id="1"/>', "attribute"),
        (b'<heartbeat seq="0" more="1"/>', "attribute"),
        (b'<close seq="0" id="0"/>', "id"),
        (b'<gossip seq="0"/>', "gossip"),
        (OPEN + b'<null name="a"/></data>', "null"),
        (OPEN + b"<integer>1</integer></data>", "name"),
        (OPEN + b'<integer name="1a">1</integer></data>', "name"),
        (OPEN + b'<integer name="a">1</integer><integer name="a">2</integer></data>', "twice"),
        (OPEN + b'<integer name="a"> 1</integer></data>', "whole number"),
        (OPEN + b'<integer name="a">' + b"9" * 21 + b"</integer></data>", "whole number"),
        (OPEN + b'<number name="a">1e999</number></data>', "too large"),
        (OPEN + b'<number name="a">nan</number></data>', "decimal"),
        (OPEN + b'<boolean name="a">1</boolean></data>', "true or false"),
        (OPEN + b'<octets name="a">a</octets></data>', "base64"),
        (OPEN + b'<string name="a" base64="false">YQ==</string></data>', "unexpected"),
        (OPEN + b'<string name="a" base64="true">/w==</string></data>', "not UTF-8"),
        (OPEN + b'<integer name="a" base64="true">1</integer></data>', "unexpected"),
        (OPEN + b'<string name="a"><b/></string></data>', "text only"),
        (OPEN + b"hello</data>", "text between"),
        (OPEN + b'<list name="a"><integer name="b">1</integer></list></data>', "unexpected"),
        (b'<open id="1" seq="0" api="a" direction="up"/>', "direction"),
        (b'<error id="1" seq="0" code="oops"/>', "code"),
        (b'<catalogue id="1" seq="0" profile="2" device="x"/>', "profile 2"),
        (b'<catalogue id="1" seq="0" profile="1" device="x" heartbeat="0"/>', "heartbeat"),
    ],
)
def test_what_is_dangerous_or_wrong_is_refused_with_its_reason(data: bytes, said: str) -> None:
    with pytest.raises(WireError, match=said):
        CODEC.read(data)


def api(inside: str) -> bytes:
    top = '<catalogue id="1" seq="0" profile="1" device="x">'
    return f"{top}{inside}</catalogue>".encode()


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ('<api name="a" kind="topic"/>', "kind"),
        ('<api name="a" kind="flow"/>', "neither"),
        ('<api name="a" kind="service"/><api name="a" kind="service"/>', "twice"),
        ('<api name="a" kind="service" period="1"/>', "period"),
        ('<api name="a" kind="service"><output/><input/></api>', "order"),
        ('<api name="a" kind="service"><input><thing name="x"/></input></api>', "thing"),
        ('<api name="a" kind="service"><input><boolean/></input></api>', "name"),
        (
            (
                '<api name="a" kind="service"><input>'
                '<integer name="x" minimum="2" maximum="1"/></input></api>'
            ),
            "above",
        ),
        (
            '<api name="a" kind="service"><input><number name="x" maximum="INF"/></input></api>',
            "finite",
        ),
        ('<api name="a" kind="service"><input><list name="x"/></input></api>', "one field"),
        ('<api name="a" kind="service"><input><boolean name="x" unit="s"/></input></api>', "unit"),
    ],
)
def test_a_wrong_catalogue_is_refused_with_its_place(inside: str, said: str) -> None:
    with pytest.raises(WireError, match=said):
        CODEC.read(api(inside))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"a": None}, "a: a NoneType"),
        ({"a": {"b": [1, "x\udfff"]}}, r"a\.b\[1\]: character 1 of the text is half"),
        ({"a b": 1}, "name"),
        ({"a": 10**30}, "20 digits"),
        ({"a": object()}, "object"),
    ],
)
def test_what_cannot_be_sent_is_refused_with_its_path(value: dict[str, object], said: str) -> None:
    with pytest.raises(WireError, match=said):
        CODEC.write(CallMessage(0, 1, "x", value))


def test_a_value_that_holds_itself_is_refused() -> None:
    loop: dict[str, object] = {}
    loop["again"] = loop
    with pytest.raises(WireError, match="deep"):
        CODEC.write(CallMessage(0, 1, "x", loop))


def test_limits_are_the_callers() -> None:
    small = XmlCodec(MessageLimits(octets=100))
    with pytest.raises(WireError, match="100 are allowed"):
        small.write(CallMessage(0, 1, "x", {"text": "a" * 100}))
    assert small.read(b'<heartbeat seq="7"/>') == HeartbeatMessage(7)


def test_a_catalogue_without_end_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for endless in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ConfigurationError, match="not a regular file"):
            load_catalogue(endless)
    large = tmp_path / "large.xml"
    with large.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(ConfigurationError, match="16,777,216 are allowed"):
        load_catalogue(large)
