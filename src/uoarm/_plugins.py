"""What a plugin says through its hooks: loaded on its own, so that its mistakes stay its own."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import TypeVar

import pluggy
from attrs import frozen

from uoarm.errors import PluginError

__all__ = ["PluginProblem", "hookimpl", "hookspec", "values_of"]

hookspec = pluggy.HookspecMarker("uoarm")
hookimpl = pluggy.HookimplMarker("uoarm")

T = TypeVar("T")


@frozen
class PluginProblem:
    """An installed plugin that cannot be used."""

    name: str
    cause: str


def values_of(point: EntryPoint, specification: type, hook: str, kind: type[T]) -> list[T]:
    """Return what the module behind an entry point answers to a hook.

    Args:
        point: names the module.
        specification: class whose methods are the hooks of its group.
        hook: which of them is called.
        kind: of the values that it returns in a list.

    Raises:
        PluginError: the module does not implement the hook, or returns something else.
        Exception: whatever the module raises.
    """
    manager = pluggy.PluginManager("uoarm")
    manager.add_hookspecs(specification)
    manager.register(point.load(), name=point.name)
    manager.check_pending()
    answers: list[list[T]] = getattr(manager.hook, hook)()
    values = [value for answer in answers for value in answer]
    if not values:
        raise PluginError(f"it implements no {hook} hook")
    for value in values:
        if not isinstance(value, kind):
            raise PluginError(f"{hook} returned a {type(value).__name__}")
    return values
