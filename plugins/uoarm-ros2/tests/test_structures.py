"""Structures by introspection: exact, closed, annotated, and true of every message."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from messages import MESSAGE_TYPES, messages_of
from uoarm_ros2._types import (
    describe_action,
    describe_service,
    import_type,
    part_structure,
    shape_of,
    structure_of,
)

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import MessageStructure
from uoarm.schema import check


def message_structure(name: str) -> MessageStructure:
    return structure_of(shape_of(import_type(name), name))


def schema(name: str) -> Any:
    found = message_structure(name).schema
    assert isinstance(found, Mapping)
    return found


@pytest.mark.parametrize("name", MESSAGE_TYPES)
@settings(suppress_health_check=[HealthCheck.data_too_large, HealthCheck.too_slow], max_examples=20)
@given(data=st.data())
def test_every_message_matches_its_structure(name: str, data: st.DataObject) -> None:
    message = data.draw(messages_of(shape_of(import_type(name), name)))
    finite = _without_nonfinite(message)
    assert Draft202012Validator(schema(name)).is_valid(finite)


@pytest.mark.parametrize("name", [*MESSAGE_TYPES, "test_msgs/msg/MultiNested"])
def test_a_structure_is_a_schema(name: str) -> None:
    Draft202012Validator.check_schema(schema(name))
    assert message_structure(name).native_type == name
    assert message_structure(name) == message_structure(name)


@pytest.mark.parametrize("name", [*MESSAGE_TYPES, "test_msgs/msg/MultiNested"])
def test_a_type_fits_itself(name: str) -> None:
    assert check(schema(name), schema(name)).compatible


def test_a_type_that_says_more_does_not_fit() -> None:
    string, header = schema("std_msgs/msg/String"), schema("std_msgs/msg/Header")
    assert not check(string, header).compatible
    assert not check(header, string).compatible


def test_integers_have_their_exact_ranges() -> None:
    fields = schema("test_msgs/msg/BasicTypes")["properties"]
    assert (fields["int64_value"]["minimum"], fields["int64_value"]["maximum"]) == (
        -(2**63),
        2**63 - 1,
    )
    assert (fields["uint64_value"]["minimum"], fields["uint64_value"]["maximum"]) == (0, 2**64 - 1)
    assert (fields["byte_value"]["maximum"], fields["char_value"]["maximum"]) == (255, 255)
    assert fields["float32_value"]["maximum"] == int(3.4028234663852886e38)
    assert fields["float64_value"] == {
        "type": "number",
        "x-native-type": "float64",
        "x-nonfinite": True,
    }
    assert fields["bool_value"] == {"type": "boolean"}


def test_objects_are_closed_and_whole() -> None:
    found = schema("geometry_msgs/msg/PoseStamped")
    pose = found["properties"]["pose"]
    assert found["additionalProperties"] is pose["additionalProperties"] is False
    assert pose["required"] == ["position", "orientation"]
    assert pose["x-native-type"] == pose["x-type"] == "geometry_msgs/msg/Pose"


def test_arrays_have_their_bounds_and_octets_their_mark() -> None:
    bounded = schema("test_msgs/msg/BoundedSequences")["properties"]
    assert (bounded["int32_values"]["maxItems"], "minItems" in bounded["int32_values"]) == (
        3,
        False,
    )
    fixed = schema("test_msgs/msg/Arrays")["properties"]
    assert (fixed["int32_values"]["minItems"], fixed["int32_values"]["maxItems"]) == (3, 3)
    free = schema("test_msgs/msg/UnboundedSequences")["properties"]
    assert "maxItems" not in free["int32_values"]
    marked = {name for name, field in free.items() if field.get("x-octets")}
    assert {"uint8_values", "byte_values", "char_values"} <= marked
    assert "int8_values" not in marked


def test_texts_have_their_bounds() -> None:
    texts = schema("test_msgs/msg/Strings")["properties"]
    assert texts["bounded_string_value"]["maxLength"] == 22
    assert texts["bounded_string_value"]["x-max-utf8"] == 22
    assert "maxLength" not in texts["string_value"]
    assert (
        schema("test_msgs/msg/WStrings")["properties"]["wstring_value"]["x-native-type"]
        == "wstring"
    )


def test_structures_have_defaults_and_constants() -> None:
    defaults = schema("test_msgs/msg/Defaults")["properties"]
    assert (defaults["int8_value"]["default"], defaults["byte_value"]["default"]) == (-50, 50)
    assert defaults["bool_value"]["default"] is True
    constants = schema("test_msgs/msg/Constants")["x-constants"]
    assert (constants["INT64_CONST"], constants["BYTE_CONST"]) == (-40000000, 50)


def test_structures_have_units_where_they_are_known() -> None:
    twist = schema("geometry_msgs/msg/Twist")["properties"]
    assert twist["linear"]["properties"]["x"]["x-unit"] == "m/s"
    assert twist["angular"]["properties"]["z"]["x-unit"] == "rad/s"
    scan = schema("sensor_msgs/msg/LaserScan")["properties"]
    assert scan["ranges"]["items"]["x-unit"] == "m"
    assert scan["header"]["properties"]["stamp"]["properties"]["nanosec"]["x-unit"] == "ns"
    assert "x-unit" not in scan["intensities"]["items"]


def test_services_and_actions_have_structures_too() -> None:
    service = describe_service("test_msgs/srv/Arrays")
    assert service.request is not None
    assert service.reply is not None
    assert service.request.native_type == "test_msgs/srv/Arrays_Request"
    action = describe_action("test_msgs/action/NestedMessage")
    assert action.request is not None
    assert action.reply is not None
    for part in ("goal", "cancel", "feedback", "result", "status"):
        found = part_structure("test_msgs/action/Fibonacci", part)
        assert isinstance(found.schema, Mapping)
        Draft202012Validator.check_schema(found.schema)


def test_a_class_that_was_not_generated_is_refused() -> None:
    with pytest.raises(BridgeError, match="is not a generated ROS 2 type") as caught:
        shape_of(int, "builtins/msg/Int")
    assert caught.value.reason is FailureReason.BAD_ENDPOINT


def _without_nonfinite(value: Any) -> Any:
    """NaN and infinities stand outside JSON; `x-nonfinite` says that they may come."""
    if isinstance(value, dict):
        return {name: _without_nonfinite(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_without_nonfinite(item) for item in value]
    return 0.0 if isinstance(value, float) and not math.isfinite(value) else value
