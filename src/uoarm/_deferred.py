"""Packages whose modules are imported when one of their names is first asked for.

What a program does not use costs it no start. Such a package lists its names by module, and
imports them under `TYPE_CHECKING` for the checker of types:

    if not TYPE_CHECKING:
        __getattr__, __dir__ = deferred(__name__, {"_load": ("load", "loads")})
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module


def deferred(
    package: str, modules: Mapping[str, Iterable[str]], submodules: Iterable[str] = ()
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return what a package has as `__getattr__` and `__dir__`.

    A name is looked up once: after that it stands in the package as if it had been imported there.

    Args:
        package: its name.
        modules: the names that it offers, by the module within it that has them.
        submodules: packages within it that are there without an import of their own; `dir` leaves
            them out.
    """
    places = {name: module for module, names in modules.items() for name in names}
    known = vars(sys.modules[package])
    whole = frozenset(submodules)

    def get(name: str) -> object:
        if name in whole:
            return import_module(f"{package}.{name}")  # which also sets the name
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = known[name] = getattr(import_module(f"{package}.{places[name]}"), name)
        return value

    def names() -> list[str]:
        return sorted({*known, *places})

    return get, names
