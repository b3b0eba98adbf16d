"""IDL compiled by omniidl, a process of its own; what the configuration brings is cached.

The compiler runs apart because its front end is C code with global state, fed by users' files.
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
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from attrs import field, frozen

from uoarm.bridge import Log, reason_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UsageError
from uoarm.plugins import UnreadableFileError, expanded, read_octets, user_folder

_log = Log("uoarm.rtm")
OUR_IDL = Path(__file__).parent / "idl"

_LIMIT_SECONDS = 20.0
# The back end lies apart: in our package its import would be that of uoarm, ten times the
# compiler's own work.
_BACK_END = Path(__file__).parent / "_back_end"
# omniidl looks for its preprocessor beside the program that it believes to be.
_RUN = "import sys; sys.argv[0] = sys.argv.pop(1); from omniidl.main import main; main()"


def omniorb_programs() -> Path | None:
    """Return the folder in which the Python distribution of omniORB keeps its programs."""
    spec = find_spec("jeteve_omniorb")
    if spec is None or spec.origin is None:
        return None
    return Path(spec.origin).parent / "bin"


def compile_idl(
    files: Sequence[str], into: Path, *, package: str, directory: Path, names: Path | None = None
) -> None:
    """Compile IDL files to Python stubs; takes about 0.1 s.

    Args:
        files: names of files below `directory`.
        into: existing folder that takes the package.
        package: dotted name of the package that the stubs live in.
        directory: where the files are; `#include` finds files there and ours.
        names: file that takes the parameter names of operations, as our back end writes them;
            with it, what is included goes into the same stubs.

    Raises:
        BridgeError: BAD_ENDPOINT when the IDL is wrong, with the compiler's lines;
            UNAVAILABLE when the compiler cannot be started.
        BridgeTimeoutError: the compiler took longer than 20 s.
    """
    programs = omniorb_programs()
    program = str(programs / "omniidl") if programs is not None else "omniidl"
    command = [
        *(sys.executable, "-c", _RUN, program, "-bpython", f"-Wbpackage={package}"),
        *(
            ("-Wbinline", f"-p{_BACK_END}", "-buoarm_idl_names", f"-Wbfile={names}")
            if names
            else ()
        ),
        *(f"-I{directory}", f"-I{OUR_IDL}", f"-C{into}", *files),
    ]
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter, and arguments of ours
            command,
            cwd=directory,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_LIMIT_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        text = f"compiling {', '.join(files)} took longer than {_LIMIT_SECONDS:g} s"
        raise BridgeTimeoutError(text) from None
    except OSError as error:
        text = f"the IDL compiler cannot be started: {reason_of(error)}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    if done.returncode != 0:
        lines = "\n".join((done.stderr or done.stdout).strip().splitlines()[:20])
        raise BridgeError(f"IDL that cannot be compiled: {lines}", FailureReason.BAD_ENDPOINT)


_MAIN, _NAMES = "main.idl", "names.json"
_INCLUDE = re.compile(rb'^\s*#\s*include\s*["<]([^">]+)[">]', re.MULTILINE)
_MOST_BYTES = 4 << 20
# Guards `_loaded`; held while IDL is compiled and imported, so that bridges that begin at once do
# that once.
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
        path = expanded(source).absolute()
        text, directory, shown = _read(path), path.parent, str(path)
    key = _key(text, directory)
    package = f"uoarm_rtm_idl_{key}"
    with _loading:
        stubs = _loaded.get(package)
        if stubs is None:
            stubs = _loaded[package] = _stubs(text, directory, package, key, shown)
        return stubs


def _read(path: Path) -> bytes:
    try:
        return read_octets(path, _MOST_BYTES)
    except UnreadableFileError as error:
        reason = f"IDL file {str(path)!r}: {error}"
        raise BridgeError(reason, FailureReason.BAD_ENDPOINT) from error


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


def _stubs(text: bytes, directory: Path, package: str, key: str, shown: str) -> Stubs:
    """Return stubs from the cache, or compile them into it; without it they are kept nowhere."""
    try:
        cache = user_folder("cache") / "rtm"
        if (cache / key).is_dir():
            return _import(package, cache / key)
        cache.mkdir(mode=0o700, parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix="compiling-", dir=cache))
    except (OSError, UsageError) as error:
        why = f"compiled IDL cannot be kept: {reason_of(error)}"
        _log.warning("%s; XDG_CACHE_HOME names another folder for it", why)
        try:
            work = cache = Path(tempfile.mkdtemp(prefix="uoarm-rtm-"))
        except OSError as another:
            reason = f"{why}; nor can it be written elsewhere: {reason_of(another)}"
            raise BridgeError(reason, FailureReason.UNAVAILABLE) from another
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
            (work / package).rename(cache / key)
        return _import(package, cache / key)
    except BridgeError as error:
        raise BridgeError(str(error).replace(str(work / _MAIN), shown), error.reason) from None
    except OSError as error:
        reason = f"compiled IDL cannot be written: {reason_of(error)}"
        raise BridgeError(reason, FailureReason.UNAVAILABLE) from error
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
