"""Where environments lie, and which there are."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from attrs import frozen

from uoarm.errors import PluginError

__all__ = [
    "MARK",
    "Environment",
    "environment_folder",
    "environment_python",
    "installed",
    "listed",
    "passed_on",
    "remove",
]

MARK = "uoarm-environment.json"
"""A file in every environment that was made to its end; says of what it was made."""

_OF_A_PYTHON = ("PYTHONHOME", "PYTHONPATH", "VIRTUAL_ENV")
_MARK_OF_ROS_WHEELS = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_LIBRARIES = "LD_LIBRARY_PATH"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@frozen
class Environment:
    """One Python environment for bridge hosts.

    Attributes:
        name: what `host: {environment: NAME}` says.
        folder: where it is.
        requirements: what was asked for when it was made.
        is_whole: whether its making came to an end.
    """

    name: str
    folder: Path
    requirements: tuple[str, ...]
    is_whole: bool


def environment_folder(name: str) -> Path:
    """Return where the environment of this name is, or would be.

    It is below `UOARM_HOME`, else where the user's data lies.

    Raises:
        PluginError: this cannot be the name of an environment.
    """
    if not _NAME.fullmatch(name):
        raise PluginError(
            f"{name!r} cannot be the name of an environment: expected letters, digits, dots, "
            "hyphens and underscores, 64 at most"
        )
    return _home() / name


def environment_python(name: str) -> Path:
    """Return the interpreter of an environment, which may not be there."""
    return environment_folder(name) / "bin" / "python"


def installed(name: str) -> Path:
    """Return the folder of an environment that is there and whole.

    Raises:
        PluginError: there is none of this name, or its making was cut short.
    """
    folder = environment_folder(name)
    if not (folder / MARK).is_file():
        whole = (
            ", ".join(environment.name for environment in listed() if environment.is_whole)
            or "none"
        )
        what = "is not whole: make it again" if folder.is_dir() else "is not there"
        raise PluginError(f"the environment {name!r} {what} (whole are: {whole})")
    return folder


def listed() -> list[Environment]:
    """Return the environments by name, those included whose making was cut short."""
    home = _home()
    if not home.is_dir():
        return []
    return [_read(folder) for folder in sorted(home.iterdir()) if (folder / "bin").is_dir()]


def remove(name: str) -> None:
    """Remove an environment.

    Raises:
        PluginError: there is none of this name, or it cannot be removed.
    """
    folder = environment_folder(name)
    if not folder.is_dir():
        known = ", ".join(environment.name for environment in listed()) or "none"
        raise PluginError(f"there is no environment {name!r} (there are: {known})")
    try:
        shutil.rmtree(folder)
    except OSError as error:
        raise PluginError(f"environment {name!r} cannot be removed: {error}") from error


def passed_on(inherited: Mapping[str, str], *, is_environment: bool) -> dict[str, str]:
    """Return the variables of this process that a process with another Python may have.

    Wheels of ROS from a package index put their libraries on the loader's path and mark that they
    did (`ros-*-rclpy` 2026 bootstrap); a child that inherits either loads the libraries of its
    parent's ROS. Both are taken away.

    Args:
        inherited: the variables of this process.
        is_environment: whether the other Python is that of an environment: then what belongs to
            this one is taken away, too.
    """
    left = dict(inherited)
    if left.pop(_MARK_OF_ROS_WHEELS, None) is not None and _LIBRARIES in left:
        ours = [str(Path(prefix)) for prefix in (sys.prefix, sys.base_prefix)]
        paths = [
            path
            for path in left.pop(_LIBRARIES).split(os.pathsep)
            if path and not any(path.startswith(prefix) for prefix in ours)
        ]
        if paths:
            left[_LIBRARIES] = os.pathsep.join(paths)
    if is_environment:
        for name in _OF_A_PYTHON:
            left.pop(name, None)
    return left


def _home() -> Path:
    home = os.environ.get("UOARM_HOME")
    if home:
        return Path(home) / "environments"
    data = os.environ.get("XDG_DATA_HOME") or "~/.local/share"
    return Path(data).expanduser() / "uoarm" / "environments"


def _read(folder: Path) -> Environment:
    try:
        said = json.loads((folder / MARK).read_text(encoding="utf-8"))
        return Environment(folder.name, folder, tuple(said["requirements"]), is_whole=True)
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return Environment(folder.name, folder, (), is_whole=False)
