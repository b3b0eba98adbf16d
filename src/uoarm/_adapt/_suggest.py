"""Suggestions: the configuration lines that would make a refused edge fit, tried before offered."""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Mapping
from typing import Any

from uoarm._adapt._adaptation import adapt
from uoarm._adapt._mapping import Path, parse, write_path
from uoarm._adapt._walk import Structure, UnfitError, leaves
from uoarm.model import MessageStructure
from uoarm.schema import check

__all__ = ["suggest"]

_MAX_FIELDS = 60
_ALIKE = 0.6


def suggest(
    producer: MessageStructure,
    consumer: MessageStructure,
    fits: Callable[[Mapping[str, Any], tuple[str, ...]], bool],
) -> str:
    """Return lines to paste that make the edge fit, or nothing.

    Args:
        producer: structure of what is emitted.
        consumer: structure of what is taken.
        fits: judges a mapping with its allowed losses.
    """
    source, target = Structure(producer.schema), Structure(consumer.schema)
    try:
        mapping = _draft(source, target)
        if mapping is None:
            return ""
        losses = adapt(parse(mapping), producer.schema, consumer.schema).losses
    except (UnfitError, ValueError):
        return ""
    if not fits(mapping, losses):
        return ""
    lines = f"map: {_flow(mapping)}"
    return f"{lines}\nallow_loss: {_flow(list(losses))}" if losses else lines


def _draft(source: Structure, target: Structure) -> dict[str, Any] | None:
    """Fill every field of the consumer that the producer's field of that name does not."""
    wanted = target.fields()
    if not wanted or len(wanted) > _MAX_FIELDS:
        return None
    have = list(leaves(source))
    required = target.plain(target.schema, ".").get("required", ())
    mapping: dict[str, Any] = {}
    for name, schema in wanted.items():
        if name in source.fields() and _accepts(source, source.fields()[name], target, schema):
            continue
        path = _best(name, schema, have, source, target)
        if path is not None:
            mapping[name] = write_path(path)
        elif (value := _only_value(schema)) is not None:
            mapping[name] = {"const": value}
        elif name in required:
            return None
    return mapping


def _best(
    name: str, schema: Any, have: list[tuple[Path, Any]], source: Structure, target: Structure
) -> Path | None:
    """Return the producer's field that fits best: by name, by likeness, or as the only one."""
    fitting = [path for path, one in have if _accepts(source, one, target, schema)]
    same = [path for path in fitting if path[-1] == name]
    if same:
        return min(same, key=len)
    alike = difflib.get_close_matches(name, [path[-1] for path in fitting], n=1, cutoff=_ALIKE)
    if alike:
        return next(path for path in fitting if path[-1] == alike[0])
    return fitting[0] if len(fitting) == 1 else None


def _accepts(source: Structure, one: Any, target: Structure, other: Any) -> bool:
    return check(_with_definitions(one, source), _with_definitions(other, target)).compatible


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
