"""Adaptations: the schema of what an adapter emits, and the function that makes it, in one walk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from attrs import frozen

from uoarm._adapt._mapping import (
    ArrayMapping,
    Clamp,
    Mapped,
    MappingEntry,
    Path,
    Scale,
    SchemaField,
    Structure,
    UnfitError,
    write_path,
)
from uoarm._meaning import INHERITED, SCALED
from uoarm.errors import MessageError

Maker: TypeAlias = Callable[[Any], Any]
_MAX_LOSSES = 200


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


def mapped(entry: Mapped, table: Mapping[Any, Any] | None, clamp: Clamp | None) -> Maker:
    """Return the function of one entry: read, look up, scale, clamp, default."""
    assert entry.source is not None, "constants are made by `constant`"
    read = reader(entry.source)
    changes = [] if entry.scale is None else [_scaler(entry.scale)]
    changes += [] if clamp is None else [_clamper(clamp)]
    if table is None and not changes and not entry.has_default:
        return read
    where = write_path(entry.source)

    def make(message: Any) -> Any:
        value = read(message)
        if value is MISSING:
            return entry.default if entry.has_default else MISSING
        if table is not None:
            if value not in table:
                raise MessageError(f"{where}: the enum map says nothing of {value!r}")
            value = table[value]
        for change in changes:
            value = change(value)
        return value

    return make


def each_item(read: Maker, make: Maker) -> Maker:
    """Return a function that makes every item of an array."""

    def items(message: Any) -> Any:
        value = read(message)
        return MISSING if value is MISSING else [make(item) for item in value]

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


def _scaler(scale: Scale) -> Maker:
    factor, offset = scale.factor, scale.offset

    def apply(value: Any) -> Any:
        if isinstance(value, int | float) or hasattr(value, "dtype"):
            return value * factor + offset
        return [item * factor + offset for item in value]

    return apply


def _clamper(clamp: Clamp) -> Maker:
    low, high = clamp.low, clamp.high

    def one(value: Any) -> Any:
        return low if value < low else min(value, high)

    def apply(value: Any) -> Any:
        if hasattr(value, "dtype"):
            return value.clip(low, high)
        return one(value) if isinstance(value, int | float) else [one(item) for item in value]

    return apply


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
    schema = {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }
    return schema, build_object(makers)


def _value(value: Mapped | ArrayMapping, source: Structure) -> tuple[SchemaField, Maker]:
    if isinstance(value, ArrayMapping):
        return _each(value, source)
    if value.source is None:
        return SchemaField({"const": value.const}, always=True), constant(value.const)
    field = source.at(value.source)
    schema, table = field.schema, None
    where = write_path(value.source)
    if value.enum is not None:
        schema, table = _enumerated(value.enum, source.plain(schema, where), where)
    if value.scale is not None:
        schema = _scaled(value.scale, source, schema, where)
    clamp = value.clamp
    if clamp is not None:
        schema, clamp = _clamped(clamp, source, schema, where)
    always = field.always
    if value.has_default and not always:
        schema, always = {"anyOf": [schema, {"const": value.default}]}, True
    return SchemaField(schema, always), mapped(value, table, clamp)


def _each(value: ArrayMapping, source: Structure) -> tuple[SchemaField, Maker]:
    field = source.at(value.source)
    where = write_path(value.source)
    array = source.plain(field.schema, where)
    if array.get("type") != "array" or "prefixItems" in array or "items" not in array:
        raise UnfitError(where, "each needs an array whose items are all of one structure")
    inner, make = _object(value.entries, Structure(array["items"], source))
    bounds = {key: array[key] for key in ("minItems", "maxItems") if key in array}
    schema = {"type": "array", "items": inner, **bounds}
    return SchemaField(schema, field.always), each_item(reader(value.source), make)


def _enumerated(
    pairs: tuple[tuple[str, Any], ...], schema: Mapping[str, Any], where: str
) -> tuple[Any, Mapping[Any, Any]]:
    """Return the schema of mapped values and the table from each source value."""
    known = dict(pairs)
    if "const" in schema:
        values = [schema["const"]]
    elif schema.get("type") == "boolean":
        values = [False, True]
    elif "enum" in schema:
        values = list(schema["enum"])
    else:
        raise UnfitError(where, "an enum map needs a field that has a known set of values")
    table: dict[Any, Any] = {}
    for value in values:
        text = (
            value
            if isinstance(value, str)
            else str(value).lower()
            if isinstance(value, bool)
            else str(value)
        )
        if text not in known:
            raise UnfitError(where, f"the enum map says nothing of the value {value!r}")
        table[value] = known[text]
    return {"enum": list({repr(v): v for v in table.values()}.values())}, table


def _scaled(scale: Scale, source: Structure, schema: Any, where: str) -> Any:
    plain = source.plain(schema, where)
    if plain.get("type") == "array" and "items" in plain and "prefixItems" not in plain:
        return {**plain, "items": _scaled(scale, source, plain["items"], where)}
    kind = plain.get("type")
    if kind not in {"integer", "number"}:
        raise UnfitError(where, "scale and offset need a number or an array of numbers")
    stays_whole = kind == "integer" and all(
        isinstance(item, int) for item in (scale.factor, scale.offset)
    )
    low, high = _bound(plain, "inimum", scale), _bound(plain, "aximum", scale)
    if scale.factor < 0:
        low, high = high, low
    bounds = {key: item for key, item in (("minimum", low), ("maximum", high)) if item is not None}
    kept = {key: plain[key] for key in INHERITED if key in plain}
    if "x-unit" in kept:
        kept[SCALED] = (scale.factor, scale.offset)
    return {"type": "integer" if stays_whole else "number", **bounds, **kept}


def _clamped(clamp: Clamp, source: Structure, schema: Any, where: str) -> tuple[Any, Clamp]:
    """Return the schema of what a clamp lets through, and the clamp within the known bounds.

    Those keep its ends within what an array of the producer's own number type can hold.
    """
    plain = source.plain(schema, where)
    if plain.get("type") == "array" and "items" in plain and "prefixItems" not in plain:
        items, within = _clamped(clamp, source, plain["items"], where)
        return {**plain, "items": items}, within
    kind = plain.get("type")
    if kind not in {"integer", "number"}:
        raise UnfitError(where, "clamp needs a number or an array of numbers")
    if kind == "integer" and not all(isinstance(item, int) for item in (clamp.low, clamp.high)):
        raise UnfitError(where, "clamp needs integers here, since the field is an integer")
    least, most = _bound(plain, "inimum", Scale()), _bound(plain, "aximum", Scale())
    low = clamp.low if least is None else min(max(least, clamp.low), clamp.high)
    high = clamp.high if most is None else min(max(most, clamp.low), clamp.high)
    kept = {key: plain[key] for key in ("x-nonfinite", SCALED, *INHERITED) if key in plain}
    return {"type": kind, "minimum": low, "maximum": high, **kept}, Clamp(low, high)


def _bound(schema: Mapping[str, Any], ending: str, scale: Scale) -> float | int | None:
    """Scale a bound by the very arithmetic that messages meet: it is monotone, so it holds."""
    prefix = "m" if f"m{ending}" in schema else "exclusiveM"
    bound = schema.get(f"{prefix}{ending}")
    return None if bound is None else bound * scale.factor + scale.offset


def _losses(entries: tuple[MappingEntry, ...], source: Structure, prefix: str = "") -> list[str]:
    """Return the producer's fields that no entry carries over, the outermost of each."""
    carried = {
        entry.value.source for entry in entries if getattr(entry.value, "source", None) is not None
    }
    found: list[str] = []
    waiting: list[tuple[Path, Any]] = [((), source.schema)]
    for path, schema in waiting:
        if path in carried:
            continue
        if path and not any(
            tuple_ is not None and tuple_[: len(path)] == path for tuple_ in carried
        ):
            found.append(prefix + write_path(path))
            continue
        try:
            fields = source.plain(schema, write_path(path)).get("properties", {})
        except UnfitError:
            continue
        waiting.extend(((*path, name), child) for name, child in fields.items())
    for entry in entries:
        if isinstance(entry.value, ArrayMapping):
            array = source.plain(source.at(entry.value.source).schema, "")
            inner = Structure(array["items"], source)
            where = f"{prefix}{write_path(entry.value.source)}[]."
            found.extend(_losses(entry.value.entries, inner, where))
    return found[:_MAX_LOSSES]
