"""Adaptations: the schema of what an adapter emits, and the function that makes it, in one walk.

Numbers that are scaled and clamped are computed as the bounds of the schema are: whole ones
exactly, others in double precision, whatever the width of the array that they come in.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
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
    kind_of,
    within,
    write_path,
)
from uoarm._encodable import shown
from uoarm._meaning import INHERITED, SCALED
from uoarm.errors import MessageError
from uoarm.model import closed_object

Maker: TypeAlias = Callable[[Any], Any]
_MAX_LEVELS = 12
_WIDTHS = (16, 32, 64)
_INFINITE = (math.inf, -math.inf)


def scaled(
    scale: Scale, source: Structure, schema: Any, path: Path, *, is_last: bool
) -> tuple[Any, Maker]:
    """Return the schema of scaled numbers, or arrays of them, and what makes them.

    What becomes infinite is refused where it is the last: JSON has no such numbers.

    Raises:
        UnfitError: there is something else at that path.
    """

    def change(plain: Mapping[str, Any]) -> tuple[Any, Maker, Maker]:
        is_whole = kind_of(plain) == "integer" and _is_whole(scale.factor, scale.offset)
        ends = dict(zip(("minimum", "maximum"), _range(plain, scale), strict=True))
        bounds = {key: end for key, end in ends.items() if end is not None}
        kept = _kept(plain, "x-nonfinite")
        if "x-unit" in kept:
            kept[SCALED] = (scale.factor, scale.offset)
        made = {"type": "integer" if is_whole else "number", **bounds, **kept}
        return made, *_scalers(scale, write_path(path), is_last=is_last)

    return _of_numbers(change, source, schema, path, "scale and offset need")


def clamped(clamp: Clamp, source: Structure, schema: Any, path: Path) -> tuple[Any, Maker]:
    """Return the schema of clamped numbers, or arrays of them, and what makes them.

    Raises:
        UnfitError: there is something else at that path, or the ends are not of its type.
    """

    def change(plain: Mapping[str, Any]) -> tuple[Any, Maker, Maker]:
        if kind_of(plain) == "integer" and not _is_whole(clamp.low, clamp.high):
            text = "clamp needs integers here, since the field is an integer"
            raise UnfitError(write_path(path), text)
        least, most = _range(plain, Scale())
        low = clamp.low if least is None else min(max(least, clamp.low), clamp.high)
        high = clamp.high if most is None else min(max(most, clamp.low), clamp.high)
        kept = _kept(plain, "x-nonfinite", SCALED)
        made = {"type": kind_of(plain), "minimum": low, "maximum": high, **kept}
        return made, *_clampers(low, high)

    return _of_numbers(change, source, schema, path, "clamp needs")


_Change: TypeAlias = Callable[[Mapping[str, Any]], tuple[Any, Maker, Maker]]


def _of_numbers(
    change: _Change, source: Structure, schema: Any, path: Path, needs: str
) -> tuple[Any, Maker]:
    """Change the numbers of a field, which may be in arrays within arrays."""
    where = write_path(path)
    arrays: list[Mapping[str, Any]] = []
    plain = source.plain(schema, where)
    while kind_of(plain) == "array" and "items" in plain and "prefixItems" not in plain:
        if len(arrays) == _MAX_LEVELS:
            raise UnfitError(where, f"{needs} arrays of at most {_MAX_LEVELS} levels")
        arrays.append(plain)
        plain = source.plain(within(plain, plain["items"]), where)
    if kind_of(plain) not in ("integer", "number"):
        raise UnfitError(where, f"{needs} a number or an array of numbers")
    made, make, make_array = change(plain)
    for array in reversed(arrays):
        made, make = array_of(made, array), _in_array(make, make_array)
    return made, make


def array_of(items: Any, source: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of an array that is made item by item.

    No more than its bounds stays true: not which values it has, or that none is twice.
    """
    bounds = {key: source[key] for key in ("minItems", "maxItems") if key in source}
    return {"type": "array", "items": items, **bounds}


def _in_array(make: Maker, make_array: Maker) -> Maker:
    def apply(value: Any) -> Any:
        if not hasattr(value, "dtype"):
            return [make(item) for item in value]
        changed = make_array(value)
        return apply(value.tolist()) if changed is None else changed

    return apply


def _scalers(scale: Scale, where: str, *, is_last: bool) -> tuple[Maker, Maker]:
    """Return what scales a number, and what scales an array of numpy; None: not exactly."""
    factor, offset = scale.factor, scale.offset
    beyond = f"{where}: a scaled number is beyond those of a float"

    def number(value: Any) -> Any:
        if hasattr(value, "dtype"):  # of numpy, whose own numbers wrap
            value = value.item()
        try:
            made = value * factor + offset
        except OverflowError:
            raise MessageError(beyond) from None
        if is_last and made in _INFINITE and value not in _INFINITE:
            raise MessageError(beyond)
        return made

    def array(value: Any) -> Any:
        kind = value.dtype.kind
        if kind == "f" or (kind in "iu" and isinstance(factor, float)):
            numpy = sys.modules["numpy"]  # whose array it is
            with numpy.errstate(over="ignore"):
                made = value.astype("float64") * float(factor) + float(offset)
            are_numbers = not is_last or numpy.isfinite(made).all()
            if not are_numbers and (numpy.isinf(made) & numpy.isfinite(value)).any():
                raise MessageError(beyond)
            return made
        if kind in "iu" and value.size:
            # By the width first, which needs no look at the numbers.
            for least, most in (_limits(value.dtype), (int(value.min()), int(value.max()))):
                ends = least * factor, most * factor
                sums = (offset, *(end + offset for end in ends)) if _is_whole(offset) else ()
                met = (factor, least, most, *ends, *sums)
                width = next((bits for bits in _WIDTHS if _fit(met, bits)), None)
                if width is not None:
                    return value.astype(f"int{width}") * factor + offset
        return None

    return number, array


def _clampers(low: float, high: float) -> tuple[Maker, Maker]:
    def number(value: Any) -> Any:
        return low if value < low else min(value, high)

    def array(value: Any) -> Any:
        kind = value.dtype.kind
        if kind == "f":
            return value.astype("float64").clip(float(low), float(high))
        if kind in "iu":
            least, most = _limits(value.dtype)
            ends = max(low, least), min(high, most)
            # Else the ends are not of this width, or all would become floats.
            if low <= most and high >= least and _is_whole(*ends):
                return value.clip(*ends)
        return None

    return number, array


def _fit(numbers: Iterable[float], bits: int) -> bool:
    return all(-(2 ** (bits - 1)) <= number < 2 ** (bits - 1) for number in numbers)


def _limits(dtype: Any) -> tuple[int, int]:
    """Return the least and the greatest whole number of a type of numpy."""
    bits = 8 * dtype.itemsize
    return (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if dtype.kind == "i" else (0, 2**bits - 1)


def _is_whole(*numbers: float) -> bool:
    return all(isinstance(number, int) for number in numbers)


def _kept(plain: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: plain[key] for key in (*keys, *INHERITED) if key in plain}


def _range(schema: Mapping[str, Any], scale: Scale) -> tuple[float | None, float | None]:
    """Scale the bounds by the very arithmetic that messages meet: it is monotone, so they hold."""
    low = _ends(schema, "inimum", math.ceil, math.inf, scale)
    high = _ends(schema, "aximum", math.floor, -math.inf, scale)
    if scale.factor < 0:
        low, high = high, low
    return min(low, default=None), max(high, default=None)


def _ends(
    schema: Mapping[str, Any],
    ending: str,
    to_whole: Callable[[float], int],
    inward: float,
    scale: Scale,
) -> list[float]:
    """Scale one bound as a whole number, exactly, and as a float, rounded: messages have either."""
    bound = schema.get(f"m{ending}", schema.get(f"exclusiveM{ending}"))
    if bound is None:
        return []
    try:
        whole = to_whole(bound)
        if kind_of(schema) == "integer":
            bound = whole
        real = float(bound)
        if real != bound and (real < bound) == (inward > 0):
            real = math.nextafter(real, inward)
        made = [number * scale.factor + scale.offset for number in (whole, real)]
        return made if all(map(math.isfinite, made)) else []
    except (OverflowError, ValueError):  # beyond the floats: so are the messages, which are refused
        return []


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
