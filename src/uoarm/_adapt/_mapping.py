"""The mapping language: where the fields of a consumer's message come from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

from attrs import field, frozen

from uoarm._encodable import shown
from uoarm._meaning import AROUND, INHERITED, said_around
from uoarm.errors import ConfigurationError
from uoarm.model import MessageStructure
from uoarm.schema import follow, portable

Path: TypeAlias = "tuple[str, ...]"

_MAX_DEPTH = 16
_ANCHORS = ("$anchor", "$dynamicAnchor")
_KEYS = {"from", "const", "scale", "offset", "enum", "each", "map", "default", "clamp"}


class MappingError(ConfigurationError):
    """A mapping that cannot be understood; the text lists every mistake."""

    error_code = "UOA-111"


@frozen
class Scale:
    """`value * factor + offset`."""

    factor: float | int = 1
    offset: float | int = 0


@frozen
class Clamp:
    """What is below `low` becomes `low`, what is above `high` becomes `high`."""

    low: float | int
    high: float | int


@frozen
class Mapped:
    """One entry: a source path, or a constant, and what is done to the value."""

    source: Path | None = None
    const: Any = field(default=None, hash=False)
    scale: Scale | None = None
    clamp: Clamp | None = None
    enum: tuple[tuple[str, Any], ...] | None = field(default=None, hash=False)
    default: Any = field(default=None, hash=False)
    has_default: bool = False


@frozen
class ArrayMapping:
    """An array made item by item from another."""

    source: Path
    entries: tuple[MappingEntry, ...]


@frozen
class MappingEntry:
    """A field of the consumer's message and where it comes from."""

    target: Path
    value: Mapped | ArrayMapping


def parse(mapping: Mapping[str, Any]) -> tuple[MappingEntry, ...]:
    """Return the entries of a mapping.

    Raises:
        MappingError: it cannot be understood; the text lists every mistake.
    """
    mistakes: list[str] = []
    entries = _entries(mapping, "map", mistakes, 0)
    if mistakes:
        raise MappingError("; ".join(mistakes))
    return entries


def write_path(path: Path) -> str:
    """Write a path as the configuration does; the whole message is a dot."""
    return ".".join(path) or "."


def _entries(
    mapping: Mapping[str, Any], where: str, mistakes: list[str], depth: int
) -> tuple[MappingEntry, ...]:
    if depth > _MAX_DEPTH:
        mistakes.append(f"{where}: nested more than {_MAX_DEPTH} levels deep")
        return ()
    entries: list[MappingEntry] = []
    for name, rule in mapping.items():
        at = f"{where}.{name}"
        target = _path(name, at, mistakes)
        value = _value(rule, at, mistakes, depth)
        if value is not None:
            entries.append(MappingEntry(target, value))
    mistakes += _overlaps([entry.target for entry in entries], where)
    return tuple(entries)


def _overlaps(targets: list[Path], where: str) -> Iterator[str]:
    """Yield what fills a field that another entry fills whole or in part; linear in the names."""
    inner: dict[Path, Path] = {}
    seen: set[Path] = set()
    for target in targets:
        outer = next((target[:end] for end in range(len(target) + 1) if target[:end] in seen), None)
        other = inner.get(target) if outer is None else outer
        if other is not None:
            yield f"{where}: {write_path(other)} and {write_path(target)} fill the same field"
        seen.add(target)
        for end in range(len(target)):
            inner.setdefault(target[:end], target)


def _path(text: str, where: str, mistakes: list[str]) -> Path:
    if text == ".":
        return ()
    parts = tuple(text.split("."))
    if not all(parts):
        mistakes.append(f"{where}: {text!r} is not a path: expected names between dots")
    return parts


def _value(rule: Any, where: str, mistakes: list[str], depth: int) -> Mapped | ArrayMapping | None:
    if isinstance(rule, str):
        return Mapped(source=_path(rule, where, mistakes))
    if not isinstance(rule, Mapping):
        mistakes.append(f"{where}: expected a path or a mapping with from, const or each")
        return None
    unknown = sorted(set(rule) - _KEYS)
    if unknown:
        mistakes.append(f"{where}: unknown key {unknown[0]!r}; known: {', '.join(sorted(_KEYS))}")
        return None
    if len({"from", "const", "each"} & set(rule)) != 1:
        mistakes.append(f"{where}: expected exactly one of from, const and each")
        return None
    if "each" in rule:
        return _each(rule, where, mistakes, depth)
    if "const" in rule:
        if len(rule) > 1:
            mistakes.append(f"{where}: const stands alone")
        return Mapped(const=rule["const"])
    return _from(rule, where, mistakes)


def _each(
    rule: Mapping[str, Any], where: str, mistakes: list[str], depth: int
) -> ArrayMapping | None:
    if set(rule) != {"each", "map"} or not isinstance(rule["map"], Mapping):
        mistakes.append(f"{where}: each needs map, a mapping for every item, and nothing else")
        return None
    if not isinstance(rule["each"], str):
        mistakes.append(f"{where}: each must be a path")
        return None
    source = _path(rule["each"], where, mistakes)
    return ArrayMapping(source, _entries(rule["map"], where, mistakes, depth + 1))


def _from(rule: Mapping[str, Any], where: str, mistakes: list[str]) -> Mapped | None:
    source = rule["from"]
    if not isinstance(source, str):
        mistakes.append(f"{where}: from must be a path")
        return None
    if "map" in rule:
        mistakes.append(f"{where}: map belongs to each")
    for key in ("scale", "offset"):
        if not _is_number(rule.get(key, 0)):
            mistakes.append(f"{where}: {key} must be a finite number, got {shown(rule[key])}")
            return None
    if "enum" in rule and not isinstance(rule["enum"], Mapping):
        mistakes.append(f"{where}: enum must say for each value what it becomes")
        return None
    clamp = rule.get("clamp")
    if "clamp" in rule and not _is_range(clamp):
        mistakes.append(
            f"{where}: clamp must be two numbers, the lower one first, got {shown(clamp)}"
        )
        return None
    scaled = "scale" in rule or "offset" in rule
    return Mapped(
        source=_path(source, where, mistakes),
        scale=Scale(rule.get("scale", 1), rule.get("offset", 0)) if scaled else None,
        clamp=Clamp(*clamp) if clamp is not None else None,
        enum=tuple(rule["enum"].items()) if "enum" in rule else None,
        default=rule.get("default"),
        has_default="default" in rule,
    )


def _is_range(value: Any) -> bool:
    return (
        isinstance(value, list | tuple)
        and len(value) == 2  # noqa: PLR2004 - both ends
        and all(map(_is_number, value))
        and value[0] <= value[1]
    )


def _is_number(value: Any) -> bool:
    """Say whether it is a number that a float can be: values may be floats."""
    try:
        return (
            isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        )
    except OverflowError:
        return False


_MAX_LEAVES = 500
_MAX_WALK_DEPTH = 12


class UnfitError(Exception):
    """A mapping does not fit a structure; the text says where."""

    def __init__(self, path: str, sentence: str) -> None:
        super().__init__(sentence)
        self.path = path


def kind_of(schema: Mapping[str, Any]) -> Any:
    """Return the type of all that a schema accepts; None: it may be of several."""
    kind = schema.get("type")
    if isinstance(kind, list | tuple):
        return kind[0] if len(kind) == 1 else None
    return kind


def within(around: Mapping[str, Any], schema: Any) -> Any:
    """Return the schema of a part, with the meaning that is said around it."""
    said = tuple((key, around[key]) for key in INHERITED if key in around)
    if not said or not isinstance(schema, Mapping):
        return schema
    # An anchor names one place: the definition that references lead to, and not this copy of it.
    own = {key: value for key, value in schema.items() if key not in _ANCHORS}
    return {**own, AROUND: said}


@frozen
class SchemaField:
    """The schema at a path, and whether every message has it."""

    schema: Any
    always: bool


class Structure:
    """A schema that is walked; references are followed.

    Args:
        schema: JSON Schema.
        whole: the structure that it is a part of; None where it stands alone.

    Attributes:
        definitions: keywords of the root in which all is that references lead to.
    """

    def __init__(self, schema: Any, whole: Structure | None = None) -> None:
        inner, own = (schema, {}) if whole is not None else portable(schema)
        self.definitions: dict[str, Any] = own if whole is None else whole.definitions
        self.schema = {**inner, **own} if own else inner

    def plain(self, schema: Any, path: str) -> Mapping[str, Any]:
        """Return a schema with references followed, and what stands beside them of its meaning.

        Raises:
            UnfitError: it is `true`, `false`, or refers to what is not in the structure.
        """
        around: dict[str, Any] = {}
        said: dict[str, Any] = {}
        for _ in range(32):
            if not isinstance(schema, Mapping):
                raise UnfitError(path, "the structure says nothing of this field")
            around |= said_around(schema)
            said = {key: schema[key] for key in INHERITED if key in schema} | said
            if "$ref" not in schema:
                return {**around, **schema, **said} if said or around else schema
            if "properties" in schema:
                raise UnfitError(path, "fields stand beside a reference, which no map takes apart")
            target = follow(self.definitions, schema["$ref"])
            if target is None:
                raise UnfitError(
                    path, f"the reference {shown(schema['$ref'])} cannot be followed here"
                )
            schema = target
        raise UnfitError(path, "the references go in a circle")

    def at(self, path: Path, *, is_emitted: bool = True) -> SchemaField:
        """Return the field at a path, with what the objects around it say of its meaning.

        Args:
            path: of the field.
            is_emitted: whether it is read from messages, which must then be objects up to it.

        Raises:
            UnfitError: there is no such field, or a choice or what is no object stands in the way.
        """
        schema, always = self.schema, True
        said: dict[str, Any] = {}
        for number, part in enumerate(path):
            where = write_path(path[: number + 1])
            one = self.plain(schema, where)
            fields = one.get("properties", {})
            if part not in fields:
                has = ", ".join(fields) or "none"
                raise UnfitError(where, f"there is no field {part!r}; there is {has}")
            if any(key in one for key in ("anyOf", "oneOf", "allOf", "if")):
                raise UnfitError(where, "a choice of structures stands in the way")
            if is_emitted and kind_of(one) != "object":
                text = "a message may have no object here: its structure has not `type: object`"
                raise UnfitError(write_path(path[:number]), text)
            always = always and part in one.get("required", ())
            said |= {key: one[key] for key in INHERITED if key in one}
            schema = fields[part]
        return SchemaField(within(said, schema), always)

    def items(self, array: Mapping[str, Any]) -> Structure:
        """Return the structure of the items of an array, a plain schema within this one."""
        return Structure(within(array, array["items"]), self)

    def fields(self) -> Mapping[str, Any]:
        """Return the named fields of the whole message, none for what is no object."""
        try:
            fields: Mapping[str, Any] = self.plain(self.schema, ".").get("properties", {})
        except UnfitError:
            return {}
        return fields


def leaves(structure: Structure) -> Iterator[tuple[Path, Any]]:
    """Yield every field path of a structure with its schema, outer before inner, bounded."""
    waiting: list[tuple[Path, Any]] = [((), structure.schema)]
    count = 0
    for path, schema in waiting:
        try:
            plain = structure.plain(schema, write_path(path))
        except UnfitError:
            continue
        for name, child in plain.get("properties", {}).items():
            count += 1
            if count > _MAX_LEAVES:
                return
            yield (*path, name), child
            if len(path) < _MAX_WALK_DEPTH:
                waiting.append(((*path, name), child))


def number_problem(structure: MessageStructure, path: str) -> str:
    """Return why the field at a path is no number in every message; nothing where it is one."""
    try:
        walked = Structure(structure.schema)
        parts = () if path == "." else tuple(path.split("."))
        found = walked.at(parts)
        kind = kind_of(walked.plain(found.schema, path))
    except UnfitError as error:
        return f"{error.path}: {error}"
    if kind not in ("number", "integer"):
        return f"{path} is no number"
    return "" if found.always else f"{path} may be missing"
