"""Packages of definitions, and the sources that ROS 2's own generators make of each."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from attrs import frozen

from uoarm.bridge import text_of
from uoarm.errors import ConfigurationError, PluginError

KINDS = ("msg", "srv", "action")
_NAME = re.compile(r"[a-z](_?[a-z0-9])*")
_TYPE_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")
_VERSION = re.compile(r"<version[^>]*>\s*(\d+(\.\d+)*)\s*</version>")
_MOST_FILES = 2_000
_MOST_OCTETS = 1 << 20


@frozen
class InterfacePackage:
    """A package's definitions; `files` are relative to `folder`: `msg/Grip.msg`."""

    name: str
    version: str
    folder: Path
    files: tuple[Path, ...]


def packages_in(folder: Path) -> tuple[InterfacePackage, ...]:
    """Return the packages below a folder, which may be one itself: `package/msg/Name.msg`.

    Raises:
        ConfigurationError: there are none, two of one name, too many files, or wrong names.
    """
    if not os.path.isdir(folder):
        raise ConfigurationError(f"{folder} is no folder")
    found: dict[Path, list[Path]] = {}
    for path in sorted(folder.resolve().rglob("*.*")):
        kind = path.parent.name
        if kind in KINDS and path.suffix in {f".{kind}", ".idl"} and path.is_file():
            found.setdefault(path.parents[1], []).append(path)
    if not found:
        raise ConfigurationError(
            f"{folder} has no definitions: expected package/msg/Name.msg, package/srv/Name.srv or "
            f"package/action/Name.action below it"
        )
    number = sum(map(len, found.values()))
    if number > _MOST_FILES:
        raise ConfigurationError(f"{folder} has {number:,} definitions, at most {_MOST_FILES:,}")
    made: dict[str, InterfacePackage] = {}
    for root, paths in found.items():
        package = _package(root, paths)
        if package.name in made:
            both = f"{made[package.name].folder} and {root}"
            raise ConfigurationError(f"package {package.name} is there twice: {both}")
        made[package.name] = package
    return tuple(made.values())


def _package(root: Path, paths: Iterable[Path]) -> InterfacePackage:
    if not _NAME.fullmatch(root.name):
        raise ConfigurationError(f"{root}: {root.name!r} is no name of a ROS package")
    kept: dict[Path, Path] = {}
    for path in paths:
        if not _TYPE_NAME.fullmatch(path.stem):
            raise ConfigurationError(f"{path}: {path.stem!r} is no name of a type, as GripState")
        if path.stat().st_size > _MOST_OCTETS:
            raise ConfigurationError(f"{path} has more than {_MOST_OCTETS:,} octets")
        stem = path.relative_to(root).with_suffix("")
        if path.suffix != ".idl" or stem not in kept:  # an .idl beside its source adds nothing
            kept[stem] = path.relative_to(root)
    manifest = root / "package.xml"
    text = manifest.read_text(encoding="utf-8", errors="replace") if manifest.is_file() else ""
    report = _VERSION.search(text)
    return InterfacePackage(root.name, report[1] if report else "0.0.0", root, tuple(kept.values()))


def in_build_order(needs: Mapping[str, frozenset[str]]) -> tuple[str, ...]:
    """Return packages so that each stands after those that it needs.

    Raises:
        ConfigurationError: some need one another.
    """
    order: list[str] = []
    left = {name: needed & needs.keys() - {name} for name, needed in needs.items()}
    while left:
        ready = sorted(name for name, needed in left.items() if needed <= {*order})
        if not ready:
            raise ConfigurationError(f"packages need one another: {', '.join(sorted(left))}")
        order += ready
        left = {name: needed for name, needed in left.items() if name not in ready}
    return tuple(order)


_INCLUDE = re.compile(r'^#include "([a-z][a-z0-9_]*)/', re.MULTILINE)
_ALWAYS = {
    "msg": frozenset[str](),
    "srv": frozenset({"service_msgs", "builtin_interfaces"}),
    "action": frozenset(
        {"service_msgs", "builtin_interfaces", "action_msgs", "unique_identifier_msgs"}
    ),
}
_FASTDDS = "rosidl_typesupport_fastrtps_c"
_INTROSPECTION = "rosidl_typesupport_introspection_c"  # Fast DDS knows types by it


@frozen
class Generated:
    """What was generated for one package.

    Attributes:
        headers: the folders to include; the only entry of each is the package's.
        python: the Python package, beside those of the other packages.
        descriptions: the folder of `.idl` and `.json` files.
        sources: what there is to compile.
    """

    headers: tuple[Path, ...]
    python: Path
    descriptions: Path
    sources: tuple[Path, ...]


def prefixes() -> tuple[Path, ...]:
    """Return where ROS 2 is installed: what was sourced, then this environment."""
    named = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return tuple(Path(name) for name in dict.fromkeys((*filter(None, named), sys.prefix)))


def translate(package: InterfacePackage, folder: Path) -> None:
    """Write a package's definitions as `.idl` files below a folder.

    Raises:
        ConfigurationError: a definition cannot be read; with its file.
    """
    adapter = _module("rosidl_adapter")
    for file in package.files:
        target = folder / file.with_suffix(".idl")
        target.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".idl":
            target.write_bytes((package.folder / file).read_bytes())
            continue
        with _errors_naming(package.folder / file):
            adapter.convert_to_idl(package.folder, package.name, file, folder)


def needs_of(package: InterfacePackage, folder: Path) -> frozenset[str]:
    """Return the other packages that a package's `.idl` files refer to."""
    found: set[str] = set()
    for file in package.files:
        text = (folder / file.with_suffix(".idl")).read_text(encoding="utf-8", errors="replace")
        found |= {*_INCLUDE.findall(text)} | _ALWAYS[file.parts[0]]
    return frozenset(found - {package.name})


def generate(package: InterfacePackage, work: Path, shares: Mapping[str, Path]) -> Generated:
    """Have everything generated for a package that was translated into `work/NAME/idl`.

    Args:
        package: the one to generate for.
        work: the folder in which all is done.
        shares: of every other package the folder of its descriptions, as `share/std_msgs`.

    Raises:
        ConfigurationError: a definition does not hold; with what the generator says.
        PluginError: a generator is not installed.
    """
    names = [str(file.with_suffix(".idl")) for file in package.files]
    folder = work / package.name
    described, headers, introspection = (folder / text for text in ("idl", "c", "introspection"))
    python = work / "python" / package.name
    arguments: dict[str, object] = {
        "package_name": package.name,
        "idl_tuples": [f"{described}:{name}" for name in names],
        "include_paths": [f"{name}:{path}" for name, path in shares.items()],
        "ros_interface_files": [str(package.folder / file) for file in package.files],
        "target_dependencies": [],
        "type_description_tuples": [f"{n}:{described / n[:-4]}.json" for n in names],
    }

    def call(module: str, function: str, output: Path, *more: object) -> None:
        path = folder / f"{module}.json"
        output.mkdir(parents=True, exist_ok=True)
        template = str(_resources(module))
        path.write_text(
            json.dumps({**arguments, "output_dir": str(output), "template_dir": template})
        )
        made: Callable[..., Any] = getattr(_module(module), function)
        with _errors_naming(package.folder):
            made(str(path), *more)

    own, also = headers / package.name, introspection / package.name
    call("rosidl_generator_type_description", "generate_type_hash", described)
    call("rosidl_generator_c", "generate_c", own)
    call(_FASTDDS, "generate_typesupport_fastrtps_c", own)
    call(_INTROSPECTION, "generate_c", also)
    call("rosidl_typesupport_c", "generate_c", own, [_FASTDDS, _INTROSPECTION])
    call("rosidl_generator_py", "generate_py", python, ["rosidl_typesupport_c"])
    _require_python(package, python)
    for module, output in (("rosidl_generator_c", own), (_FASTDDS, own), (_INTROSPECTION, also)):
        _visibility(module, package.name, output)
    (python / "__init__.py").touch()
    sources = [
        path
        for root in (headers, introspection, python)
        for path in sorted(root.rglob("*"))
        if path.suffix in {".c", ".cpp"}
    ]
    return Generated((headers, introspection), python, described, tuple(sources))


def _require_python(package: InterfacePackage, folder: Path) -> None:
    """Raise ConfigurationError where no Python was made, as of a field that is called `from`."""
    for path in sorted(folder.rglob("*.py")):
        try:
            compile(path.read_bytes(), path, "exec", dont_inherit=True)
        except SyntaxError as error:
            raise ConfigurationError(
                f"{package.folder}: what ROS 2 makes of it for Python is none, {path.name}: "
                f"{(error.text or str(error)).strip()}; call no field by a keyword of Python"
            ) from error


def _visibility(module: str, package: str, own: Path) -> None:
    name = f"{module}__visibility_control.h"
    text = (_resources(module) / f"{name}.in").read_text()
    text = text.replace("@PROJECT_NAME_UPPER@", package.upper()).replace("@PROJECT_NAME@", package)
    (own / "msg").mkdir(exist_ok=True)
    (own / "msg" / name).write_text(text)


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise PluginError(
            f"ROS 2's generator {name} cannot be imported ({error}); the wheels of "
            f"uoarm-ros2[jazzy] bring it, and a ROS 2 installation that is sourced"
        ) from error


def _resources(module: str) -> Path:
    for prefix in prefixes():
        folder = prefix / "share" / module / "resource"
        if folder.is_dir():
            return folder
    raise PluginError(f"ROS 2's generator {module} lacks its templates: no share/{module}/resource")


@contextlib.contextmanager
def _errors_naming(path: Path) -> Any:
    """Keep what a generator prints; what it raises, or its exit, is an error with the file."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            yield
    except (Exception, SystemExit) as error:  # a generator's own, of any sort
        printed = " ".join(said.getvalue().split())
        text = f"{path}: {text_of(error)}"[:500]
        raise ConfigurationError(f"{text} ({printed[:500]})" if printed else text) from error


def every_share(own: Iterable[tuple[str, Path]]) -> dict[str, Path]:
    """Return the folder of descriptions of every package that is installed, or built here."""
    found: dict[str, Path] = {}
    for prefix in prefixes():
        index = prefix / "share" / "ament_index" / "resource_index" / "rosidl_interfaces"
        for entry in index.iterdir() if index.is_dir() else ():
            found.setdefault(entry.name, prefix / "share" / entry.name)
    return {**found, **dict(own)}
