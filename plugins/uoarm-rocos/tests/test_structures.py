"""Structures say exactly what fits; generated classes carry the same messages."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from array import array
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from strategies import catalogues, fitting, members, values
from tests.hostile import misbehaviour  # type: ignore[import-not-found]
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    BooleanField,
    DeviceCatalogue,
    Direction,
    Fields,
    IntegerField,
    ListField,
    NamedField,
    NumberField,
    OctetsField,
    StringField,
    StructField,
    differences,
)
from uoarm_rocos._framing import WireError
from uoarm_rocos._structure import api_classes, describe, fit, fit_given, structure_of
from uoarm_rocos._values import read_values, write_values

from uoarm.errors import UoarmError
from uoarm.testing import same

POINT: Fields = {"x": NamedField(NumberField(unit="m")), "y": NamedField(NumberField(unit="m"))}
FIELDS: Fields = {
    "on": NamedField(BooleanField()),
    "spo2": NamedField(IntegerField(0, 100, "%"), required=False),
    "rate": NamedField(NumberField(0.5, 2.0)),
    "any": NamedField(NumberField(nonfinite=True), required=False),
    "mode": NamedField(StringField(("slow", "fast"))),
    "text": NamedField(StringField(max_length=5), required=False),
    "image": NamedField(OctetsField(4), required=False),
    "pose": NamedField(StructField(POINT), required=False),
    "path": NamedField(ListField(StructField(POINT), 1, 2), required=False),
    "levels": NamedField(ListField(IntegerField(-1, 1)), required=False),
}
GOOD: dict[str, Any] = {"on": True, "rate": 1.0, "mode": "slow"}


def plain(value: Any) -> Any:
    """Octets as the structure has them: an array of numbers."""
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list) else value


def test_ranges_units_and_enums_are_exact() -> None:
    schema: Any = structure_of(FIELDS).schema
    properties = schema["properties"]
    assert properties["spo2"] == {
        "type": "integer", "minimum": 0, "maximum": 100, "x-unit": "%"
    }  # fmt: skip
    assert properties["rate"] == {"type": "number", "minimum": 0.5, "maximum": 2.0}
    assert properties["any"] == {"type": "number", "x-nonfinite": True}
    assert properties["mode"]["enum"] == ["slow", "fast"]
    assert properties["image"]["x-octets"] is True
    assert properties["image"]["maxItems"] == 4
    assert (properties["path"]["minItems"], properties["path"]["maxItems"]) == (1, 2)
    assert schema["required"] == ["on", "rate", "mode"]
    assert schema["additionalProperties"] is False


@given(members, st.data())
@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
def test_fit_and_structure_agree_on_what_the_structure_allows(
    fields: Fields, data: st.DataObject
) -> None:
    schema = structure_of(fields).schema
    message = data.draw(values | fitting(fields))
    valid = Draft202012Validator(schema).is_valid(plain(message))
    try:
        fitted = fit(fields, message, "m")
    except WireError:
        assert not valid
        return
    assert valid
    assert Draft202012Validator(schema).is_valid(plain(fitted))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"on": 1}, r"m\.on: expected true or false, got 1 \(int\)"),
        ({"spo2": 101}, r"m\.spo2: expected 0 to 100"),
        ({"spo2": True}, "integer"),
        ({"spo2": 1.5}, "integer"),
        ({"spo2": "1"}, "integer"),
        ({"rate": 2.1}, r"m\.rate: expected 0\.5 to 2"),
        ({"rate": float("nan")}, "finite"),
        ({"rate": "1"}, "a number"),
        ({"any": 10**400}, "64-bit"),
        ({"mode": "medium"}, "one of slow, fast"),
        ({"text": "123456"}, "5 characters"),
        ({"text": None}, "text"),
        ({"image": b"12345"}, "4 octets"),
        ({"image": [256]}, "octets"),
        ({"image": 3}, "octets"),
        ({"image": np.int64(3)}, "octets"),
        ({"image": {}}, "octets"),
        ({"pose": {"x": 1}}, r"m\.pose: the field 'y' is missing"),
        ({"path": []}, "1 to 2 items"),
        ({"path": [{"x": 0, "y": 0}, {"x": 0}]}, r"m\.path\[1\]: the field 'y'"),
        ({"levels": [0, 2]}, r"m\.levels\[1\]: expected -1 to 1"),
        ({"levels": "no"}, "a list"),
        ({"more": 1}, "no field 'more'"),
    ],
)
def test_what_does_not_fit_is_named(change: dict[str, object], said: str) -> None:
    with pytest.raises(WireError, match=said):
        fit(FIELDS, {**GOOD, **change}, "m")


@pytest.mark.parametrize("name", ["on", "spo2", "any", "text", "image", "pose", "path", "levels"])
def test_what_a_value_does_itself_is_a_refusal(name: str) -> None:
    def write(value: Any) -> None:
        fitted = fit_given(FIELDS, {**GOOD, name: value}, "m")
        assert same(read_values(ET.fromstring(f"<x>{write_values(fitted)}</x>")), fitted)

    assert not misbehaviour(write, UoarmError)


def test_what_is_written_without_a_catalogue_refuses_it_too() -> None:
    assert not misbehaviour(lambda value: write_values({"x": [value]}), WireError)


def test_octets_fit_a_list_of_numbers_and_no_other() -> None:
    levels = {"levels": NamedField(ListField(IntegerField(0, 3)))}
    assert fit(levels, {"levels": b"\x01\x02"}, "m") == {"levels": [1, 2]}
    with pytest.raises(WireError, match=r"m\.levels\[1\]: expected 0 to 3"):
        fit(levels, {"levels": b"\x01\x04"}, "m")
    with pytest.raises(WireError, match="true or false"):
        fit({"on": NamedField(ListField(BooleanField()))}, {"on": b"\x01"}, "m")


def test_buffers_and_numpy_fit() -> None:
    given_: dict[str, Any] = {
        "on": np.bool_(True),
        "rate": np.float32(1.5),
        "mode": "fast",
        "spo2": np.int64(7),
        "image": memoryview(b"abc"),
        "levels": array("b", [1, 0, -1]),
    }
    fitted = fit(FIELDS, given_, "m")
    assert fitted == {
        "on": True, "rate": 1.5, "mode": "fast", "spo2": 7, "image": b"abc", "levels": [1, 0, -1]
    }  # fmt: skip
    assert {type(item) for item in fitted.values()} == {bool, float, str, int, bytes, list}
    image = {"image": NamedField(OctetsField())}
    for kind in ("u1", "i1", "<i8", ">u2"):  # the numbers of an array, and not its memory
        assert fit(image, {"image": np.array([1, 127], kind)}, "m") == {"image": b"\x01\x7f"}
    for wrong in (np.array([-1], "i1"), np.array([256]), np.array([1.5])):
        with pytest.raises(WireError, match="expected octets"):
            fit(image, {"image": wrong}, "m")


def test_one_class_for_each_api() -> None:
    catalogue = DeviceCatalogue(
        "d", {"go-to": Api("go-to", ApiKind.SERVICE, FIELDS, POINT, text="Go.")}
    )
    made: Any = api_classes(catalogue)["go-to"]
    assert (made.__name__, made.__doc__) == ("Go_to", "Go.")
    request = made.Input(on=True, rate=1, mode="slow", path=[made.Input.Path(x=1, y=2)])
    message = request.message()
    assert message == {"on": True, "rate": 1.0, "mode": "slow", "path": [{"x": 1.0, "y": 2.0}]}
    again = made.Input.of(message)
    assert (again, again.path[0].y, again.pose) == (request, 2.0, None)
    with pytest.raises(WireError, match=r"Go_to\.Input\.rate"):
        made.Input(on=True, rate=9, mode="slow").message()
    with pytest.raises(TypeError):
        made.Input(on=True)


@given(catalogues, st.data())
@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
def test_classes_carry_every_message(catalogue: DeviceCatalogue, data: st.DataObject) -> None:
    for api in catalogue.apis.values():
        message = data.draw(fitting(api.output))
        output: Any = api_classes(catalogue)[api.name].Output
        assert output.of(message).message() == fit(api.output, message, "m")


def test_descriptions_follow_the_kind() -> None:
    flow = Api("f", ApiKind.FLOW, FIELDS, POINT)
    assert describe(flow, Direction.INPUT).message == structure_of(FIELDS, "f.input")
    assert describe(flow, Direction.OUTPUT).message == structure_of(POINT, "f.output")
    service = describe(Api("s", ApiKind.SERVICE, FIELDS, POINT), None)
    assert (service.request, service.reply) == (
        structure_of(FIELDS, "s.input"),
        structure_of(POINT, "s.output"),
    )


def test_differences_name_what_changed() -> None:
    one = Api("a", ApiKind.FLOW, {}, POINT, 0.1, "text")
    two = Api("a", ApiKind.FLOW, {}, {**POINT, "x": NamedField(BooleanField())}, 0.2)
    before = DeviceCatalogue("d", {"a": one, "b": one, "c": one})
    after = DeviceCatalogue(
        "d", {"a": two, "c": Api("c", ApiKind.FLOW, {}, POINT, 0.1, "new"), "e": one}
    )
    found = differences(before, after)
    assert found.keys() == {"a", "b", "e"}
    assert "period was 0.1, is 0.2" in found["a"]
    assert "output.x was" in found["a"]
    assert (found["b"], found["e"]) == ("API 'b' is gone", "API 'e' is new")
