"""Suggestions: the configuration lines that would make a refused edge fit, tried before offered."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping
from typing import Any

from attrs import frozen

from uoarm._adapt._adaptation import adapt
from uoarm._adapt._mapping import Path, Structure, UnfitError, kind_of, leaves, parse, write_path
from uoarm._meaning import (
    Conversion,
    MeaningDifference,
    UnitError,
    conversion,
    judge,
    missing_for_units,
    name_of_type,
)
from uoarm._support.yaml import write_flow
from uoarm.model import Meaning, MeaningLevel, MessageStructure
from uoarm.schema import CheckBudget, check

_MAX_FIELDS = 60
_ALIKE = 0.6
_AS_IT_IS = Conversion()
# Words at the end of a field's name that are a unit and nothing else.
_UNITS = frozenset({
    "kelvin", "celsius", "fahrenheit", "rad", "radian", "radians", "deg", "degree", "degrees",
    "rpm", "m", "metre", "metres", "meter", "meters", "cm", "centimetres", "centimeters", "mm",
    "millimetres", "millimeters", "km", "kilometres", "kilometers", "feet", "ft", "inch", "inches",
    "mph", "kmh", "s", "sec", "secs", "seconds", "ms", "millis", "milliseconds", "us", "micros",
    "microseconds", "ns", "nanos", "nanosec", "nanosecs", "nanoseconds", "minutes", "hours", "Pa",
    "hPa", "kPa", "pascal", "kg", "kilograms", "grams", "volts", "mV", "millivolts", "amps",
    "amperes", "mA", "milliamps", "percent",
})  # fmt: skip
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def suggest(
    producer: MessageStructure,
    consumer: MessageStructure,
    fits: Callable[[Mapping[str, Any], tuple[str, ...]], bool],
    left: Callable[[], CheckBudget],
    meaning: Meaning,
) -> str:
    """Return lines to paste that make the edge fit, or nothing.

    Args:
        producer: structure of what is emitted.
        consumer: structure of what is taken.
        fits: judges a mapping with its allowed losses.
        left: what each question may cost; with no time left there is no suggestion.
        meaning: how meaning is judged; no field is offered for one that means something else.
    """
    source, target = Structure(producer.schema), Structure(consumer.schema)
    try:
        mapping = _of_the_other_ros(source, target) or _draft(
            source, target, _FieldSimilarity(source, target, left, meaning)
        )
        if mapping is None:
            return ""
        losses = adapt(parse(mapping), producer.schema, consumer.schema).losses
    except (UnfitError, ValueError, _NoTimeError):
        return ""
    # A map that changes nothing would only hide that the types have different names.
    if not (mapping or losses) or not fits(mapping, losses):
        return ""
    lines = f"map: {flow(mapping)}"
    return f"{lines}\nallow_loss: {flow(list(losses))}" if losses else lines


# What ROS 2 has changed in messages of ROS 1 that it calls by the same name.
_ROS_TIMES = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}
_ROS_FIELDS = {"sec": "secs", "nanosec": "nsecs"}


def _of_the_other_ros(source: Structure, target: Structure) -> dict[str, Any]:
    """Return the map between a message of ROS 1 and that of ROS 2 of the same name, or nothing.

    It goes down to the fields, whose types have no names: pasting it says that the messages mean
    the same.

    Raises:
        UnfitError: a field of one is not in the other.
    """
    mapping: dict[str, Any] = {}
    if not _is_counterpart(source.schema, target.schema):
        return mapping
    _fill_counterpart(mapping, (), (), source, target)
    return mapping


def _is_counterpart(one: Any, other: Any) -> bool:
    names = [_ros_name(schema) for schema in (one, other)]
    return bool(names[0]) and names[0] == names[1] and one.get("x-type") != other.get("x-type")


def _ros_name(schema: Any) -> str:
    """Return the name of a type as both call it: without the `msg` between package and name."""
    name = name_of_type(schema.get("x-type")) if isinstance(schema, Mapping) else ""
    return _ROS_TIMES.get(name, name.replace("/msg/", "/"))


def _fill_counterpart(
    mapping: dict[str, Any], place: Path, at: Path, source: Structure, target: Structure
) -> None:
    """Fill an object field by field; `place` and `at` are where it is in target and source."""
    one = source.plain(source.at(at).schema if at else source.schema, write_path(at))
    other = target.plain(
        target.at(place, is_emitted=False).schema if place else target.schema, write_path(place)
    )
    have = {_ROS_FIELDS.get(name, name).lower(): name for name in one.get("properties", {})}
    for name, schema in other.get("properties", {}).items():
        if len(mapping) > _MOST_FIELDS:
            raise UnfitError(write_path(place), "too many fields")
        where, own = (*place, name), have.get(_ROS_FIELDS.get(name, name).lower())
        if own is None and name == "seq" and _ros_name(other) == "std_msgs/Header":
            mapping[write_path(where)] = {"const": 0}
            continue
        if own is None:
            raise UnfitError(write_path(where), "it is in one of the two only")
        made = source.plain(one["properties"][own], write_path((*at, own)))
        taken = target.plain(schema, write_path(where))
        items = [array.get("items") for array in (made, taken)]
        if "properties" in taken:
            _fill_counterpart(mapping, where, (*at, own), source, target)
        elif isinstance(items[1], Mapping) and "properties" in items[1]:
            inner: dict[str, Any] = {}
            parts = (
                Structure(item, whole) for item, whole in zip(items, (source, target), strict=True)
            )
            _fill_counterpart(inner, (), (), *parts)
            mapping[write_path(where)] = {"each": write_path((*at, own)), "map": inner}
        else:
            mapping[write_path(where)] = _within_range(write_path((*at, own)), made, taken)


def _within_range(path: str, made: Mapping[str, Any], taken: Mapping[str, Any]) -> Any:
    """Return where a field comes from, cut to what the other takes, as with times after 2038."""
    ends: list[Any] = [
        schema.get(end) for end in ("minimum", "maximum") for schema in (made, taken)
    ]
    if kind_of(taken) != "integer" or None in ends:
        return path
    clamp = [max(ends[:2]), min(ends[2:])]
    return path if clamp == [ends[0], ends[2]] else {"from": path, "clamp": clamp}


def untried_conversion(producer: MessageStructure, consumer: MessageStructure) -> str:
    """Return which units no map was suggested for, and what is not installed; nothing if none.

    Args:
        producer: structure of what is emitted.
        consumer: structure of what is taken.
    """
    source, target = Structure(producer.schema), Structure(consumer.schema)
    try:
        wanted = target.fields()
        units = [_unit_of(*item) for item in wanted.items()] if len(wanted) <= _MAX_FIELDS else []
        have = (
            [_unit_of(path[-1], item) for path, item in leaves(source) if path]
            if any(units)
            else []
        )
    except UnfitError:
        return ""
    pairs = ((name, unit) for unit in units if unit not in have for name in have if name and unit)
    pair = next(pairs, None)
    if pair is None or not (missing := missing_for_units()):
        return ""
    return f"whether {pair[0]} can be converted to {pair[1]} is not known: {missing}"


class _NoTimeError(Exception):
    """No time is left for a suggestion."""


@frozen
class _FieldSimilarity:
    """Says which field of the producer does for which of the consumer, as long as there is time."""

    source: Structure
    target: Structure
    left: Callable[[], CheckBudget]
    meaning: Meaning

    def accepts(self, one: Any, other: Any) -> bool:
        budget = self.left()
        if not budget.seconds:
            raise _NoTimeError
        producer = _with_definitions(one, self.source)
        consumer = _with_definitions(other, self.target)
        if not check(producer, consumer, budget=budget).compatible:
            return False
        # What a conversion would mend is found by its unit, not as one that is accepted.
        off = self.meaning.level is MeaningLevel.OFF
        return off or not judge(producer, consumer, self.meaning.alike).differences


def _draft(
    source: Structure, target: Structure, similarity: _FieldSimilarity
) -> dict[str, Any] | None:
    """Fill every field of the consumer that the producer's field of that name does not."""
    wanted = target.fields()
    if not wanted or len(wanted) > _MAX_FIELDS:
        return None
    have = list(leaves(source))
    required = target.plain(target.schema, ".").get("required", ())
    mapping: dict[str, Any] = {}
    for name, schema in wanted.items():
        same = source.fields().get(name)
        if (
            same is not None
            and _is_same_unit(name, same, schema)
            and similarity.accepts(same, schema)
        ):
            continue
        found = _best(name, schema, have, similarity)
        if found is not None:
            mapping[name] = _entry(*found)
        elif (value := _only_value(schema)) is not None:
            mapping[name] = {"const": value}
        elif name in required:
            return None
    return mapping


def _best(
    name: str, schema: Any, have: list[tuple[Path, Any]], similarity: _FieldSimilarity
) -> tuple[Path, Conversion] | None:
    """Return the producer's field that fits best: by name, by likeness, or as the only one.

    One in another unit is taken only where it can be converted, and is.
    """
    unit = _unit_of(name, schema)
    fitting: dict[Path, Conversion] = {}
    for path, item in have:
        text = _unit_of(path[-1], item) if path else None
        by = _convert(text, unit)
        if by is None and None in {text, unit} and _are_alike(name, path):
            by = _AS_IT_IS
        if by is None:
            continue
        # What fits only after it was converted is judged with the whole map.
        if _is_numeric(item) if by.changes else similarity.accepts(item, schema):
            fitting[path] = by
    same = [path for path in fitting if path[-1] == name]
    if same:
        return (best := min(same, key=len)), fitting[best]
    alike = difflib.get_close_matches(name, [path[-1] for path in fitting], n=1, cutoff=_ALIKE)
    if alike:
        best = next(path for path in fitting if path[-1] == alike[0])
        return best, fitting[best]
    return next(iter(fitting.items())) if len(fitting) == 1 else None


def _are_alike(name: str, path: Path) -> bool:
    return bool(path) and bool(difflib.get_close_matches(name, path[-1:], n=1, cutoff=_ALIKE))


def _is_numeric(schema: Any) -> bool:
    return isinstance(schema, Mapping) and kind_of(schema) in ("number", "integer", "array")


def _is_same_unit(name: str, one: Any, other: Any) -> bool:
    units = _unit_of(name, one), _unit_of(name, other)
    by = _convert(*units)
    return None in units or (by is not None and not by.changes)


def _unit_of(name: str, schema: Any) -> str | None:
    """Return the unit of a field by `x-unit`, else by the end of its name; None: neither says."""
    if isinstance(schema, Mapping) and isinstance(unit := schema.get("x-unit"), str) and unit:
        return unit
    words = _WORDS.findall(name)
    last = words[-1] if words else ""
    for unit in (last, last.lower()):
        if unit in _UNITS and (len(unit) > 1 or len(words) > 1):
            return unit
    return None


def _convert(one: str | None, other: str | None) -> Conversion | None:
    """Return how numbers in a unit become those in another; None: not, or it is not known."""
    if one == other:
        return Conversion()
    try:
        return conversion(one, other) if one and other else None
    except UnitError:
        return None


def _entry(path: Path, by: Conversion) -> Any:
    """Return what a map says of a field that comes from a path."""
    return {"from": write_path(path), **by.lines} if by.changes else write_path(path)


def _with_definitions(schema: Any, structure: Structure) -> Any:
    if not structure.definitions or not isinstance(schema, Mapping):
        return schema
    return {**schema, **structure.definitions}


def _only_value(schema: Any) -> Any:
    if isinstance(schema, Mapping):
        if "const" in schema:
            return schema["const"]
        if len(schema.get("enum", ())) == 1:
            return schema["enum"][0]
    return None


def flow(value: Any) -> str:
    """Write a value as a YAML flow collection that reads back as itself."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_word(k)}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(flow(item) for item in value) + "]"
    return _word(value) if isinstance(value, str) else write_flow(value)


def _word(text: str) -> str:
    plain = text.replace("_", "a").replace(".", "a").isalnum() and text[0].isalpha()
    reserved = text.lower() in {"true", "false", "null"}
    return text if plain and text.isascii() and not reserved else write_flow(text)


_MOST_FIELDS = 200
_ITEMS = "[]"


def converting_map(
    producer: MessageStructure,
    consumer: MessageStructure,
    differences: tuple[MeaningDifference, ...],
    fits: Callable[[Mapping[str, Any], tuple[str, ...]], bool],
) -> str:
    """Return lines to paste that convert each value of another unit, or nothing."""
    by = {difference.path: difference.conversion for difference in differences}
    if None in by.values():
        return ""
    source, target = Structure(producer.schema), Structure(consumer.schema)
    mapping: dict[str, Any] = {}
    try:
        if () in by:
            mapping["."] = {"from": ".", **_lines(by[()])}
        for name in {} if mapping else target.fields():
            if name in source.fields():
                inside = {path[1:]: value for path, value in by.items() if path[:1] == (name,)}
                if inside:
                    _fill(mapping, (name,), (name,), inside, source, target)
        losses = adapt(parse(mapping), producer.schema, consumer.schema).losses
    except (UnfitError, ValueError):
        return ""
    if not fits(mapping, losses):
        return ""
    lines = f"map: {flow(mapping)}"
    return f"{lines}\nallow_loss: {flow(list(losses))}" if losses else lines


def _fill(
    mapping: dict[str, Any],
    place: tuple[str, ...],
    field: tuple[str, ...],
    inside: Mapping[tuple[str, ...], Conversion | None],
    source: Structure,
    target: Structure,
) -> None:
    """Write the rules of one field; those beside a field that is converted are named, too."""
    where = ".".join(place)
    if len(mapping) > _MOST_FIELDS:
        raise UnfitError(where, "too many fields")
    if not inside:
        mapping[where] = where
        return
    if all(set(path) <= {_ITEMS} for path in inside):
        mapping[where] = {"from": where, **_lines(next(iter(inside.values())))}
        return
    one = source.plain(source.at(field).schema, where)
    other = target.plain(target.at(field, is_emitted=False).schema, where)
    if all(path[:1] == (_ITEMS,) for path in inside):
        items, taken = source.items(one), target.items(other)
        inner: dict[str, Any] = {}
        rest = {path[1:]: by for path, by in inside.items()}
        for name in taken.fields():
            if name in items.fields():
                within = {path[1:]: by for path, by in rest.items() if path[:1] == (name,)}
                _fill(inner, (name,), (name,), within, items, taken)
        mapping[where] = {"each": where, "map": inner}
        return
    for name in other.get("properties", {}):
        if name in one.get("properties", {}):
            within = {path[1:]: by for path, by in inside.items() if path[:1] == (name,)}
            _fill(mapping, (*place, name), (*field, name), within, source, target)


def _lines(by: Conversion | None) -> dict[str, float]:
    return {} if by is None else by.lines
