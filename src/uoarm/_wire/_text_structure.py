"""Message structures as JSON text carries them, and the way back from text to logical values."""

from __future__ import annotations

import binascii
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeAlias

from pybase64 import b64decode

from uoarm._wire._text import SAFE_INTEGER
from uoarm.errors import MessageError
from uoarm.model import Message, Schema

__all__ = ["make_reader", "text_schema"]

Reader: TypeAlias = Callable[[Message], Message]

_MAX_DEPTH = 64
_SHOWN = 100
_DIGITS = re.compile(r"-?(0|[1-9][0-9]{0,999})\Z")
_NO_BASE64 = re.compile(r"[^A-Za-z0-9+/]")
_NAMES = {"NaN": float("nan"), "Infinity": float("inf"), "-Infinity": float("-inf")}
_MAPS = ("properties", "patternProperties", "$defs", "dependentSchemas")
_LISTS = ("prefixItems", "allOf", "anyOf", "oneOf")
_ONES = ("items", "additionalProperties", "contains", "not", "if", "then", "else")


def text_schema(schema: Schema, depth: int = 0) -> Schema:
    """Return the schema of the JSON text of what a schema of logical values describes.

    Octets become base64 strings; an integer that may pass 53 bits may be a decimal string; a
    number marked `x-nonfinite` may be one of three names.
    """
    if isinstance(schema, bool) or depth > _MAX_DEPTH:
        return schema
    if schema.get("x-octets") is True:
        return {"type": "string", "contentEncoding": "base64", "x-octets": True}
    copied: dict[str, Any] = dict(schema)
    for key in _MAPS:
        if isinstance(found := copied.get(key), Mapping):
            copied[key] = {name: text_schema(value, depth + 1) for name, value in found.items()}
    for key in _LISTS:
        if isinstance(found := copied.get(key), list | tuple):
            copied[key] = [text_schema(item, depth + 1) for item in found]
    for key in _ONES:
        if isinstance(found := copied.get(key), Mapping):
            copied[key] = text_schema(found, depth + 1)
    if _is_wide(schema):
        return {"anyOf": [copied, {"type": "string", "pattern": "^-?(0|[1-9][0-9]*)$"}]}
    if schema.get("x-nonfinite"):
        return {"anyOf": [copied, {"enum": list(_NAMES)}]}
    return copied


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
        except _MisfitError as error:
            raise MessageError(error.told()) from error.__cause__

    return read


class _MisfitError(Exception):
    """Text that its place cannot carry.

    Its path is put together on the way out only: a path made for every value would cost as much as
    the longest name for each.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.path: list[str] = []

    def told(self) -> str:
        path = "".join(name[:_SHOWN] for name in reversed(self.path))
        return f"${path}: {self}"


class _Compiler:
    """Makes the readers of one schema; each reference once, so that recursion has an end."""

    def __init__(self, root: Schema) -> None:
        self._root = root
        self._references: dict[str, Reader | None] = {}

    def reader(self, schema: object, depth: int) -> Reader | None:
        if not isinstance(schema, Mapping) or depth > _MAX_DEPTH:
            return None
        if isinstance(reference := schema.get("$ref"), str):
            return self._referred(reference, depth)
        if schema.get("x-octets") is True:
            return _octets
        for key in ("anyOf", "oneOf", "allOf"):
            if isinstance(branches := schema.get(key), list | tuple):
                return self._first(branches, depth)
        if schema.get("type") == "integer":
            return _integer
        if schema.get("type") == "number":
            return _number
        return self._inside(schema, depth)

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

    def _first(self, branches: Sequence[object], depth: int) -> Reader | None:
        """Use the branch that converts, unless a branch takes strings as they are."""
        if any(
            isinstance(branch, Mapping) and branch.get("type") == "string" for branch in branches
        ):
            return None
        readers = (self.reader(branch, depth + 1) for branch in branches)
        return next((reader for reader in readers if reader is not None), None)

    def _referred(self, reference: str, depth: int) -> Reader | None:
        known = self._references
        if reference not in known:

            def later(value: Message) -> Message:
                reader = known[reference]
                return value if reader is None or reader is later else reader(value)

            known[reference] = later
            known[reference] = self.reader(_find(reference, self._root), depth + 1)
        return known[reference]


def _object(value: Any, fields: Mapping[str, Reader], rest: Reader | None) -> Any:
    if not isinstance(value, dict):
        return value
    read = dict(value)
    for name, item in value.items():
        reader = fields.get(name, rest)
        if reader is not None:
            try:
                read[name] = reader(item)
            except _MisfitError as error:
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
        except _MisfitError as error:
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
    raise _MisfitError(f"expected octets as base64 text: {why}")


def _integer(value: Any) -> Any:
    if isinstance(value, str):
        if not _DIGITS.match(value):
            raise _MisfitError(f"expected an integer or its digits, got {value[:40]!r}")
        return int(value)
    if isinstance(value, float) and abs(value) > SAFE_INTEGER:
        text = f"{value} has lost digits; write integers beyond 53 bits as strings"
        raise _MisfitError(text)
    return value


def _number(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value in _NAMES:
        return _NAMES[value]
    if _DIGITS.match(value):  # so a whole number beyond 53 bits is written, whatever is declared
        return int(value)
    raise _MisfitError(f"expected a number or {', '.join(_NAMES)}, got {value[:40]!r}")


def _is_wide(schema: Mapping[str, object]) -> bool:
    if schema.get("type") != "integer":
        return False
    low, high = schema.get("minimum"), schema.get("maximum")
    inside = isinstance(low, int | float) and isinstance(high, int | float)
    return not (inside and low >= -SAFE_INTEGER and high <= SAFE_INTEGER)  # type: ignore[operator] # both are numbers


def _find(reference: str, root: Schema) -> object:
    place: object = root
    for part in reference.removeprefix("#").split("/")[1:]:
        place = _mapping(place).get(part.replace("~1", "/").replace("~0", "~"))
    return place


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, Mapping) else {}


def _sequence(value: object) -> list[object]:
    return list(value) if isinstance(value, list | tuple) else []
