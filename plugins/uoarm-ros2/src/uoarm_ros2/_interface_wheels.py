"""Wheels of a lab's own messages, without a ROS installation: generated, compiled, packed."""

from __future__ import annotations

import base64
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from attrs import frozen

from uoarm.bridge import reason_of
from uoarm.errors import ConfigurationError, PluginError
from uoarm_ros2._installed import wheels
from uoarm_ros2._interface_sources import (
    Generated,
    InterfacePackage,
    every_share,
    generate,
    in_build_order,
    needs_of,
    packages_in,
    prefixes,
    translate,
)


def write_wheel(
    output: Path, name: str, version: str, requires: tuple[str, ...], files: Mapping[str, Path]
) -> Path:
    """Write a wheel for this interpreter and platform; returns its path.

    Args:
        output: the folder that it goes to.
        name: of the distribution, with underscores.
        version: of the distribution.
        requires: what pip is to have installed beside.
        files: what it holds, by the name in the wheel; those below `data/` go below the prefix.
    """
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    abi = python + getattr(sys, "abiflags", "")
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    tag = f"{python}-{abi}-{platform}"
    stem = f"{name}-{version}"
    metadata = ["Metadata-Version: 2.1", f"Name: {name.replace('_', '-')}", f"Version: {version}"]
    metadata += [f"Requires-Dist: {text}" for text in requires]
    wheel = ["Wheel-Version: 1.0", "Generator: uoarm", "Root-Is-Purelib: false", f"Tag: {tag}"]
    contents = {
        (f"{stem}.{text}" if text.startswith("data/") else text): path.read_bytes()
        for text, path in sorted(files.items())
    }
    contents[f"{stem}.dist-info/METADATA"] = _text(metadata)
    contents[f"{stem}.dist-info/WHEEL"] = _text(wheel)
    record = f"{stem}.dist-info/RECORD"
    rows = [f"{key},sha256={_hash(octets)},{len(octets)}" for key, octets in contents.items()]
    contents[record] = _text([*rows, f"{record},,"])
    path = output / f"{stem}-{tag}.whl"
    part = path.with_suffix(".part")
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
            for key, octets in contents.items():
                archive.writestr(key, octets)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path


def _text(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()


def _hash(octets: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(octets).digest()).rstrip(b"=").decode()


_LIMIT_SECONDS = 600.0
_LIBRARIES = (
    "fastcdr",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp",
    "rosidl_typesupport_introspection_c",
    "rosidl_typesupport_c",
    "rosidl_runtime_c",
    "rcutils",
    "rmw",
)
_PARTS = (
    "generator_c",
    "generator_py",
    "typesupport_c",
    "typesupport_fastrtps_c",
    "typesupport_introspection_c",
)
# The middleware loads the two by these names; loaded already, they are found wherever they lie.
_LIBRARY = "lib{}__rosidl_typesupport_fastrtps_c.so"
_INTROSPECTION = "lib{}__rosidl_typesupport_introspection_c.so"


def build_wheels(folder: Path, output: Path, report: Callable[[str], None]) -> tuple[Path, ...]:
    """Build a wheel of each package of definitions below a folder; returns them in build order.

    Takes seconds for each definition. Nothing is left behind but the wheels, which are written
    when all could be built. They are for this interpreter, platform and ROS 2 distribution.

    Args:
        folder: below it lie `package/msg/Name.msg` and alike.
        output: where the wheels go; is made.
        report: takes a line of text for every step.

    Raises:
        ConfigurationError: the folder or a definition cannot be used; with the file.
        PluginError: there is no compiler, no Python header, or no generator; or compiling fails.
    """
    packages = {
        interface_package.name: interface_package for interface_package in packages_in(folder)
    }
    with tempfile.TemporaryDirectory(prefix="uoarm-interfaces-") as made:
        work = Path(made)
        needs: dict[str, frozenset[str]] = {}
        for name, package in packages.items():
            translate(package, work / name / "idl")
            needs[name] = needs_of(package, work / name / "idl")
        built: dict[str, Path] = {}
        shares = every_share((name, work / name / "idl") for name in packages)
        _require_known(needs, shares)
        order = in_build_order(needs)
        compilers = _Compilers.found()
        generated: dict[str, Generated] = {}
        for name in order:
            package = packages[name]
            count = len(package.files)
            report(f"{name}: {count} definition{'s' if count > 1 else ''}")
            generated[name] = generate(package, work, shares)
            report(f"{name}: compiling {len(generated[name].sources)} files")
            own = [header for item in generated.values() for header in item.headers]
            linked = _needed(name, needs)
            built[name] = compilers.build(name, generated[name], own, linked, built)
            _require_loads(name, work / "python")
        output.mkdir(parents=True, exist_ok=True)
        return tuple(
            write_wheel(
                output,
                name,
                packages[name].version,
                _requirements(needs[name], packages),
                _files(packages[name], generated[name], work / name, built[name]),
            )
            for name in built
        )


def _require_known(needs: Mapping[str, frozenset[str]], shares: Mapping[str, Path]) -> None:
    for name, needed in needs.items():
        missing = sorted(needed - shares.keys())
        if missing:
            raise ConfigurationError(
                f"{name} refers to types of {', '.join(missing)}, which are neither in the folder "
                f"nor installed; add their definitions, or install ros-<distribution>-"
                f"{missing[0].replace('_', '-')}"
            )


def _needed(name: str, needs: Mapping[str, frozenset[str]]) -> tuple[str, ...]:
    """Return all packages that a package needs, those of the same folder with what they need."""
    found: set[str] = set()
    left = [name]
    while left:
        for need in needs.get(left.pop(), ()):
            if need not in found:
                found.add(need)
                left.append(need)
    return tuple(sorted(found))


@frozen
class _Compilers:
    """A C and a C++ compiler, as the words of their commands."""

    c: tuple[str, ...]
    cpp: tuple[str, ...]

    @staticmethod
    def found() -> _Compilers:
        """Return those that CC and CXX name, else those on the path."""
        c, cpp = _compiler("CC", "cc", "gcc", "clang"), _compiler("CXX", "c++", "g++", "clang++")
        header = Path(sysconfig.get_path("include")) / "Python.h"
        if not header.is_file():
            raise PluginError(f"{header} is missing: install this Python's headers (python3-dev)")
        return _Compilers(c, cpp)

    def build(
        self,
        name: str,
        generated: Generated,
        own: Iterable[Path],
        needed: Iterable[str],
        built: Mapping[str, Path],
    ) -> Path:
        """Compile a package's sources to one library, returned, and the module that loads it."""
        flags = [f"-I{header}" for header in (*own, *_headers())]
        sources = generated.sources
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            done = [pool.submit(self._compile, path, flags) for path in sources]
            try:
                objects = dict(zip(sources, [future.result() for future in done], strict=True))
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        python = generated.python
        library = python / _LIBRARY.format(name)
        folders = [prefix / "lib" for prefix in prefixes()]
        words = ["-Wl,--as-needed", *(f"-L{folder}" for folder in folders if folder.is_dir())]
        for text in needed:
            if text in built:
                words += [str(built[text]), f"-Wl,-rpath,$ORIGIN/../{text}"]
            else:
                words += _installed_libraries(text)
        words += [f"-l{text}" for text in _LIBRARIES]
        entry = python / f"_{name}_s.ep.rosidl_typesupport_c.c"
        self._link(
            library, *(object_ for source, object_ in objects.items() if source != entry), *words
        )
        introspection = python / _INTROSPECTION.format(name)
        everything = ["-Wl,--no-as-needed", str(library)]
        self._link(introspection, *everything)
        module = python / f"{name}_s__rosidl_typesupport_c.so"
        self._link(module, objects[entry], *everything, str(introspection), *words)
        return library

    def _link(self, target: Path, *words: str) -> None:
        names = [f"-Wl,-soname,{target.name}", "-Wl,-rpath,$ORIGIN"]
        _run([*self.cpp, "-shared", "-o", str(target), *names, *words])

    def _compile(self, source: Path, flags: list[str]) -> str:
        target = f"{source}.o"
        language = [*self.c, "-std=gnu11"] if source.suffix == ".c" else [*self.cpp, "-std=c++17"]
        _run([*language, "-O1", "-fPIC", "-w", *flags, "-c", str(source), "-o", target])
        return target


def _compiler(variable: str, *names: str) -> tuple[str, ...]:
    reports = shlex.split(os.environ.get(variable, ""))
    found = [*reports[:1], *names] if not reports else reports[:1]
    for name in found:
        if shutil.which(name):
            return (name, *reports[1:])
    raise PluginError(
        f"there is no compiler: none of {', '.join(found)} is on the path; install gcc and g++, or "
        f"name them in CC and CXX. Message types need none where they are named in the option "
        f"definitions of a bridge"
    )


def _headers() -> list[Path]:
    import numpy as np  # noqa: PLC0415 - only here

    installed = [
        path
        for prefix in prefixes()
        if (prefix / "include").is_dir()
        for path in [prefix / "include", *sorted((prefix / "include").iterdir())]
        if path.is_dir()
    ]
    return [*installed, Path(sysconfig.get_path("include")), Path(np.get_include())]


def _installed_libraries(package: str) -> list[str]:
    """Return the libraries of a package that is installed, by their files."""
    for prefix in prefixes():
        found = [prefix / "lib" / f"lib{package}__rosidl_{part}.so" for part in _PARTS]
        if all(path.is_file() for path in found):
            return [str(path) for path in found]
    for folder in map(Path, sys.path):
        built = folder / package / _LIBRARY.format(package)  # as this one is
        if built.is_file():
            return [str(built), f"-Wl,-rpath,$ORIGIN/../{package}"]
    raise PluginError(f"the libraries of package {package} are not installed")


def _run(words: list[str]) -> None:
    try:
        done = subprocess.run(  # noqa: S603 - the compiler that the environment names
            words,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_LIMIT_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PluginError(f"{words[0]} cannot be run: {reason_of(error)}") from error
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip()
        shown = " ".join(words[:1] + words[-3:])
        raise PluginError(f"{shown} ended with status {done.returncode}:\n{said[-2000:]}")


def _require_loads(name: str, folder: Path) -> None:
    """Load the built libraries in a process of its own: a missing symbol is an error now."""
    text = f"from rosidl_generator_py import import_type_support as load; load({name!r})"
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH", "")])]
    done = subprocess.run(  # noqa: S603 - this interpreter
        [sys.executable, "-c", f"import {name}; {text}"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=_LIMIT_SECONDS,
        check=False,
    )
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip()
        raise PluginError(f"what was built of {name} cannot be loaded:\n{said[-2000:]}")


def _requirements(
    needed: Iterable[str], packages: Mapping[str, InterfacePackage]
) -> tuple[str, ...]:
    """Return what pip should have installed beside: packages of the folder, wheels of ROS 2."""
    distributions = {wheel.distribution for wheel in wheels()}
    found: list[str] = []
    for name in sorted(needed):
        if name in packages:
            found.append(f"{name.replace('_', '-')}=={packages[name].version}")
            continue
        for text in sorted(distributions):
            wanted = f"ros-{text}-{name.replace('_', '-')}"
            try:
                distribution(wanted)
            except PackageNotFoundError:
                continue
            found.append(wanted)
    return tuple(found)


def _files(
    package: InterfacePackage, generated: Generated, work: Path, library: Path
) -> dict[str, Path]:
    """Return what goes into a wheel, by the name in it."""
    found = {
        f"{package.name}/{path.relative_to(library.parent)}": path
        for path in generated.python.rglob("*")
        if path.suffix in {".py", ".so"}
    }
    share = f"data/data/share/{package.name}"
    entries: list[str] = []
    for file in package.files:
        described = generated.descriptions / file
        sources = {file.suffix: package.folder / file}
        sources |= {name: described.with_suffix(name) for name in (".idl", ".json")}
        for suffix, path in sources.items():
            found[f"{share}/{file.with_suffix(suffix)}"] = path
        entries += sorted({str(file), str(file.with_suffix(".idl"))})
    for headers in generated.headers:
        for path in headers.rglob("*.h"):
            found[f"data/data/include/{package.name}/{path.relative_to(headers)}"] = path
    index = work / "index"
    index.write_text("\n".join(sorted(entries)) + "\n")
    at = "data/data/share/ament_index/resource_index"
    found[f"{at}/rosidl_interfaces/{package.name}"] = index
    empty = work / "empty"
    empty.touch()
    found[f"{at}/packages/{package.name}"] = empty
    return found
