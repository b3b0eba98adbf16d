"""Strategies for messages of any shape, and the comparison that goes with them."""

from __future__ import annotations

import math
from array import array
from typing import Any

import numpy as np
from hypothesis import strategies as st
from uoarm_ros2._conversion import reader
from uoarm_ros2._types import (
    ArrayType,
    RecordType,
    ScalarType,
    Shape,
    StringType,
    integer_range,
    shape_of,
)

MESSAGE_TYPES = [
    f"test_msgs/msg/{name}"
    for name in (
        "Arrays",
        "BasicTypes",
        "BoundedPlainSequences",
        "BoundedSequences",
        "Builtins",
        "Constants",
        "Defaults",
        "Empty",
        "Nested",
        "Strings",
        "UnboundedSequences",
        "WStrings",
    )
]
_CHARACTERS = st.characters(exclude_categories=["Cs"], exclude_characters="\0")


def default_of(native: type) -> Any:
    """A message with every field as ROS 2 itself makes it."""
    return reader(shape_of(native, native.__name__))(native())


def attributes(value: Any) -> Any:
    """A native object as a message, by what ROS 2 generated alone."""
    if hasattr(value, "get_fields_and_field_types"):
        return {
            name: attributes(getattr(value, name)) for name in value.get_fields_and_field_types()
        }
    if isinstance(value, list):
        return [attributes(item) for item in value]
    return value[0] if isinstance(value, bytes) else value


@st.composite
def messages_of(draw: st.DrawFn, record: RecordType) -> Any:
    """Messages of a type, with the boundaries of every scalar among them.

    Within one message all elements of one nested type are equal: types nested in types nested in
    arrays would otherwise draw thousands of values.
    """
    drawn: dict[str, Any] = {}

    def value(shape: Shape) -> Any:
        if isinstance(shape, RecordType):
            if shape.name not in drawn:
                drawn[shape.name] = {field.name: value(field.shape) for field in shape.fields}
            return drawn[shape.name]
        if not isinstance(shape, ArrayType):
            return draw(_plain(shape))
        least = shape.size if shape.fixed and shape.size is not None else 0
        most = least if shape.fixed else min(shape.size or 3, 3)
        if isinstance(shape.element, RecordType):
            return [value(shape.element)] * draw(st.integers(least, most))
        return draw(st.lists(_plain(shape.element), min_size=least, max_size=most))

    return value(record)


def _plain(shape: ScalarType | StringType) -> st.SearchStrategy[Any]:
    if isinstance(shape, ScalarType):
        return _scalars(shape)
    bound = 20 if shape.bound is None else shape.bound // (2 if shape.wide else 4)
    return st.text(_CHARACTERS, max_size=bound)


def _scalars(scalar: ScalarType) -> st.SearchStrategy[Any]:
    if scalar.name == "bool":
        return st.booleans()
    limits = integer_range(scalar.name)
    if limits is not None:
        return st.integers(*limits) | st.sampled_from(limits)
    return st.floats(width=32 if scalar.name == "float32" else 64)


def plain(value: Any) -> Any:
    """The same message with lists in the place of buffers."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, memoryview | array | np.ndarray):
        return value.tolist()
    if isinstance(value, bytes):
        return list(value)
    return [plain(item) for item in value] if isinstance(value, list) else value


def same(got: Any, wanted: Any) -> bool:
    """Whether two messages are equal by value: buffers as lists, NaN as itself."""
    if isinstance(wanted, dict):
        return set(got) == set(wanted) and all(same(got[key], wanted[key]) for key in wanted)
    if isinstance(got, memoryview | array | np.ndarray):
        got = list(got.tolist())
    elif isinstance(got, bytes):
        got = list(got)
    if isinstance(wanted, list):
        return len(got) == len(wanted) and all(map(same, got, wanted))
    if isinstance(wanted, float):
        return (math.isnan(got) and math.isnan(wanted)) or got == wanted
    return type(got) is type(wanted) and bool(got == wanted)
