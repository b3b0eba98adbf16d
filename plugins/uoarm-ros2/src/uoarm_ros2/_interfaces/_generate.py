"""ROS 2's own generators, called for one package: definitions in, sources out."""

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

from uoarm.errors import ConfigurationError, PluginError
from uoarm_ros2._interfaces._packages import InterfacePackage

__all__ = ["Generated", "generate", "needs_of", "prefixes", "translate"]

_INCLUDE = re.compile(r'^#include "([a-z][a-z0-9_]*)/', re.MULTILINE)
_ALWAYS = {
    "msg": frozenset[str](),
    "srv": frozenset({"service_msgs", "builtin_interfaces"}),
    "action": frozenset(
        {"service_msgs", "builtin_interfaces", "action_msgs", "unique_identifier_msgs"}
    ),
}
_FASTDDS = "rosidl_typesupport_fastrtps_c"
_INTROSPECTION = "rosidl_typesupport_introspection_c"  # Fast DDS is told of types by it


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
        with _told_of(package.folder / file):
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
        package: whose.
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
        with _told_of(package.folder):
            made(str(path), *more)

    own, also = headers / package.name, introspection / package.name
    call("rosidl_generator_type_description", "generate_type_hash", described)
    call("rosidl_generator_c", "generate_c", own)
    call(_FASTDDS, "generate_typesupport_fastrtps_c", own)
    call(_INTROSPECTION, "generate_c", also)
    call("rosidl_typesupport_c", "generate_c", own, [_FASTDDS, _INTROSPECTION])
    call("rosidl_generator_py", "generate_py", python, ["rosidl_typesupport_c"])
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
def _told_of(path: Path) -> Any:
    """Keep what a generator prints; what it raises, or its exit, is an error with the file."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            yield
    except (Exception, SystemExit) as error:  # a generator's own, of any sort
        printed = " ".join(said.getvalue().split())
        text = f"{path}: {type(error).__name__}: {error}"[:500]
        raise ConfigurationError(f"{text} ({printed[:500]})" if printed else text) from error


def every_share(own: Iterable[tuple[str, Path]]) -> dict[str, Path]:
    """Return the folder of descriptions of every package that is installed, or built here."""
    found: dict[str, Path] = {}
    for prefix in prefixes():
        index = prefix / "share" / "ament_index" / "resource_index" / "rosidl_interfaces"
        for entry in index.iterdir() if index.is_dir() else ():
            found.setdefault(entry.name, prefix / "share" / entry.name)
    return {**found, **dict(own)}
