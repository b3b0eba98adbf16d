"""Adaptations: the schema of what an adapter emits, and the function that makes it, in one walk."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from attrs import frozen

from uoarm._adapt._mapping import (
    ArrayMapping,
    Mapped,
    MappingEntry,
    Path,
    SchemaField,
    Structure,
    UnfitError,
    kind_of,
    write_path,
)
from uoarm._adapt._numbers import Maker, array_of, clamped, scaled
from uoarm._encodable import shown
from uoarm.errors import MessageError
from uoarm.model import closed_object


class _Missing:
    """Stands for an optional field that a message does not have."""


MISSING = _Missing()


def reader(path: Path) -> Maker:
    """Return a function that reads a path, MISSING where the message has nothing there."""
    if not path:
        return lambda message: message
    if len(path) == 1:
        (name,) = path
        return lambda message: message.get(name, MISSING)

    def read(message: Any) -> Any:
        for part in path:
            if message is MISSING:
                return MISSING
            message = message.get(part, MISSING)
        return message

    return read


def constant(value: Any) -> Maker:
    """Return a function that ignores the message."""
    return lambda _: value


def mapped(entry: Mapped, changes: Sequence[Maker]) -> Maker:
    """Return the function of one entry: read, change, or take the default."""
    assert entry.source is not None, "constants are made by `constant`"
    read = reader(entry.source)
    if not changes and not entry.has_default:
        return read

    def make(message: Any) -> Any:
        value = read(message)
        if value is MISSING:
            return entry.default if entry.has_default else MISSING
        for change in changes:
            value = change(value)
        return value

    return make


def each_item(read: Maker, make: Maker) -> Maker:
    """Return a function that makes every item of an array."""

    def items(message: Any) -> Any:
        value = read(message)
        if value is MISSING:
            return MISSING
        # As numbers of Python: those of numpy wrap.
        return [make(item) for item in (value.tolist() if hasattr(value, "dtype") else value)]

    return items


def build_object(makers: Sequence[tuple[str, Maker, bool]]) -> Maker:
    """Return a function that makes an object of named values, without those that are missing."""
    if all(always for _, _, always in makers):

        def build(message: Any) -> Any:
            made = {name: make(message) for name, make, _ in makers}
            for name, value in made.items():
                if value is MISSING:
                    raise MessageError(f"the message has nothing for the field {name!r}")
            return made

        return build

    def build_present(message: Any) -> Any:
        made = {}
        for name, make, always in makers:
            value = make(message)
            if value is not MISSING:
                made[name] = value
            elif always:
                raise MessageError(f"the message has nothing for the field {name!r}")
        return made

    return build_present


@frozen
class Adaptation:
    """An adapter applied to a producer's structure.

    Attributes:
        schema: of every message that the adapter emits.
        losses: paths of the producer's fields that are not carried over.
        make: the compiled function.
    """

    schema: Any
    losses: tuple[str, ...]
    make: Callable[[Any], Any]


def adapt(entries: tuple[MappingEntry, ...], producer: Any, consumer: Any) -> Adaptation:
    """Apply an adapter to a structure; fields of one name fill what it does not mention.

    Raises:
        UnfitError: an entry does not fit the producer's structure.
    """
    source = Structure(producer)
    whole = entries + _of_the_same_name(entries, source, Structure(consumer))
    schema, make = _object(whole, source)
    if source.definitions and isinstance(schema, Mapping):
        schema = {**schema, **source.definitions}
    return Adaptation(schema, tuple(_losses(whole, source)), make)


def _of_the_same_name(
    entries: tuple[MappingEntry, ...], source: Structure, target: Structure
) -> tuple[MappingEntry, ...]:
    filled = {entry.target[0] for entry in entries if entry.target}
    if any(not entry.target for entry in entries):
        return ()
    return tuple(
        MappingEntry((name,), Mapped(source=(name,)))
        for name in target.fields()
        if name not in filled and name in source.fields()
    )


def _object(entries: tuple[MappingEntry, ...], source: Structure) -> tuple[Any, Maker]:
    """Return schema and maker of the object, or single value, that entries describe."""
    if len(entries) == 1 and not entries[0].target:
        field, make = _value(entries[0].value, source)
        return field.schema, make
    properties: dict[str, Any] = {}
    required: list[str] = []
    makers: list[tuple[str, Maker, bool]] = []
    groups: dict[str, list[MappingEntry]] = {}
    for entry in entries:
        if not entry.target:
            raise UnfitError(".", "a map that fills the whole message can hold nothing else")
        groups.setdefault(entry.target[0], []).append(entry)
    for name, group in groups.items():
        if len(group) == 1 and len(group[0].target) == 1:
            field, make = _value(group[0].value, source)
        else:
            inner = tuple(MappingEntry(entry.target[1:], entry.value) for entry in group)
            schema, make = _object(inner, source)
            field = SchemaField(schema, always=True)
        properties[name] = field.schema
        makers.append((name, make, field.always))
        if field.always:
            required.append(name)
    return closed_object(properties, required), build_object(makers)


def _value(value: Mapped | ArrayMapping, source: Structure) -> tuple[SchemaField, Maker]:
    if isinstance(value, ArrayMapping):
        return _each(value, source)
    if value.source is None:
        return SchemaField({"const": value.const}, always=True), constant(value.const)
    field = source.at(value.source)
    schema, changes = field.schema, []
    if value.enum is not None:
        schema, change = _enumerated(value.enum, source, schema, value.source)
        changes.append(change)
    if value.scale is not None:
        is_last = value.clamp is None
        schema, change = scaled(value.scale, source, schema, value.source, is_last=is_last)
        changes.append(change)
    if value.clamp is not None:
        schema, change = clamped(value.clamp, source, schema, value.source)
        changes.append(change)
    always = field.always
    if value.has_default and not always:
        schema, always = {"anyOf": [schema, {"const": value.default}]}, True
    return SchemaField(schema, always), mapped(value, changes)


def _each(value: ArrayMapping, source: Structure) -> tuple[SchemaField, Maker]:
    field = source.at(value.source)
    where = write_path(value.source)
    array = source.plain(field.schema, where)
    if kind_of(array) != "array" or "prefixItems" in array or "items" not in array:
        raise UnfitError(where, "each needs an array whose items are all of one structure")
    inner, make = _object(value.entries, source.items(array))
    return SchemaField(array_of(inner, array), field.always), each_item(reader(value.source), make)


def _enumerated(
    pairs: tuple[tuple[str, Any], ...], source: Structure, schema: Any, path: Path
) -> tuple[Any, Maker]:
    """Return the schema of mapped values, and what maps one."""
    known, where = dict(pairs), write_path(path)
    plain = source.plain(schema, where)
    if "const" in plain:
        values = [plain["const"]]
    elif kind_of(plain) == "boolean":
        values = [False, True]
    elif "enum" in plain:
        values = list(plain["enum"])
    else:
        raise UnfitError(where, "an enum map needs a field that has a known set of values")
    table: dict[Any, Any] = {}
    for value in values:
        if isinstance(value, list | Mapping):
            raise UnfitError(where, "an enum map is for texts, numbers, true, false and null")
        text = next((text for text in _texts_of(value) if text in known), None)
        if text is None:
            raise UnfitError(where, f"the enum map says nothing of the value {shown(value)}")
        if value in table and repr(table[value]) != repr(known[text]):
            raise UnfitError(where, f"an enum map cannot distinguish {shown(value)} from its equal")
        table[value] = known[text]

    def look_up(value: Any) -> Any:
        try:
            return table[value]
        except (KeyError, TypeError):
            text = f"{where}: the enum map says nothing of {shown(value)}"
            raise MessageError(text) from None

    return {"enum": list({repr(value): value for value in table.values()}.values())}, look_up


def _texts_of(value: Any) -> tuple[str, ...]:
    """Return how a map may name a value: as JSON writes it, 1.0 as 1, too."""
    if isinstance(value, str):
        return (value,)
    is_whole = isinstance(value, float) and value.is_integer()
    return (json.dumps(value), *([str(int(value))] if is_whole else []))


def _losses(entries: tuple[MappingEntry, ...], source: Structure, prefix: str = "") -> list[str]:
    """Return the producer's fields that no entry carries over, the outermost of each.

    Those whose names are not known, but their structure, are `*`.
    """
    carried = {path for entry in entries if (path := entry.value.source) is not None}
    parts = {path[:end] for path in carried for end in range(len(path) + 1)}
    found: list[str] = []
    waiting: list[tuple[Path, Any]] = [((), source.schema)]
    for path, schema in waiting:
        if path in carried:
            continue
        if path and path not in parts:
            found.append(prefix + write_path(path))
            continue
        try:
            plain = source.plain(schema, write_path(path))
        except UnfitError:
            continue
        fields = plain.get("properties", {})
        waiting.extend(((*path, name), child) for name, child in fields.items())
        rest = plain.get("patternProperties") or plain.get("additionalProperties")
        if rest and isinstance(rest, Mapping):
            found.append(prefix + write_path((*path, "*")))
    for entry in entries:
        if isinstance(entry.value, ArrayMapping):
            array = source.plain(source.at(entry.value.source).schema, "")
            inner = source.items(array)
            where = f"{prefix}{write_path(entry.value.source)}[]."
            found.extend(_losses(entry.value.entries, inner, where))
    return found
