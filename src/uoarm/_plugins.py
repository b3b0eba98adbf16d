"""What a plugin says through its hooks: loaded on its own, so that its mistakes stay its own."""

from __future__ import annotations

import sys
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import pluggy
from attrs import frozen

from uoarm._origin import install_command
from uoarm._raised import foreign, text_of
from uoarm.errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

hookspec = pluggy.HookspecMarker("uoarm")
hookimpl = pluggy.HookimplMarker("uoarm")

T = TypeVar("T")
Folders: TypeAlias = tuple[tuple[str, int], ...]

_found: dict[str, tuple[Folders, tuple[EntryPoint, ...]]] = {}


@frozen
class PluginProblem:
    """An installed plugin that cannot be used."""

    name: str
    cause: str


def installed(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group, those found before where nothing was installed since.

    Reading the metadata of every distribution takes many times as long as looking at the folders,
    as which `importlib.metadata` itself knows what it may keep: an installation changes one.
    """
    folders = tuple((path, _changed(path)) for path in sys.path)
    before = _found.get(group)
    if before is not None and before[0] == folders:
        return before[1]
    from importlib.metadata import entry_points  # noqa: PLC0415 - slow import

    points = tuple(entry_points(group=group))
    _found[group] = folders, points
    return points


def _changed(path: str) -> int:
    """Return when a folder of modules was changed; 0 for one that is not there."""
    try:
        return Path(path).stat().st_mtime_ns
    except OSError:
        return 0


def cause_of(error: Exception, point: EntryPoint | None) -> str:
    """Return why a plugin cannot be used, from what its code raised.

    Where a package that it needs is missing, the text says what installs that: the plugin itself,
    once more, since its metadata name what it needs.
    """
    cause = text_of(error)
    if isinstance(error, ImportError) and point is not None and point.dist is not None:
        cause += f": `{install_command(point.dist.name)}` brings what it needs"
    return cause


# Pluggy reads every attribute of a module for it, which each manager of a process would pay for.
@lru_cache(maxsize=64)
def _registered(module: object, name: str, specification: type) -> pluggy.PluginManager:
    """Return the hooks of one module, whose mistakes affect no other plugin."""
    manager = pluggy.PluginManager("uoarm")
    manager.add_hookspecs(specification)
    manager.register(module, name=name)
    manager.check_pending()
    return manager


def values_of(point: EntryPoint, specification: type, hook: str, kind: type[T]) -> list[T]:
    """Return what the module behind an entry point answers to a hook.

    Args:
        point: names the module.
        specification: class whose methods are the hooks of its group.
        hook: which of them is called.
        kind: of the values that it returns in a list.

    Raises:
        PluginError: the module does not implement the hook, or returns something else.
        Exception: whatever the module raises; contained where it is none.
    """
    manager = _registered(foreign(point.load), point.name, specification)
    answers: list[list[T]] = foreign(getattr(manager.hook, hook))
    values = [value for answer in answers for value in answer]
    if not values:
        raise PluginError(f"it implements no {hook} hook")
    for value in values:
        if not isinstance(value, kind):
            raise PluginError(f"{hook} returned a {type(value).__name__}")
    return values
