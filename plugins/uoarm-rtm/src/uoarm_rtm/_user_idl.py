"""IDL that the configuration brings: compiled once, kept in the user's cache, imported.

The cache is a folder per content below `$XDG_CACHE_HOME/uoarm/rtm` (`~/.cache`), named after a
hash of the text, of every file that it includes and of the compiler's version.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.metadata
import json
import os
import re
import shutil
import sys
import tempfile
import threading
from collections.abc import Mapping
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from attrs import field, frozen

from uoarm.errors import BridgeError, FailureReason
from uoarm_rtm._compiler import OUR_IDL, compile_idl

__all__ = ["Stubs", "load_idl"]

_MAIN, _NAMES = "main.idl", "names.json"
_INCLUDE = re.compile(rb'^\s*#\s*include\s*["<]([^">]+)[">]', re.MULTILINE)
_MOST_BYTES = 4 << 20
_loading = threading.Lock()
_loaded: dict[str, Stubs] = {}


@frozen
class Stubs:
    """Compiled IDL.

    Attributes:
        scopes: a module for each IDL module at the outermost level.
        names: parameters of operations, as our back end of omniidl writes them.
    """

    scopes: tuple[ModuleType, ...]
    names: Mapping[str, Mapping[str, list[tuple[str, str]]]] = field(hash=False)


def load_idl(source: str, folder: str = ".") -> Stubs:
    """Return the stubs of IDL: all that the text and its includes declare.

    Args:
        source: IDL text, or the path of a file.
        folder: where a text finds what it includes; a file finds it beside itself.

    Raises:
        BridgeError: the file cannot be read, or the compiler refuses it.
        BridgeTimeoutError: the compiler takes too long.
    """
    if "{" in source:
        text, directory, shown = source.encode(), Path(folder).absolute(), "the IDL text"
    else:
        path = Path(source).expanduser().absolute()
        text, directory, shown = _read(path), path.parent, str(path)
    key = _key(text, directory)
    package = f"uoarm_rtm_idl_{key}"
    with _loading:
        stubs = _loaded.get(package)
        if stubs is None:
            kept = _cache() / key
            if not kept.is_dir():
                _compile(text, directory, package, kept, shown)
            stubs = _loaded[package] = _import(package, kept)
        return stubs


def _read(path: Path) -> bytes:
    try:
        text = path.read_bytes()
    except OSError as error:
        text_ = f"IDL file {str(path)!r} cannot be read: {error}"
        raise BridgeError(text_, FailureReason.BAD_ENDPOINT) from error
    if len(text) > _MOST_BYTES:
        text_ = f"IDL file {str(path)!r} has more than {_MOST_BYTES} bytes"
        raise BridgeError(text_, FailureReason.BAD_ENDPOINT)
    return text


def _key(text: bytes, directory: Path) -> str:
    """Return a name of the content, includes and compiler included."""
    digest = hashlib.sha256(f"2 {importlib.metadata.version('jeteve-omniorb')}".encode())
    seen: set[Path] = set()
    waiting = [(text, directory)]
    while waiting:
        source, beside = waiting.pop()
        digest.update(source)
        for name in _INCLUDE.findall(source):
            for folder in (beside, directory, OUR_IDL):
                path = folder / os.fsdecode(name)
                if path.is_file() and path not in seen:
                    seen.add(path)
                    waiting.append((_read(path), path.parent))
                    break
    return digest.hexdigest()[:24]


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "uoarm" / "rtm"


def _compile(text: bytes, directory: Path, package: str, folder: Path, shown: str) -> None:
    try:
        folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix="compiling-", dir=folder.parent))
    except OSError as error:
        text_ = f"the cache of compiled IDL cannot be written: {error}"
        raise BridgeError(text_, FailureReason.UNAVAILABLE) from error
    try:
        (work / _MAIN).write_bytes(text)
        (work / package).mkdir()
        compile_idl(
            [str(work / _MAIN)],
            work,
            package=package,
            directory=directory,
            names=work / package / _NAMES,
        )
        with contextlib.suppress(OSError):  # another process was faster
            (work / package).rename(folder)
    except BridgeError as error:
        raise BridgeError(str(error).replace(str(work / _MAIN), shown), error.reason) from None
    except OSError as error:
        text_ = f"the cache of compiled IDL cannot be written: {error}"
        raise BridgeError(text_, FailureReason.UNAVAILABLE) from error
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _import(package: str, folder: Path) -> Stubs:
    spec = spec_from_file_location(
        package, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[package] = module
    try:
        spec.loader.exec_module(module)
        main = importlib.import_module(f"{package}.main_idl")
        scopes = map(importlib.import_module, main._exported_modules)  # noqa: SLF001 - as it has it
        names = json.loads((folder / _NAMES).read_text(encoding="utf-8"))
        return Stubs(tuple(scopes), names)
    except Exception as error:
        sys.modules.pop(package, None)
        text = f"compiled IDL in {str(folder)!r} cannot be imported: {error}; remove the folder"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
