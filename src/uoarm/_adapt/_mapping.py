"""The mapping language: where the fields of a consumer's message come from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

from attrs import field, frozen

from uoarm.errors import ConfigurationError

__all__ = [
    "Clamp",
    "Each",
    "Entry",
    "Mapped",
    "MappingError",
    "Path",
    "Scale",
    "parse",
    "write_path",
]

Path: TypeAlias = "tuple[str, ...]"

_MAX_DEPTH = 16
_KEYS = {"from", "const", "scale", "offset", "enum", "each", "map", "default", "clamp"}


class MappingError(ConfigurationError):
    """A mapping that cannot be understood; the text lists every mistake."""


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
class Each:
    """An array made item by item from another."""

    source: Path
    entries: tuple[Entry, ...]


@frozen
class Entry:
    """A field of the consumer's message and where it comes from."""

    target: Path
    value: Mapped | Each


def parse(mapping: Mapping[str, Any]) -> tuple[Entry, ...]:
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
) -> tuple[Entry, ...]:
    if depth > _MAX_DEPTH:
        mistakes.append(f"{where}: nested more than {_MAX_DEPTH} levels deep")
        return ()
    entries: list[Entry] = []
    for name, rule in mapping.items():
        at = f"{where}.{name}"
        target = _path(name, at, mistakes)
        value = _value(rule, at, mistakes, depth)
        if value is not None:
            entries.append(Entry(target, value))
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


def _value(rule: Any, where: str, mistakes: list[str], depth: int) -> Mapped | Each | None:
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


def _each(rule: Mapping[str, Any], where: str, mistakes: list[str], depth: int) -> Each | None:
    if set(rule) != {"each", "map"} or not isinstance(rule["map"], Mapping):
        mistakes.append(f"{where}: each needs map, a mapping for every item, and nothing else")
        return None
    source = _path(str(rule["each"]), where, mistakes)
    return Each(source, _entries(rule["map"], where, mistakes, depth + 1))


def _from(rule: Mapping[str, Any], where: str, mistakes: list[str]) -> Mapped | None:
    source = rule["from"]
    if not isinstance(source, str):
        mistakes.append(f"{where}: from must be a path")
        return None
    if "map" in rule:
        mistakes.append(f"{where}: map belongs to each")
    for key in ("scale", "offset"):
        number = rule.get(key, 0)
        if isinstance(number, bool) or not isinstance(number, int | float):
            mistakes.append(f"{where}: {key} must be a number, got {number!r}")
            return None
    if "enum" in rule and not isinstance(rule["enum"], Mapping):
        mistakes.append(f"{where}: enum must say for each value what it becomes")
        return None
    clamp = rule.get("clamp")
    if "clamp" in rule and not _is_range(clamp):
        mistakes.append(f"{where}: clamp must be two numbers, the lower one first, got {clamp!r}")
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
        and all(isinstance(item, int | float) and not isinstance(item, bool) for item in value)
        and value[0] <= value[1]
    )
