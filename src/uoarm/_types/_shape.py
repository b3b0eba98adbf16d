"""What a type can say of a structure: at least every message of it, and more where types end."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from attrs import field, frozen

from uoarm._lock import Lock
from uoarm.schema import follow

_MOST_DEPTH = 24
_MOST_NODES = 5_000
_MOST_LITERALS = 200
_SAFE = 2**53 - 1
_KINDS = {"null", "boolean", "integer", "number", "string", "array", "object"}
# What the modules that are written use themselves.
_RESERVED = frozenset({
    "Any", "Array", "Callable", "Connection", "False", "FunctionName", "Inputs", "Integer",
    "Literal", "Never", "None", "NotRequired", "Number", "Numbers", "Object", "Octets", "Outputs",
    "Promise", "Protocol", "QueuePolicy", "Real", "RecordShape", "Replies", "Requests",
    "RequestOptions", "Robot", "RobotManager", "Stream", "String", "True", "TypeAlias",
    "TypedDict", "TypedRobot", "TypedStream", "Uint8Array", "ValidationMode", "bool", "boolean",
    "bytes", "cast", "dict", "float", "int", "list", "never", "null", "number", "object",
    "overload", "str", "string", "symbol", "type", "typed", "undefined", "unknown",
})  # fmt: skip


@frozen
class Plain:
    """`any`, `never`, `null`, `boolean`, `integer`, `wide` integer, `number`, `string`, `octets`.

    `note` says what the structure demands and the type does not.
    """

    kind: str
    note: str = ""


@frozen
class Literals:
    """One of these texts, whole numbers, booleans or null."""

    values: tuple[str | int | bool | None, ...]


@frozen
class Array:
    """An array; of a `tuple` each item has a shape of its own, and there are as many items."""

    items: Shape
    tuple: tuple[Shape, ...] | None = None
    note: str = ""


@frozen
class Table:
    """An object whose members have names that are not known, and values of one shape."""

    values: Shape


@frozen
class Union:
    """One of several shapes."""

    parts: tuple[Shape, ...]


@frozen
class RecordReference:
    """A record, by its name."""

    name: str


Shape = Plain | Literals | Array | Table | Union | RecordReference
ANY = Plain("any")


@frozen
class RecordShape:
    """An object with named members: name to shape, and whether it is always there."""

    name: str
    members: dict[str, tuple[Shape, bool]] = field(factory=dict)
    note: str = ""


class UniqueNames:
    """Hands out each name once; what comes later gets a number."""

    def __init__(self, reserved: frozenset[str]) -> None:
        self._used = {name.lower() for name in reserved}

    def give(self, *words: str) -> str:
        """Return a type's name of words in any script: letters and digits, in capitals."""
        parts = [part for word in words for part in re.findall("[A-Za-z0-9]+", word)]
        whole = "".join(part[0].upper() + part[1:] for part in parts)[:80] or "Type"
        whole = whole if whole[0].isalpha() else f"T{whole}"
        name, number = whole, 1
        while name.lower() in self._used:
            number += 1
            name = f"{whole}{number}"
        self._used.add(name.lower())
        return name


class Shaper:
    """Reads the shape of one structure, and collects its records.

    Whatever a type cannot say is left out, which only widens it: of several demands on one value
    any one is true of it. It does not raise for anything that JSON can be.
    """

    def __init__(self, schema: Any, name: str, names: UniqueNames) -> None:
        self._root = schema
        self._names = names
        self._nodes = 0
        self._open: list[str] = []
        self._known: dict[str, RecordReference] = {}
        # A `$ref` below another `$id` is of another document.
        self._pointers = sum(1 for _ in _identified(schema)) == 0
        self.records: list[RecordShape] = []
        self.shape = self._shape(schema, name, 0)

    def _shape(self, schema: Any, name: str, depth: int, pointer: str = "#") -> Shape:
        self._nodes += 1
        if schema is False:
            return Plain("never")
        if not isinstance(schema, Mapping):
            return ANY if schema is True else Plain("any", "no JSON Schema")
        if depth > _MOST_DEPTH or self._nodes > _MOST_NODES:
            return Plain("any", "too deep or too large")
        if "$ref" in schema:
            return self._reference(schema["$ref"], name, depth)
        if "const" in schema:
            return _literals([schema["const"]])
        if isinstance(schema.get("enum"), list):
            return _literals(schema["enum"])
        kinds = schema.get("type")
        kinds = [kinds] if isinstance(kinds, str) else kinds
        if isinstance(kinds, list) and kinds and all(_is_kind(kind) for kind in kinds):
            return _union([self._typed(schema, kind, name, depth, pointer) for kind in kinds])
        for keyword in ("anyOf", "oneOf"):
            parts = schema.get(keyword)
            if isinstance(parts, list) and parts:
                return _union([self._shape(part, name, depth + 1) for part in parts])
        parts = schema.get("allOf")
        if isinstance(parts, list) and parts:
            return self._all_of(parts, name, depth)
        note = "" if not schema.keys() - {"title", "description", "$id", "$schema"} else "untyped"
        return Plain("any", note)

    def _all_of(self, parts: list[Any], name: str, depth: int) -> Shape:
        """Return the first shape that says something: what fits all fits that one."""
        for part in parts:
            found = self._shape(part, name, depth + 1)
            if not (isinstance(found, Plain) and found.kind == "any"):
                return found
        return Plain("any", "untyped")

    def _reference(self, reference: Any, name: str, depth: int) -> Shape:
        if not isinstance(reference, str) or not self._pointers or reference[:1] != "#":
            return Plain("any", "a reference elsewhere")
        if reference in self._known:
            return self._known[reference]
        if reference in self._open:
            return Plain("any", "recursive")
        target = follow(self._root, reference)
        if target is None:
            return Plain("any", "a reference to nothing")
        self._open.append(reference)
        found = self._shape(target, name, depth + 1, reference)
        self._open.pop()
        return found

    def _typed(self, schema: Mapping[str, Any], kind: str, name: str, depth: int, at: str) -> Shape:
        if kind == "integer":
            low, high = schema.get("minimum"), schema.get("maximum")
            return Plain("integer" if _is_safe(low) and _is_safe(high) else "wide")
        if kind == "array":
            return self._array(schema, name, depth)
        if kind == "object":
            return self._object(schema, name, depth, at)
        return Plain(kind)

    def _array(self, schema: Mapping[str, Any], name: str, depth: int) -> Shape:
        low, high = schema.get("minItems"), schema.get("maxItems")
        if schema.get("x-octets") is True:
            return Plain("octets", f"{low} octets" if _is_count(low) and low == high else "")
        first, rest = schema.get("prefixItems"), schema.get("items", True)
        if isinstance(rest, list):  # of drafts before 2020-12
            return Array(Plain("any", "items of an older draft"))
        if isinstance(first, list) and first:
            items = tuple(self._shape(item, f"{name}Item", depth + 1) for item in first)
            if (rest is False or high == len(items)) and low == len(items):
                return Array(_union([*items]), items, f"{low} items")
            others = [] if rest is False else [self._shape(rest, f"{name}Item", depth + 1)]
            return Array(_union([*items, *others]), note="the first items are of fixed types")
        note = f"{low} items" if _is_count(low) and low == high else ""
        return Array(self._shape(rest, f"{name}Item", depth + 1), note=note)

    def _object(self, schema: Mapping[str, Any], name: str, depth: int, at: str) -> Shape:
        members = schema.get("properties")
        members = members if isinstance(members, Mapping) else {}
        reports = schema.get("required")
        reports = reports if isinstance(reports, list) else []
        required = {item for item in reports if isinstance(item, str)}
        others = schema.get("additionalProperties", True)
        patterns = schema.get("patternProperties")
        if not members and not required and (patterns or others is not False):
            if patterns:
                return Table(Plain("any", "values as patternProperties of their names say"))
            return Table(self._shape(others, f"{name}Value", depth + 1))
        own = RecordReference(self._names.give(name))
        if at in self._open or at == "#":
            self._known[at] = own
        note = "other members are allowed" if patterns or others is not False else ""
        place = len(self.records)
        self.records.append(RecordShape(own.name))
        shapes = {}
        for key in [*members, *sorted(required - members.keys())]:
            shape = self._shape(members.get(key, True), f"{own.name} {key}", depth + 1)
            if key in required or shape != Plain("never"):
                shapes[key] = shape, key in required
        self.records[place] = RecordShape(own.name, shapes, note)
        return own


def notes_of(shape: Shape) -> Iterator[str]:
    """Yield what the structure demands of a value and a type does not say, records not entered."""
    if isinstance(shape, Plain | Array) and shape.note:
        yield shape.note
    if isinstance(shape, Array):
        yield from notes_of(shape.items)
    elif isinstance(shape, Table):
        yield from notes_of(shape.values)
    elif isinstance(shape, Union):
        for part in shape.parts:
            yield from notes_of(part)


def _literals(values: list[Any]) -> Shape:
    if not values or len(values) > _MOST_LITERALS:
        return Plain("any", f"an enumeration of {len(values)} values")
    if all(value is None or isinstance(value, bool | int | str) for value in values):
        if all(not isinstance(value, int) or _is_safe(value) for value in values):
            kept = {(type(value), value): value for value in values}
            return Literals(tuple(kept.values()))
        return Plain("any", "an enumeration with wide integers")
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return Plain("number", "an enumeration")
    return Plain("any", "an enumeration of objects, arrays or numbers")


def _union(shapes: list[Shape]) -> Shape:
    """Return one of several; where one is anything, all is."""
    parts: list[Shape] = []
    for shape in shapes:
        for part in shape.parts if isinstance(shape, Union) else (shape,):
            if isinstance(part, Plain) and part.kind == "any":
                return Plain("any", part.note)
            if part not in parts and part != Plain("never"):
                parts.append(part)
    if not parts:
        return Plain("never")
    return parts[0] if len(parts) == 1 else Union(tuple(parts))


def _identified(schema: Any) -> Iterator[str]:
    """Yield every `$id` below the root."""
    waiting = [*schema.values()] if isinstance(schema, Mapping) else []
    while waiting:
        one = waiting.pop()
        if isinstance(one, Mapping):
            if isinstance(one.get("$id"), str):
                yield one["$id"]
            waiting.extend(one.values())
        elif isinstance(one, list):
            waiting.extend(one)


def _is_kind(kind: Any) -> bool:
    return isinstance(kind, str) and kind in _KINDS


def _is_safe(value: Any) -> bool:
    return isinstance(value, int | float) and -_SAFE <= value <= _SAFE


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


@frozen
class Root:
    """The type of one structure: its name, what it is, and the records below it."""

    name: str
    schema: Any
    shape: Shape
    records: tuple[RecordShape, ...]


@frozen
class FunctionTypes:
    """What applications send to a function and get from it: port to the name of the type.

    `refused` says that it has no plan.
    """

    outputs: dict[str, str] = field(factory=dict)
    inputs: dict[str, str] = field(factory=dict)
    request: str = ""
    reply: str = ""
    refused: bool = False

    def names(self, function: str) -> Iterator[tuple[str, str]]:
        """Yield by which names an output may be asked for, and its type."""
        if len(self.outputs) == 1:
            yield function, next(iter(self.outputs.values()))
        for output, kind in self.outputs.items():
            yield f"{function}.{output}", kind


@frozen
class RobotTypes:
    """All functions of a robot, by name, and the types of their structures."""

    functions: dict[str, FunctionTypes]
    roots: tuple[Root, ...]


def read_functions(lock: Lock) -> RobotTypes:
    """Return the functions of a lock, in the order of their names; it does not raise."""
    names = UniqueNames(_RESERVED)
    roots: dict[str, Root] = {}
    functions: dict[str, FunctionTypes] = {}
    for name, locked in sorted(lock.functions.items()):
        if not locked.parts:
            functions[name] = FunctionTypes(refused=True)
            continue
        provider = locked.parts[-1]
        fed = {edge.input for edge in locked.edges if edge.consumer == provider.component}
        function = FunctionTypes()
        single: dict[str, str] = {}
        for port, fingerprint in sorted(provider.ports.items()):
            kind, _, own = port.partition(".")
            if kind == "input" and own in fed:
                continue
            if fingerprint not in roots:
                schema = lock.structure(fingerprint).schema
                wanted = f"{name} {kind} {'' if own == 'default' else own}"
                made = Shaper(schema, wanted, names)
                shape = made.shape
                root = shape.name if isinstance(shape, RecordReference) else names.give(wanted)
                roots[fingerprint] = Root(root, schema, shape, tuple(made.records))
            text = roots[fingerprint].name
            if kind == "output":
                function.outputs[own] = text
            elif kind == "input":
                function.inputs[own] = text
            else:
                single[kind] = text
        functions[name] = FunctionTypes(
            function.outputs, function.inputs, single.get("request", ""), single.get("reply", "")
        )
    return RobotTypes(functions, tuple(roots.values()))


def write_document(robot: RobotTypes) -> str:
    """Return a JSON Schema with the structures below `$defs`, each a document of its own.

    `x-functions` says which function has which.
    """
    taken: set[str] = set()
    definitions: dict[str, Any] = {}
    for root in robot.roots:
        schema = root.schema
        if isinstance(schema, Mapping):
            own = schema.get("$id")
            # With one, `#/…` in it is of itself and not of the whole.
            if not isinstance(own, str) or own in taken:
                own = f"urn:uoarm:{root.name}"
            taken.add(own)
            schema = {**schema, "$id": own}
        definitions[root.name] = schema
    functions = {
        name: {
            **{f"output.{port}": _reference(kind) for port, kind in function.outputs.items()},
            **{f"input.{port}": _reference(kind) for port, kind in function.inputs.items()},
            **({"request": _reference(function.request)} if function.request else {}),
            **({"reply": _reference(function.reply)} if function.reply else {}),
        }
        for name, function in robot.functions.items()
    }
    whole = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$defs": definitions,
        "x-functions": functions,
    }
    return json.dumps(whole, indent=2, sort_keys=True) + "\n"


def _reference(name: str) -> dict[str, str]:
    return {"$ref": f"#/$defs/{name}"}
