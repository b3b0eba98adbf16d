"""What messages are as JSON text, by their schema: its own schema, and a reader of values."""

from __future__ import annotations

import binascii
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias

import orjson
from pybase64 import b64decode

from uoarm._wire._text import SAFE_INTEGER
from uoarm.errors import MessageError
from uoarm.model import Message, Schema
from uoarm.schema import change_parts, document_of, follow

Reader: TypeAlias = Callable[[Message], Message]
_MAX_DEPTH = 64
_MOST_PARTS = 10_000
_SHOWN = 100
_DIGITS = re.compile(r"-?(0|[1-9][0-9]{0,999})\Z")
_MOST_DIGITS = 10**1000
_NO_BASE64 = re.compile(r"[^A-Za-z0-9+/]")
_NAMES = {"NaN": float("nan"), "Infinity": float("inf"), "-Infinity": float("-inf")}


def text_schema(schema: Schema, depth: int = 0) -> Schema:
    """Return the schema of the JSON text of what a schema of logical values describes.

    Octets become base64 strings; an integer that may pass 53 bits may be a decimal string; a
    number marked `x-nonfinite` may be one of three names.
    """
    if isinstance(schema, bool) or depth > _MAX_DEPTH:
        return schema
    if schema.get("x-octets") is True:
        return {"type": "string", "contentEncoding": "base64", "x-octets": True}
    copied = change_parts(schema, lambda part: text_schema(part, depth + 1))
    if digits := _wide_values(schema):
        return {"anyOf": [copied, {"enum": list(digits)}]}
    if _is_wide(schema):
        return {"anyOf": [copied, {"type": "string", "pattern": "^-?(0|[1-9][0-9]*)$"}]}
    if schema.get("x-nonfinite"):
        return {"anyOf": [copied, {"enum": list(_NAMES)}]}
    return copied


def viewer_schema(schema: Schema) -> str:
    """Return what viewers are given for the schema of a JSON text; empty: messages are no objects.

    Foxglove and Lichtblick show nothing of a channel where one field has several types, is a tuple
    or a list of lists. Such fields are left out here, and are in the messages all the same. What
    may be null, or a text because no JSON number says it, has the type that it has else.
    """
    viewed = _viewed(schema, schema, 0, frozenset(), itertools.count())
    return orjson.dumps(viewed).decode() if viewed and viewed["type"] == "object" else ""


def _viewed(
    schema: object,
    document: object,
    depth: int,
    around: frozenset[tuple[int, str]],
    parts: Iterator[int],
) -> dict[str, Any] | None:
    """Return the same of one part; None: it has no single type.

    Args:
        schema: of the part.
        document: in which its references lead somewhere.
        depth: of the part.
        around: references that it stands behind, where one more of them has no end.
        parts: counts them: behind references to references there may be any number.
    """
    if not isinstance(schema, Mapping) or depth > _MAX_DEPTH or next(parts) > _MOST_PARTS:
        return None
    document = document_of(schema, document)

    def viewed(part: object, behind: frozenset[tuple[int, str]] = around) -> dict[str, Any] | None:
        return _viewed(part, document, depth + 1, behind, parts)

    if isinstance(reference := schema.get("$ref"), str):
        place = id(document), reference
        return None if place in around else viewed(follow(document, reference), around | {place})
    if schema.get("x-octets") is True:
        return {"type": "string", "contentEncoding": "base64"}
    some = [part for part in _sequence(schema.get("anyOf")) if part != {"type": "null"}]
    if len(some) == 1:
        return viewed(some[0])
    kind, values = schema.get("type"), _sequence(schema.get("enum"))
    if kind == "object":
        inner = _mapping(schema.get("properties")).items()
        fields = {name: viewed(part) for name, part in inner}
        return {"type": kind, "properties": {name: fields[name] for name in fields if fields[name]}}
    if kind == "array" and "prefixItems" not in schema:
        items = viewed(schema.get("items"))
        is_listed = items and items["type"] != "array" and "contentEncoding" not in items
        return {"type": kind, "items": items} if is_listed else None
    if values and all(isinstance(value, str) for value in values):
        return {"type": "string"}
    return {"type": kind} if kind in ("boolean", "integer", "number", "string") else None


def make_reader(schema: Schema) -> Callable[[Message], Message] | None:
    """Return a function from a parsed JSON text to the logical value; None: nothing to change.

    The function raises MessageError for text that is not what its place may carry; whether the
    result matches the schema is checked elsewhere.
    """
    reader = _Compiler(schema).reader(schema, 0)
    if reader is None:
        return None

    def read(message: Message) -> Message:
        try:
            return reader(message)
        except _UnwritableTextError as error:
            raise MessageError(error.describe()) from error.__cause__

    return read


class _UnwritableTextError(Exception):
    """Text that its place cannot carry.

    Its path is put together on the way out only: a path made for every value would cost as much as
    the longest name for each.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.path: list[str] = []

    def describe(self) -> str:
        path = "".join(name[:_SHOWN] for name in reversed(self.path))
        return f"${path}: {self}"


class _Compiler:
    """Makes the readers of one schema; each reference once, so that recursion has an end."""

    def __init__(self, root: Schema) -> None:
        self._root = root
        self._references: dict[str, Reader | None] = {}

    def reader(
        self, schema: object, depth: int, around: frozenset[str] = frozenset()
    ) -> Reader | None:
        """Return what reads a value; the references `around` it are to the same value."""
        if not isinstance(schema, Mapping) or depth > _MAX_DEPTH:
            return None
        if document_of(schema, self._root) is not self._root:
            return _Compiler(schema).reader(schema, depth)
        readers = [self._own(schema, depth)]
        if isinstance(reference := schema.get("$ref"), str) and reference not in around:
            readers.append(self._referred(reference, depth, around | {reference}))
        parts = _sequence(schema.get("allOf"))
        readers += [self.reader(part, depth + 1, around) for part in parts]
        choices = (_sequence(schema.get(key)) for key in ("anyOf", "oneOf"))
        readers += [self._choice(branches, depth, around) for branches in choices]
        every = [reader for reader in readers if reader is not None]
        return every[0] if len(every) == 1 else partial(_in_turn, every) if every else None

    def _own(self, schema: Mapping[str, object], depth: int) -> Reader | None:
        if schema.get("x-octets") is True:
            return _octets
        if digits := _wide_values(schema):
            return lambda value: digits.get(value, value) if isinstance(value, str) else value
        kinds = _kinds(schema)
        of_numbers = _number if "number" in kinds else _integer if "integer" in kinds else None
        inside = self._inside(schema, depth)
        if of_numbers is None or "string" in kinds:
            return inside
        return of_numbers if inside is None else partial(_in_turn, (of_numbers, inside))

    def _inside(self, schema: Mapping[str, object], depth: int) -> Reader | None:
        fields = {
            name: reader
            for name, item in _mapping(schema.get("properties")).items()
            if (reader := self.reader(item, depth + 1)) is not None
        }
        rest = self.reader(schema.get("additionalProperties"), depth + 1)
        if fields or rest is not None:
            return lambda value: _object(value, fields, rest)
        heads = [self.reader(item, depth + 1) for item in _sequence(schema.get("prefixItems"))]
        items = self.reader(schema.get("items"), depth + 1)
        if any(heads) or items is not None:
            return lambda value: _array(value, heads, items)
        return None

    def _choice(
        self, branches: Sequence[object], depth: int, around: frozenset[str]
    ) -> Reader | None:
        """Read a value as the first branch that it may be of; texts are left where one has them."""
        readers = [self.reader(branch, depth + 1, around) for branch in branches]
        if not any(readers):
            return None
        ways = [
            (branch, reader)
            for branch, reader in zip(branches, readers, strict=True)
            if reader is not None or not _kinds(branch) or _kinds(branch) - _UNREAD
        ]
        if len(ways) == 1:  # beside null, mostly
            return ways[0][1]
        has_texts = any("string" in _kinds(branch) for branch in branches)
        texts = [text for branch in branches for text in _values(branch)]

        def read(value: Message) -> Message:
            if isinstance(value, str) and (has_texts or value in texts):
                return value
            wrong: _UnwritableTextError | None = None
            steps = itertools.count()
            for branch, reader in ways:
                if self._may_be(branch, value, steps, 0):
                    try:
                        return value if reader is None else reader(value)
                    except _UnwritableTextError as error:
                        wrong = wrong or error
            if wrong is not None:
                raise wrong
            return value

        return read

    def _may_be(self, schema: object, value: Any, steps: Iterator[int], depth: int) -> bool:
        """Say whether JSON text may be of a schema, by its kind, its names and its tags."""
        if not isinstance(schema, Mapping):
            return schema is not False  # nor is what is not stated
        is_outside = document_of(schema, self._root) is not self._root
        if is_outside or depth > _MAX_DEPTH or next(steps) > _MOST_PARTS:
            return True
        kinds = _OCTET_KINDS if schema.get("x-octets") is True else _kinds(schema)
        if kinds and kinds.isdisjoint(_KINDS.get(value.__class__, ())):
            return False
        values = _values(schema)
        is_digits = isinstance(value, str) and value in _wide_values(schema)
        if values and value not in values and not is_digits:
            return False
        parts = [(part, value) for part in _sequence(schema.get("allOf"))]
        if isinstance(reference := schema.get("$ref"), str):
            parts.append((follow(self._root, reference), value))
        if isinstance(value, dict):
            fields = _mapping(schema.get("properties"))
            is_closed = schema.get("additionalProperties") is False
            if is_closed and "patternProperties" not in schema and value.keys() - fields.keys():
                return False
            if not value.keys() >= {*_sequence(schema.get("required"))}:
                return False
            parts += [(part, value[name]) for name, part in fields.items() if name in value]
        elif isinstance(value, list) and value:  # the first is like the rest, mostly
            heads = _sequence(schema.get("prefixItems"))
            parts.append((heads[0] if heads else schema.get("items"), value[0]))
        return all(self._may_be(part, item, steps, depth + 1) for part, item in parts) and all(
            any(self._may_be(part, value, steps, depth + 1) for part in _sequence(schema[key]))
            for key in ("anyOf", "oneOf")
            if key in schema
        )

    def _referred(self, reference: str, depth: int, around: frozenset[str]) -> Reader | None:
        known = self._references
        if reference not in known:

            def later(value: Message) -> Message:
                reader = known[reference]
                return value if reader is None or reader is later else reader(value)

            known[reference] = later
            known[reference] = self.reader(follow(self._root, reference), depth + 1, around)
        return known[reference]


def _in_turn(readers: Sequence[Reader], value: Any) -> Any:
    """Read as each says; what one has read is left by the next."""
    for reader in readers:
        value = reader(value)
    return value


def _object(value: Any, fields: Mapping[str, Reader], rest: Reader | None) -> Any:
    if not isinstance(value, dict):
        return value
    read = dict(value)
    for name, item in value.items():
        reader = fields.get(name, rest)
        if reader is not None:
            try:
                read[name] = reader(item)
            except _UnwritableTextError as error:
                error.path.append(f".{name}")
                raise
    return read


def _array(value: Any, heads: list[Reader | None], items: Reader | None) -> Any:
    if not isinstance(value, list):
        return value
    read = []
    for place, item in enumerate(value):
        reader = heads[place] if place < len(heads) else items
        try:
            read.append(item if reader is None else reader(item))
        except _UnwritableTextError as error:
            error.path.append(f"[{place}]")
            raise
    return read


def _octets(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    try:
        return b64decode(value, validate=True)
    except (binascii.Error, ValueError):
        return _unpadded(value)


def _unpadded(text: str) -> bytes:
    """Return the octets of base64 whose `=` at the end were left out, as many encoders do."""
    digits = text.rstrip("=")
    wrong = _NO_BASE64.search(digits)
    if wrong is None and len(text) == len(digits):
        with suppress(binascii.Error, ValueError):
            return b64decode(text + "=" * (-len(text) % 4), validate=True)
    why = (
        f"{len(text):,} characters make no whole number of octets"
        if wrong is None
        else f"character {wrong.start() + 1:,} is {wrong[0]!r}, expected A-Z, a-z, 0-9, + and /"
    )
    raise _UnwritableTextError(f"expected octets as base64 text: {why}")


def _integer(value: Any) -> Any:
    if isinstance(value, str):
        if not _DIGITS.match(value):
            raise _UnwritableTextError(f"expected an integer or its digits, got {value[:40]!r}")
        return int(value)
    if isinstance(value, float) and abs(value) > SAFE_INTEGER:
        text = f"{value} has lost digits; write integers beyond 53 bits as strings"
        raise _UnwritableTextError(text)
    return value


def _number(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value in _NAMES:
        return _NAMES[value]
    if _DIGITS.match(value):  # so a whole number beyond 53 bits is written, whatever is declared
        return int(value)
    raise _UnwritableTextError(f"expected a number or {', '.join(_NAMES)}, got {value[:40]!r}")


# Of which schema each value of JSON may be: texts stand for numbers, too.
_KINDS: Mapping[type, frozenset[str]] = {
    type(None): frozenset({"null"}),
    bool: frozenset({"boolean"}),
    int: frozenset({"integer", "number"}),
    float: frozenset({"integer", "number"}),
    str: frozenset({"string", "integer", "number"}),
    list: frozenset({"array"}),
    dict: frozenset({"object"}),
}
_OCTET_KINDS = frozenset({"string", "array"})
_UNREAD = frozenset({"null", "boolean"})


def _kinds(schema: object) -> frozenset[object]:
    kind = _mapping(schema).get("type")
    return frozenset({kind} if isinstance(kind, str) else _sequence(kind))


def _values(schema: object) -> list[object]:
    """Return the only values of a schema; none where it names none."""
    mapping = _mapping(schema)
    return [mapping["const"]] if "const" in mapping else _sequence(mapping.get("enum"))


def _wide_values(schema: object) -> dict[str, int]:
    """Return those that are integers beyond 53 bits, as far as digits say them, by these."""
    return {
        str(value): value
        for value in _values(schema)
        if value.__class__ is int and SAFE_INTEGER < abs(value) < _MOST_DIGITS
    }


def _is_wide(schema: Mapping[str, object]) -> bool:
    kinds = _kinds(schema)
    if "integer" not in kinds or "string" in kinds:
        return False
    low, high = schema.get("minimum"), schema.get("maximum")
    inside = isinstance(low, int | float) and isinstance(high, int | float)
    return not (inside and low >= -SAFE_INTEGER and high <= SAFE_INTEGER)  # type: ignore[operator] # both are numbers


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, Mapping) else {}


def _sequence(value: object) -> list[object]:
    return list(value) if isinstance(value, list | tuple) else []
