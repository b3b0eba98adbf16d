"""Modules of folders: each list of folders has its own, whatever other modules are named.

`kitchen.py` in `/home/robot` is imported as `uoarm.local._modules._2fhome_2frobot.kitchen`, and so
is what it imports from there, by `import helper` as by `from . import helper`. The name says where
the module is, so that a lookup by name finds it, in another process, too (pickle,
multiprocessing).

What the program could import itself, from the same file, is imported as the program does it: there
is one module to a file, and what is installed stays as it is.

Code that is read again has a name of its own, `..._modules._g3f2a__2fhome_2frobot.kitchen`: what
runs goes on with the modules that it has. All that is in the folders and is not installed is read
again.
"""

from __future__ import annotations

import builtins
import importlib
import os
import re
import sys
import threading
import traceback
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import PurePath
from types import ModuleType
from typing import Any

__path__: list[str] = []  # a package, as the import system sees it: its finder is below

_PREFIX = f"{__name__}."
_NAME = re.compile(rf"{re.escape(_PREFIX)}\w+\.?")
_INSTALLED = {"site-packages", "dist-packages"}
_VERSION = re.compile("_g([0-9a-f]+)_")  # no octet is written so
_users: Counter[str] = Counter()
_lock = threading.Lock()


class Modules:
    """The modules of a list of folders.

    Args:
        folders: searched in this order, before everything that the program can import.
        code: hexadecimal digits; for others than before the code is read again. Those that name
            the same share its modules, which are forgotten when all have closed.
    """

    def __init__(self, folders: Sequence[str], code: str = "") -> None:
        self._folders = tuple(os.path.abspath(folder) for folder in folders)  # noqa: PTH100 - not resolved
        version = f"_g{code}_" if code else ""
        self._package = _PREFIX + version + _name_of(self._folders)
        self._is_version = bool(code)
        if code:
            importlib.invalidate_caches()  # a folder may have got files within its clock's tick
            with _lock:
                _users[self._package] += 1

    @classmethod
    def newest(cls, folders: Sequence[str]) -> Modules:
        """Return those of the version that was read last and is in use, or else of the first."""
        plain = cls(folders)
        name = plain._package[len(_PREFIX) :]
        with _lock:
            living = [user[len(_PREFIX) :] for user in _users]
        found = [_VERSION.match(text) for text in living if _VERSION.sub("", text, count=1) == name]
        return cls(folders, found[-1][1]) if found and found[-1] is not None else plain

    def __str__(self) -> str:
        return ", ".join((*self._folders, "sys.path"))

    def load(self, name: str) -> ModuleType:
        """Import a module by the name that it has in its folder.

        Raises:
            ImportError: there is none, or what it needs is not there. A module raises anything.
        """
        own = _own_name(self._package, self._folders, name)
        return importlib.import_module(own or name)

    def place_of(self, error: BaseException) -> str:
        """Return the last line of these modules that an error came through: ` (arm.py, line 14)`.

        Nothing where it came through none, as a mistake of syntax, whose text names the line.
        """
        place = ""
        for frame, line in traceback.walk_tb(error.__traceback__):
            file = PurePath(frame.f_code.co_filename)
            if any(file.is_relative_to(folder) for folder in self._folders):
                place = f" ({file.name}, line {line})"
        return place

    def close(self) -> None:
        """Forget the modules, where no other bridge has this version of them. Once."""
        if not self._is_version:
            return
        with _lock:
            _users[self._package] -= 1
            if _users[self._package]:
                return
            del _users[self._package]
            within = f"{self._package}."
            for name in [module for module in sys.modules if module.startswith(within)]:
                del sys.modules[name]
            sys.modules.pop(self._package, None)
            vars(sys.modules[__name__]).pop(self._package[len(_PREFIX) :], None)


def written_name(text: str) -> str:
    """Return the name that a module has in its folder, or a text with such names."""
    return _NAME.sub("", text)


def _own_name(package: str, folders: Sequence[str], name: str) -> str:
    """Return the full name of a module of the folders, or "" for one of the program's."""
    top = name.partition(".")[0]
    is_version = _VERSION.match(package[len(_PREFIX) :]) is not None
    own = f"{package}.{top}" in sys.modules or _is_own(top, folders, is_version=is_version)
    return f"{package}.{name}" if own else ""


def _is_own(top: str, folders: Sequence[str], *, is_version: bool) -> bool:
    if top == "uoarm" or top in sys.builtin_module_names:
        return False
    found = PathFinder.find_spec(top, folders)
    if found is None:
        return False
    here, there = _file_of(found), _file_of(_spec_in_program(top))
    if here is None or here != there:
        return here is not None or there is None  # a mere folder yields to a module, as ever
    if is_version:
        return not _INSTALLED & set(PurePath(here).parts)
    # Imported by the program, it imports as the program does: that must reach its folders, too.
    reached = {os.path.realpath(name) for name in sys.path}
    return not (
        _INSTALLED & set(PurePath(here).parts)
        or all(os.path.realpath(folder) in reached for folder in folders)
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
    return re.sub(rb"[^A-Za-z0-9]", lambda item: b"_%02x" % ord(item[0]), octets).decode()


def _folders_of(name: str) -> list[str]:
    written = _VERSION.sub("", name, count=1) if _VERSION.match(name) else name
    octets = re.sub(
        rb"_([0-9a-f]{2})", lambda item: bytes.fromhex(item[1].decode()), written.encode()
    )
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

    def path_stats(self, path: str) -> Mapping[str, Any]:
        """Refuse for code that is read again: what was compiled of it is known by whole seconds.

        Raises:
            OSError: then nothing compiled is used or kept.
        """
        if _VERSION.match(self.name[len(_PREFIX) :]):
            raise OSError("the code is read again")
        return super().path_stats(path)

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
