"""Modules of folders: each list of folders has its own, whatever other modules are named.

`kitchen.py` in `/home/robot` is imported as `uoarm.local._modules._2fhome_2frobot.kitchen`, and so
is what it imports from there, by `import helper` as by `from . import helper`. The name says where
the module is, so that whoever looks it up by name finds it, another process, too (pickle,
multiprocessing).

What the program could import itself, from the same file, is imported as the program does it: there
is one module to a file, and what is installed stays as it is.
"""

from __future__ import annotations

import builtins
import importlib
import os
import re
import sys
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import PurePath
from types import ModuleType
from typing import Any

__all__ = ["Modules", "written_name"]

__path__: list[str] = []  # a package, as the import system sees it: its finder is below

_PREFIX = f"{__name__}."
_INSTALLED = {"site-packages", "dist-packages"}


class Modules:
    """The modules of a list of folders.

    Args:
        folders: searched in this order, before everything that the program can import.
    """

    def __init__(self, folders: Sequence[str]) -> None:
        self._folders = tuple(os.path.abspath(one) for one in folders)  # noqa: PTH100 - not resolved
        self._package = _PREFIX + _name_of(self._folders)

    def __str__(self) -> str:
        return ", ".join((*self._folders, "sys.path"))

    def load(self, name: str) -> ModuleType:
        """Import a module by the name that it has in its folder.

        Raises:
            ImportError: there is none, or what it needs is not there. A module raises anything.
        """
        own = _own_name(self._package, self._folders, name)
        return importlib.import_module(own or name)


def written_name(name: str) -> str:
    """Return the name that a module has in its folder."""
    return name[len(_PREFIX) :].partition(".")[2] if name.startswith(_PREFIX) else name


def _own_name(package: str, folders: Sequence[str], name: str) -> str:
    """Return the full name of a module of the folders, or "" for one of the program's."""
    top = name.partition(".")[0]
    own = f"{package}.{top}" in sys.modules or _is_own(top, folders)
    return f"{package}.{name}" if own else ""


def _is_own(top: str, folders: Sequence[str]) -> bool:
    if top == "uoarm" or top in sys.builtin_module_names:
        return False
    found = PathFinder.find_spec(top, folders)
    if found is None:
        return False
    here, there = _file_of(found), _file_of(_spec_in_program(top))
    if here is None or here != there:
        return here is not None or there is None  # a mere folder yields to a module, as ever
    # Imported by the program, it imports as the program does: that must reach its folders, too.
    reached = {os.path.realpath(one) for one in sys.path}
    return not (
        _INSTALLED & set(PurePath(here).parts)
        or all(os.path.realpath(one) in reached for one in folders)
    )


def _spec_in_program(top: str) -> ModuleSpec | None:
    if top in sys.modules:
        return getattr(sys.modules[top], "__spec__", None)
    return PathFinder.find_spec(top)


def _file_of(spec: ModuleSpec | None) -> str | None:
    if spec is None or spec.origin is None or not spec.has_location:
        return None
    return os.path.realpath(spec.origin)


def _name_of(folders: Sequence[str]) -> str:
    """Write folders as an identifier that can be read back."""
    octets = os.fsencode("\0".join(folders))
    return re.sub(rb"[^A-Za-z0-9]", lambda one: b"_%02x" % ord(one[0]), octets).decode()


def _folders_of(name: str) -> list[str]:
    octets = re.sub(rb"_([0-9a-f]{2})", lambda one: bytes.fromhex(one[1].decode()), name.encode())
    return os.fsdecode(octets).split("\0")


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(_PREFIX):
            return None
        package, _, rest = fullname[len(_PREFIX) :].partition(".")
        if not rest:
            spec = ModuleSpec(fullname, None, is_package=True)
            spec.submodule_search_locations = _folders_of(package)
            return spec
        found = PathFinder.find_spec(fullname, path, target)
        if found is not None and isinstance(found.loader, SourceFileLoader):
            found.loader = _Loader(fullname, found.loader.path)
        return found


class _Loader(SourceFileLoader):
    """Runs a module with an `import` statement that looks in the module's folders first."""

    def exec_module(self, module: ModuleType) -> None:
        folders = module.__name__[len(_PREFIX) :].partition(".")[0]
        imports = _import_in(_PREFIX + folders, _folders_of(folders))
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": imports}
        super().exec_module(module)


def _import_in(package: str, folders: Sequence[str]) -> Any:
    def import_module(
        name: str,
        globals: Mapping[str, object] | None = None,  # noqa: A002 - as `__import__` has them
        locals: Mapping[str, object] | None = None,  # noqa: A002
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        own = "" if level else _own_name(package, folders, name)
        if not own:
            return builtins.__import__(name, globals, locals, fromlist or (), level)
        found = builtins.__import__(own, globals, locals, fromlist or (), 0)
        return found if fromlist else sys.modules[f"{package}.{name.partition('.')[0]}"]

    return import_module


sys.meta_path.insert(0, _Finder())
