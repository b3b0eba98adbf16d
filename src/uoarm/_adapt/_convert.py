"""The map that converts what differs in its unit alone: every other field stays as it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from uoarm._adapt._adaptation import adapt
from uoarm._adapt._mapping import parse
from uoarm._adapt._suggest import flow
from uoarm._adapt._walk import Structure, UnfitError
from uoarm._meaning import Conversion, Difference
from uoarm.model import MessageStructure

__all__ = ["converting_map"]

_MOST_FIELDS = 200
_ITEMS = "[]"


def converting_map(
    producer: MessageStructure,
    consumer: MessageStructure,
    differences: tuple[Difference, ...],
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
    if inside.keys() <= {(), (_ITEMS,)}:
        mapping[where] = {"from": where, **_lines(next(iter(inside.values())))}
        return
    one = source.plain(source.at(field).schema, where)
    other = target.plain(target.at(field).schema, where)
    if all(path[:1] == (_ITEMS,) for path in inside):
        items = Structure(one["items"], source.definitions)
        taken = Structure(other["items"], target.definitions)
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
