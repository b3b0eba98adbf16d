"""Suggestions: the configuration lines that would make a refused edge fit, tried before offered."""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Mapping
from typing import Any

from attrs import frozen

from uoarm._adapt._adaptation import adapt
from uoarm._adapt._mapping import Path, parse, write_path
from uoarm._adapt._units import Conversion, conversion, unit_of
from uoarm._adapt._walk import Structure, UnfitError, leaves
from uoarm.model import MessageStructure
from uoarm.schema import Budget, check

__all__ = ["suggest"]

_MAX_FIELDS = 60
_ALIKE = 0.6
_AS_IT_IS = Conversion(1.0, 0.0)


def suggest(
    producer: MessageStructure,
    consumer: MessageStructure,
    fits: Callable[[Mapping[str, Any], tuple[str, ...]], bool],
    left: Callable[[], Budget],
) -> str:
    """Return lines to paste that make the edge fit, or nothing.

    Args:
        producer: structure of what is emitted.
        consumer: structure of what is taken.
        fits: judges a mapping with its allowed losses.
        left: what each question may cost; with no time left there is no suggestion.
    """
    source, target = Structure(producer.schema), Structure(consumer.schema)
    try:
        mapping = _draft(source, target, _Likeness(source, target, left))
        if mapping is None:
            return ""
        losses = adapt(parse(mapping), producer.schema, consumer.schema).losses
    except (UnfitError, ValueError, _NoTimeError):
        return ""
    if not fits(mapping, losses):
        return ""
    lines = f"map: {_flow(mapping)}"
    return f"{lines}\nallow_loss: {_flow(list(losses))}" if losses else lines


class _NoTimeError(Exception):
    """No time is left for a suggestion."""


@frozen
class _Likeness:
    """Says which field of the producer does for which of the consumer, as long as there is time."""

    source: Structure
    target: Structure
    left: Callable[[], Budget]

    def accepts(self, one: Any, other: Any) -> bool:
        budget = self.left()
        if not budget.seconds:
            raise _NoTimeError
        producer = _with_definitions(one, self.source)
        return check(producer, _with_definitions(other, self.target), budget=budget).compatible


def _draft(source: Structure, target: Structure, likeness: _Likeness) -> dict[str, Any] | None:
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
            and likeness.accepts(same, schema)
        ):
            continue
        found = _best(name, schema, have, likeness)
        if found is not None:
            mapping[name] = _entry(*found)
        elif (value := _only_value(schema)) is not None:
            mapping[name] = {"const": value}
        elif name in required:
            return None
    return mapping


def _best(
    name: str, schema: Any, have: list[tuple[Path, Any]], likeness: _Likeness
) -> tuple[Path, Conversion] | None:
    """Return the producer's field that fits best: by name, by likeness, or as the only one.

    One in another unit is taken only where it can be converted, and is.
    """
    unit = unit_of(name, schema)
    fitting: dict[Path, Conversion] = {}
    for path, one in have:
        told = unit_of(path[-1], one) if path else None
        by = conversion(told, unit)
        if by is None and None in {told, unit} and _are_alike(name, path):
            by = _AS_IT_IS
        if by is None:
            continue
        # What fits only after it was converted is judged with the whole map.
        if _is_numeric(one) if by.changes else likeness.accepts(one, schema):
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
    return isinstance(schema, Mapping) and schema.get("type") in {"number", "integer", "array"}


def _is_same_unit(name: str, one: Any, other: Any) -> bool:
    units = unit_of(name, one), unit_of(name, other)
    by = conversion(*units)
    return None in units or (by is not None and not by.changes)


def _entry(path: Path, by: Conversion) -> Any:
    """Return what a map says of a field that comes from a path."""
    if not by.changes:
        return write_path(path)
    change = {"scale": by.scale, "offset": by.offset}
    idle = {"scale": 1.0, "offset": 0.0}
    return {
        "from": write_path(path),
        **{name: _short(one) for name, one in change.items() if one != idle[name]},
    }


def _short(number: float) -> float:
    return int(number) if number.is_integer() else number


def _with_definitions(schema: Any, structure: Structure) -> Any:
    if not structure.definitions or not isinstance(schema, Mapping):
        return schema
    return {**schema, "$defs": structure.definitions}


def _only_value(schema: Any) -> Any:
    if isinstance(schema, Mapping):
        if "const" in schema:
            return schema["const"]
        if len(schema.get("enum", ())) == 1:
            return schema["enum"][0]
    return None


def _flow(value: Any) -> str:
    """Write a value as a YAML flow collection that reads back as itself."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_word(k)}: {_flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(one) for one in value) + "]"
    return _word(value) if isinstance(value, str) else json.dumps(value)


def _word(text: str) -> str:
    plain = text.replace("_", "a").replace(".", "a").isalnum() and text[0].isalpha()
    reserved = text.lower() in {"true", "false", "null"}
    return text if plain and text.isascii() and not reserved else json.dumps(text)
