"""The structures that files of a folder define: JSON Schemas, and what plugins read."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from uoarm._lock._record import Lock, LockError, read_json
from uoarm._meaning import name_of_type
from uoarm._origin import install_command
from uoarm._plugins import cause_of, values_of
from uoarm.errors import ConfigurationError, PluginError
from uoarm.plugins import CONTRACT_VERSION, DefinitionFormat, DefinitionHooks, Definitions

__all__ = ["read_schemas", "uncompared_types"]

_DEFINITIONS = "uoarm.definitions"
_SCHEMAS = frozenset({".json", ".schema"})
_OF_ROS = frozenset({".msg", ".srv", ".action", ".idl"})
_MOST_FILES = 20_000


def read_schemas(folder: Path, lock: Lock, *, is_installed: bool = False) -> dict[str, Any]:
    """Return the JSON Schemas of a folder by the types that they are of.

    Types of schemas are named by `x-type`, by the title and by the name of the file, `.json` or
    `.schema`; those of other definitions by the plugin that reads them.

    Args:
        folder: with all that is below it.
        lock: whose types are to be readable where the folder defines them.
        is_installed: whether it is an environment, whose JSON Schemas are those of its libraries
            and stand for no type.

    Raises:
        LockError: a file or the definition of a type of the lock cannot be read, or there is none.
        ConfigurationError: what reads the files is not installed.
    """
    formats = _formats()
    known = _OF_ROS.union(
        () if is_installed else _SCHEMAS, *(format_.suffixes for format_, _ in formats)
    )
    paths = sorted(path for path in folder.rglob("*") if path.suffix in known)
    if not paths or len(paths) > _MOST_FILES:
        kinds = ", ".join(f"*{suffix}" for suffix in sorted(known))
        raise LockError(
            f"{folder}: expected 1 to {_MOST_FILES:,} files of {kinds}, got {len(paths):,}"
        )
    found: dict[str, Any] = {}
    defined_beside = {path.with_suffix("") for path in paths if path.suffix not in _SCHEMAS}
    for path in paths:
        # What an installed package has beside a definition describes it, and is no schema.
        if path.suffix not in _SCHEMAS or path.with_suffix("") in defined_beside:
            continue
        schema = read_json(path)
        if isinstance(schema, dict):
            names = (path.stem, schema.get("title"), name_of_type(schema.get("x-type")))
            found |= {name: schema for name in names if isinstance(name, str) and name}
    left = {path.suffix for path in paths} - _SCHEMAS
    for format_, point in formats:
        if format_.suffixes & left:
            left -= format_.suffixes
            defined = _read(format_, point, folder)
            _refuse_unreadable(folder, lock, defined.problems)
            found |= defined.schemas
    if left:
        raise LockError(
            f"{folder}: nothing that is installed reads its files of {sorted(left)}: definitions "
            f"of ROS are read with {install_command('uoarm-ros2', 'definitions')}"
        )
    return found


def uncompared_types(lock: Lock, schemas: Mapping[str, Any]) -> list[str]:
    """Return the types of a lock that are not among schemas, and so are not compared."""
    names = {
        frozenset({structure.native_type, name_of_type(structure.structure.get("x-type"))} - {""})
        for structure in lock.structures.values()
        if isinstance(structure.structure, Mapping)
    }
    return sorted(min(name) for name in names if name and name.isdisjoint(schemas))


def _formats() -> list[tuple[DefinitionFormat, EntryPoint]]:
    found = []
    for point in sorted(entry_points(group=_DEFINITIONS), key=lambda point: point.name):
        try:
            found += [(format_, point) for format_ in _load(point)]
        except Exception as error:
            # Without it a definition that differs would pass for one that is not there.
            text = f"the plugin {point.name} cannot be used: {cause_of(error, point)}"
            raise LockError(text) from error
    return found


def _load(point: EntryPoint) -> list[DefinitionFormat]:
    formats = values_of(point, DefinitionHooks, "uoarm_definition_formats", DefinitionFormat)
    for format_ in formats:
        if format_.contract != CONTRACT_VERSION:
            raise PluginError(
                f"it is written for version {format_.contract} of the hooks, this uoarm has "
                f"version {CONTRACT_VERSION}: install matching versions"
            )
    return formats


def _read(one: DefinitionFormat, point: EntryPoint, folder: Path) -> Definitions:
    try:
        return one.read(folder)
    except ConfigurationError:
        raise
    except Exception as error:
        text = f"{folder}: {one.name} cannot be read: {cause_of(error, point)}"
        raise LockError(text) from error


def _refuse_unreadable(folder: Path, lock: Lock, problems: Mapping[str, str]) -> None:
    """Raise LockError for the first type of the lock that cannot be read, which may differ."""
    for name in sorted(
        {structure.native_type for structure in lock.structures.values()} & set(problems)
    ):
        raise LockError(f"{folder}: the definition of {name} cannot be read: {problems[name]}")
