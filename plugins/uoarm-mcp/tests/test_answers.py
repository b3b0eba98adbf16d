"""What tools answer is what they say that they answer: clients check it, after it was done."""

from __future__ import annotations

import asyncio
import io
import math
import threading
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from unittest.mock import Mock

import numpy as np
import orjson
import pytest
from agents import Agents
from jsonschema import Draft202012Validator
from mcp_types import CallToolResult
from tests.hostile import misbehaviour  # type: ignore[import-not-found]
from uoarm_mcp._schemas import output_schema, read_output
from uoarm_mcp._values import (
    KeptValues,
    _Summary,
    is_picture,
    picture_of,
    render,
    succeeded,
)

from uoarm.errors import UsageError
from uoarm.model import MessageStructure
from uoarm.server.front_end import TEXT_FORM, Account, Charge, MemoryUse
from uoarm.testing import patience

NUMBER = {"type": "number"}
ANSWERS: list[tuple[Any, Any]] = [
    (NUMBER, math.nan),
    (NUMBER, -math.inf),
    (NUMBER, 2**60),
    ({"type": "number", "minimum": 0, "maximum": 1, "x-nonfinite": True}, math.inf),
    ({"type": ["number", "null"]}, math.nan),
    ({"type": ["integer", "null"]}, 2**60),
    ({"type": "integer", "maximum": 2**70}, 2**70),
    ({"type": "integer", "minimum": 0, "maximum": 2**64 - 1}, 2**64 - 1),
    ({"enum": [1, 2**60]}, 2**60),
    ({"type": "integer", "const": 2**60}, 2**60),
    ({"type": "array", "items": {"x-octets": True, "type": "array"}}, [b"ab"]),
    (
        {"properties": {"a": {"$ref": "#/definitions/n"}}, "definitions": {"n": NUMBER}},
        {"a": 2**60},
    ),
    ({"properties": {"a": {"$ref": "#/$defs/n"}}, "$defs": {"n": NUMBER}}, {"a": math.inf}),
    ({"properties": {"a": NUMBER, "b": {"$ref": "#/properties/a"}}}, {"b": math.nan}),
    ({"$id": "http://x/y", "properties": {"a": {"$ref": "#/$defs/n"}}, "$defs": {"n": NUMBER}}, {}),
    (
        {"type": "object", "properties": {"kids": {"items": {"$ref": "#"}}}},
        {"kids": [{"kids": []}]},
    ),
    ({"additionalProperties": {"anyOf": [NUMBER, {"type": "null"}]}}, {"a": math.nan}),
]


@pytest.mark.parametrize(("schema", "message"), ANSWERS)
def test_every_message_of_a_structure_is_an_answer(schema: Any, message: Any) -> None:
    structure, said = MessageStructure(schema), orjson.loads(TEXT_FORM.write(message))
    Draft202012Validator(output_schema(structure)).validate({"state": "x", "result": said})
    Draft202012Validator(read_output(structure)).validate({"messages": [said]})


@pytest.mark.parametrize(
    ("schema", "said"),
    [
        (NUMBER, "many"),
        ({"type": "integer", "minimum": 0, "maximum": 9}, "3"),
        ({"type": "object", "properties": {"kids": {"items": {"$ref": "#"}}}}, {"kids": [1]}),
        ({"enum": [1, 2**60]}, 2),
    ],
)
def test_no_other_is(schema: Any, said: Any) -> None:
    validator = Draft202012Validator(output_schema(MessageStructure(schema)))
    assert not validator.is_valid({"state": "x", "result": said})


def test_what_a_value_does_itself_is_a_refusal() -> None:
    assert not misbehaviour(render)
    assert not misbehaviour(lambda value: render({"x": [value]}))
    assert not misbehaviour(lambda value: render({"x": [value] * 20}))


@pytest.mark.parametrize("name", ["data", "width", "height", "encoding"])
def test_a_picture_is_shown_or_refused(name: str) -> None:
    picture = {"data": b"abc", "width": 1, "height": 1}
    assert picture_of(picture).data
    assert not misbehaviour(lambda value: picture_of({**picture, name: value}), UsageError)


def test_the_client_takes_them(agents: Agents) -> None:
    result: CallToolResult = agents.call("odd", {"number": 1})
    answer: Any = result.structured_content
    inner = [{"number": "-Infinity"}]
    assert answer["result"] == {"number": "NaN", "most": str(2**70), "inner": inner}


def test_numbers_of_a_summary_are_as_in_the_message() -> None:
    rendered = render({"n": math.nan, "all": [2**70, *[1] * 20_000]})
    assert rendered.value["n"] == "NaN"
    assert rendered.value["all"]["first"] == [str(2**70), 1, 1]
    assert succeeded({"summary": rendered.value}).structured_content


def test_an_array_is_summarised_as_the_list_of_its_numbers() -> None:
    for numbers in ([math.nan, math.inf, 1.5, -2.0, *[0.25] * 20_000], [math.nan] * 20_000):
        array = render({"all": np.array(numbers)}).value["all"]
        assert array.pop("shape") == [len(numbers)]
        assert array == render({"all": numbers}).value["all"]
    huge = render({"all": np.full(20_000, 1e308)}).value["all"]
    assert (huge["least"], "mean" in huge) == (1e308, False)


def test_of_a_map_no_list_is_made_for_its_summary() -> None:
    cells = np.zeros((2_000, 1_000), np.int8)
    tracemalloc.start()
    try:
        summary = _Summary().of({"data": cells}, 2)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert (summary["data"]["shape"], summary["data"]["greatest"]) == ([2_000, 1_000], 0)
    assert most < 4 * cells.nbytes


def test_of_a_message_with_octets_the_rest_can_be_read_too() -> None:
    message = {"data": b"ab", "values": [1.5] * 20_000}
    rendered = render(message)
    kinds = {
        link.mime_type: left for link, left in zip(rendered.links, rendered.left_out, strict=True)
    }
    assert kinds["application/octet-stream"] == b"ab"
    assert len(orjson.loads(kinds["application/json"])["values"]) == 20_000
    assert [link.mime_type for link in render({"data": bytes(2_000)}).links] == [
        "application/octet-stream"
    ]


def test_a_link_is_to_something_however_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uoarm_mcp._values._MOST_OCTETS", 10_000)
    kept = KeptValues(Mock())
    first, second = (kept.keep(render({"data": bytes(20_000)})) for _ in range(2))
    assert kept.find(second.links[0].uri) is not None
    assert kept.find(first.links[0].uri) is None


def test_what_is_kept_is_counted_in_the_loop(
    agents: Agents, monkeypatch: pytest.MonkeyPatch
) -> None:
    charge = Account.charge

    def charged(account: Account, kind: MemoryUse, octets: int) -> Charge:
        asyncio.get_running_loop()  # raises in another thread
        return charge(account, kind, octets)

    monkeypatch.setattr(Account, "charge", charged)
    assert "summary" in agents.facts("many", {"count": 100_000})


@pytest.mark.parametrize("shape", [(640 * 480 * 3,), (480, 640, 3)])
def test_pixels_in_an_array_are_a_picture(shape: tuple[int, ...]) -> None:
    pytest.importorskip("PIL")
    message = {"width": 640, "height": 480, "data": np.zeros(shape, np.uint8)}
    assert is_picture(message)
    assert picture_of(message).mime_type == "image/jpeg"
    data = render(message).value["data"]
    assert ("octets" in data) is (len(shape) == 1), "a row of uint8 is octets in every form"


@pytest.mark.parametrize("kind", ["PNG", "EPS", "TIFF", "PPM"])
def test_a_packed_picture_is_shown_in_formats_of_cameras(kind: str) -> None:
    images = pytest.importorskip("PIL.Image")
    written = io.BytesIO()
    images.new("RGB", (8, 8)).save(written, kind)
    message = {"data": written.getvalue()}
    if kind == "PNG":
        assert picture_of(message).mime_type == "image/jpeg"
    else:
        with pytest.raises(UsageError, match="cannot identify image file"):
            picture_of(message)


def damaged() -> bytes:
    """Return a PNG whose second half is a chunk of no name."""
    images = pytest.importorskip("PIL.Image")
    written = io.BytesIO()
    images.effect_noise((40, 30), 50).save(written, "PNG")
    octets = written.getvalue()
    first = octets.index(b"IDAT") - 4
    data = octets[first + 8 : first + 500]
    return octets[:first] + len(data).to_bytes(4, "big") + b"IDAT" + data + bytes(4) + b"\x01" * 50


@pytest.mark.parametrize("fault", ["step", "chunk"])
def test_a_picture_that_is_damaged_is_none(fault: str) -> None:
    pytest.importorskip("PIL")
    message = {"width": 4, "height": 4, "step": 2**70, "data": bytes(48)}
    if fault == "chunk":
        message = {"data": damaged()}
    with pytest.raises(UsageError, match="it is no picture that can be shown: "):
        picture_of(message)


def test_one_picture_is_unpacked_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    images = pytest.importorskip("PIL.Image")
    written = io.BytesIO()
    images.new("RGB", (8, 8)).save(written, "PNG")
    lock, opened = threading.Lock(), images.open
    second_came, under_way, most = threading.Event(), [0], [0]

    class Watched:
        def __enter__(self) -> None:
            if not lock.acquire(blocking=False):
                second_came.set()
                lock.acquire()

        def __exit__(self, *_: object) -> None:
            lock.release()

    def watched_open(*arguments: Any, **options: Any) -> Any:
        under_way[0] += 1
        most[0] = max(most[0], under_way[0])
        if most[0] > 1:
            second_came.set()
        assert second_came.wait(patience())
        made = opened(*arguments, **options)
        under_way[0] -= 1
        return made

    monkeypatch.setattr("uoarm_mcp._values._unpacking", Watched())
    monkeypatch.setattr(images, "open", watched_open)
    message = {"data": written.getvalue()}
    with ThreadPoolExecutor(2) as threads:
        answers = [threads.submit(picture_of, message) for _ in range(2)]
        assert [answer.result(patience()).mime_type for answer in answers] == ["image/jpeg"] * 2
    assert most == [1]
