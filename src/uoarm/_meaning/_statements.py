"""What two sides state of one value, compared: its type, constants, words and unit.

The walk over two structures is another module's; here is what it finds, and how it is said.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, TypeAlias

from attrs import define, field, frozen

from uoarm._meaning._units import Conversion, UnitError, conversion

Path: TypeAlias = "tuple[str, ...]"
Said: TypeAlias = "Mapping[str, Any]"

_PLAIN = ("Byte", "Char", "Float32", "Float64", "Int8", "Int16", "Int32", "Int64", "UInt8",
          "UInt16", "UInt32", "UInt64")  # fmt: skip
# Each with where it says so.
_BUILT_IN: tuple[frozenset[str], ...] = (
    # Their definitions: examples without a meaning, "create your own semantically meaningful one".
    *(
        frozenset(f"{package}/msg/{name}" for package in ("std_msgs", "example_interfaces")
                  for name in names)
        for names in (_PLAIN, ("Bool",), ("String",), ("Empty",),
                      tuple(f"{name}MultiArray" for name in _PLAIN))
    ),
    # Point32.msg: "a point in free space (with 32 bits of precision)"; the foxglove schemas name
    # the ROS message that each stands for.
    frozenset({"geometry_msgs/msg/Point", "geometry_msgs/msg/Point32", "foxglove.Point3",
               "RTC::Point3D"}),
    frozenset({"geometry_msgs/msg/Vector3", "foxglove.Vector3", "RTC::Vector3D"}),
    frozenset({"geometry_msgs/msg/Quaternion", "foxglove.Quaternion", "RTC::Quaternion"}),
    frozenset({"geometry_msgs/msg/Pose", "foxglove.Pose"}),
    frozenset({"builtin_interfaces/msg/Time", "foxglove.Timestamp", "RTC::Time"}),
    frozenset({"builtin_interfaces/msg/Duration", "foxglove.Duration"}),
)  # fmt: skip


def name_of_type(declared: object) -> str:
    """Return the name in what `x-type` says, nothing where it says none."""
    if isinstance(declared, Mapping):
        declared = declared.get("name")
    return declared if isinstance(declared, str) else ""


def _are_alike(one: str, other: str, declared: tuple[frozenset[str], ...]) -> bool:
    """Say whether two names of types stand for the same: equal, built in, or declared so."""
    return one == other or any(one in names and other in names for names in (*declared, *_BUILT_IN))


# What an object or an array says of these holds for all within it that says nothing else.
INHERITED = ("x-unit", "x-quantity", "x-frame", "x-time")
# Of what an adapter emits, as tuples, which no structure that was read has.
AROUND = "x-around"
"""What is said around a value, keyword by keyword; it is of what the value itself does not say."""
SCALED = "x-scaled"
"""The factor and the offset that a number has gone through."""
_INHERITED = frozenset(INHERITED)
_MOST_SHOWN = 8
# How exact the factor of a map must be: what people write, 57.3 or 0.01745, will do.
_TOLERANCE = 1e-3
_WORDS = {
    "x-quantity": "quantities", "x-frame": "frames", "x-encoding": "encodings",
    "x-time": "kinds of time",
}  # fmt: skip
WORDS_COMPARED = frozenset(_WORDS)


@frozen
class MeaningDifference:
    """What two sides state of one value and do not agree on.

    Attributes:
        path: of the consumer's value; `[]` stands for the items of an array.
        sentence: what is different.
        producer: what the producer states.
        consumer: what the consumer states.
        conversion: what would turn the one into the other, None where nothing does.
    """

    path: Path
    sentence: str
    producer: str
    consumer: str
    conversion: Conversion | None = None


@define
class Findings:
    """What was found, in its order; what is found again is no more than it was."""

    differences: dict[MeaningDifference, None] = field(factory=dict)
    unstated: dict[Path, None] = field(factory=dict)
    notes: dict[str, None] = field(factory=dict)

    def add(self, other: Findings) -> None:
        self.differences |= other.differences
        self.unstated |= other.unstated
        self.notes |= other.notes


def compare_types(
    one: Said, other: Said, path: Path, alike: tuple[frozenset[str], ...], found: Findings
) -> bool | None:
    """Say whether types are named that stand for the same; None: not on both sides."""
    mine, theirs = name_of_type(one.get("x-type")), name_of_type(other.get("x-type"))
    if not mine or not theirs:
        return None
    if not _are_alike(mine, theirs, alike):
        sentence = f"the types differ: {mine} is not {theirs}"
        reports = f"x-type {mine}", f"x-type {theirs}"
        found.differences[MeaningDifference(path, sentence, *reports)] = None
        return False
    for key in ("version", "hash"):
        said = [_of_type(mapping, key) for mapping in (one, other)]
        if mine == theirs and None not in said and said[0] != said[1]:
            where = write_places(path) or "message"
            found.notes[
                f"{where}: the producer's {mine} has {key} {said[0]}, the consumer's {said[1]}"
            ] = None
    if mine == theirs and "x-constants" in one and "x-constants" in other:
        _compare_constants(one["x-constants"], other["x-constants"], mine, path, found)
    return True


def _compare_constants(one: Any, other: Any, name: str, path: Path, found: Findings) -> None:
    """Compare the names that two definitions of one type have for values."""
    if one == other or not (isinstance(one, Mapping) and isinstance(other, Mapping)):
        return
    for key, value in one.items():
        if key in other and repr(other[key]) != repr(value):
            sentence = (
                f"the constant {key} of {name} is {value!r} for the producer and {other[key]!r} "
                "for the consumer"
            )
            reports = f"{key}={value!r}", f"{key}={other[key]!r}"
            found.differences[MeaningDifference(path, sentence, *reports)] = None
    more = [f"{key}={value!r}" for key, value in one.items() if key not in other]
    if more:
        where = write_places(path) or "message"
        names = ", ".join(more[:_MOST_SHOWN])
        note = f"{where}: the producer's {name} has constants that the consumer's has not: {names}"
        found.notes[note] = None


def said_around(schema: Said) -> dict[str, Any]:
    """Return what an adapter found to be said around a value."""
    said = schema.get(AROUND)
    return dict(said) if isinstance(said, tuple) else {}


def with_own(around: Said, schema: Said) -> Said:
    """Return what is said of values within a schema: by what is around it, or by itself."""
    if _INHERITED.isdisjoint(schema):
        return around
    return {**around, **{key: schema[key] for key in INHERITED if key in schema}}


def compare_words(
    one: Said, other: Said, here: Said, there: Said, path: Path, found: Findings
) -> None:
    """Compare words, which are plain texts, where one of the schemas itself says one."""
    for keyword, words in _WORDS.items():
        if keyword not in here and keyword not in there:
            continue
        mine, theirs = one.get(keyword), other.get(keyword)
        if isinstance(mine, str) and isinstance(theirs, str) and mine != theirs:
            sentence = f"the {words} differ: {mine} is not {theirs}"
            reports = f"{keyword} {mine}", f"{keyword} {theirs}"
            found.differences[MeaningDifference(path, sentence, *reports)] = None


def compare_units(one: Said, path: Path, mine: Any, theirs: Any, found: Findings) -> None:
    if mine == theirs or not (isinstance(mine, str) and isinstance(theirs, str)):
        return
    reports = f"x-unit {mine}", f"x-unit {theirs}"
    scaled = one.get(SCALED)
    scaled = scaled if isinstance(scaled, tuple) else None
    try:
        by = conversion(mine, theirs)
    except UnitError as error:
        sentence = f"{mine} and {theirs} cannot be compared: {error}"
        found.differences[MeaningDifference(path, sentence, *reports)] = None
        return
    if scaled is not None:
        sentence = _of_scaled(scaled, by, mine, theirs)
        if sentence:
            found.differences[MeaningDifference(path, sentence, *reports)] = None
        elif by is None:
            where = write_places(path)
            found.notes[f"{where}: the map makes {theirs} of {mine} by a factor"] = None
    elif by is None:
        sentence = f"the units differ: {mine} measures something else than {theirs}"
        found.differences[MeaningDifference(path, sentence, *reports)] = None
    elif by.changes:
        lines = ", ".join(f"{name}: {number}" for name, number in by.lines.items())
        sentence = f"the units differ: {mine} becomes {theirs} with {lines}"
        found.differences[MeaningDifference(path, sentence, *reports, by)] = None


def _of_scaled(scaled: Any, by: Conversion | None, mine: str, theirs: str) -> str:
    """Say what is wrong with the factor of a map, or nothing.

    One between different quantities, such as the radius of a wheel, is the configuration's own.
    """
    if by is None:
        return ""
    factor, offset = (Fraction(item) for item in scaled)
    right = abs(abs(factor) - by.factor) <= _TOLERANCE * by.factor
    if by.offset:
        right = right and abs(offset - by.offset) <= _TOLERANCE * abs(by.offset)
    if right:
        return ""
    has = Conversion(factor, offset).lines or {"scale": 1}
    needs = by.lines or {"scale": 1}
    said = [", ".join(f"{name}: {line}" for name, line in lines.items()) for lines in (has, needs)]
    return f"the map has {said[0]}, but {mine} becomes {theirs} with {said[1]}"


def _of_type(schema: Said, key: str) -> Any:
    report = schema.get("x-type")
    return report.get(key) if isinstance(report, Mapping) else None


def write_places(path: Path) -> str:
    """Write a path as reasons do: `pose.points[].x`."""
    text = ""
    for part in path:
        text += part if part.startswith("[") else f".{part}" if text else part
    return text
