"""Whether an environment would work: its interpreter, its uoarm, its plugins."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from attrs import field, frozen

from uoarm._raised import reason_of
from uoarm._support.files import expanded, user_folder
from uoarm._version import __version__
from uoarm.errors import PluginError

MARK = "uoarm-environment.json"
"""A file in every environment that was made to its end; says of what it was made."""

_OF_A_PYTHON = ("PYTHONHOME", "PYTHONPATH", "VIRTUAL_ENV")
_MARK_OF_ROS_WHEELS = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_LIBRARIES = "LD_LIBRARY_PATH"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class PluginEnvironmentError(PluginError):
    """An environment for bridge hosts cannot be made, used or removed."""

    error_code = "UOA-303"


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
        raise PluginEnvironmentError(
            f"{name!r} cannot be the name of an environment: expected letters, digits, dots, "
            "hyphens and underscores, 64 at most"
        )
    return _home() / name


def environment_python(name: str) -> Path:
    """Return the interpreter of an environment, which may not be there."""
    return environment_folder(name) / "bin" / "python"


def find_interpreter(environment: str | None = None, python: str | None = None) -> tuple[Path, str]:
    """Return the interpreter that a host asks for, and what helps where it is not there, else "".

    Args:
        environment: the name of one that the interpreter is of.
        python: its path, where no environment is named; neither: the one that runs this.
    """
    if environment is not None:
        found = environment_python(environment)
        hint = f"make it: uoarm env create {environment} --plugin ..."
    elif python is not None:
        found, hint = expanded(python), "check the path under `python`"
    else:
        return Path(sys.executable), ""
    return found, "" if os.access(found, os.X_OK) else hint


def installed(name: str) -> Path:
    """Return the folder of an environment that is there and whole.

    Raises:
        PluginError: there is none of this name, or its making was cut short.
    """
    folder = environment_folder(name)
    if not (folder / MARK).is_file():
        if folder.is_dir():
            text = f"the environment {name!r} is incomplete: uoarm env remove {name}, then make it"
            raise PluginEnvironmentError(f"{text} again")
        raise _missing(name, [environment for environment in listed() if environment.is_whole])
    return folder


def _missing(name: str, there: Iterable[Environment]) -> PluginEnvironmentError:
    names = ", ".join(environment.name for environment in there)
    return PluginEnvironmentError(
        f"there is no environment {name!r} ({f'there are: {names}' if names else 'there is none'})"
    )


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
        raise _missing(name, listed())
    try:
        shutil.rmtree(folder)
    except OSError as error:
        raise PluginEnvironmentError(
            f"environment {name!r} cannot be removed: {reason_of(error)}"
        ) from error


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
    return user_folder("data") / "environments"


def _read(folder: Path) -> Environment:
    try:
        said = json.loads((folder / MARK).read_text(encoding="utf-8"))
        return Environment(folder.name, folder, tuple(said["requirements"]), is_whole=True)
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return Environment(folder.name, folder, (), is_whole=False)


_SECONDS = 60.0
_QUESTION = """
import json, platform
from importlib.metadata import entry_points, version
import msgpack
import uoarm
points = sorted(one.name for one in entry_points(group="uoarm.bridges"))
print(json.dumps({"python": platform.python_version(), "uoarm": uoarm.__version__,
    "msgpack": version("msgpack"), "plugins": points}))
"""
_EXTRAS = """
import json, sys
from importlib.metadata import PackageNotFoundError, metadata
found = {}
for name in sys.argv[1:]:
    try:
        found[name] = metadata(name).get_all("Provides-Extra") or []
    except PackageNotFoundError:
        pass
print(json.dumps(found))
"""


@frozen
class EnvironmentFinding:
    """What was found in one environment.

    Attributes:
        name: of the environment.
        facts: what it has, name to value.
        problem: why a host in it would not start; empty when it would.
        unusable: plugins that lack something there, such as their middleware, name to what. It may
            be what `host: {variables: ...}` names.
    """

    name: str
    facts: dict[str, str]
    problem: str = ""
    unusable: dict[str, str] = field(factory=dict)


def examine(environment: Environment) -> EnvironmentFinding:
    """Ask an environment's interpreter what it has; waits two minutes at most."""
    name = environment.name
    if not environment.is_whole:
        return EnvironmentFinding(name, {}, f"its making was cut short: uoarm env remove {name}")
    try:
        done = _run(environment_python(name), "-I", "-c", _QUESTION)
    except (OSError, subprocess.TimeoutExpired) as error:
        return EnvironmentFinding(name, {}, f"its interpreter does not run: {reason_of(error)}")
    if done.returncode != 0:
        last = done.stderr.strip().rpartition("\n")[2]
        return EnvironmentFinding(name, {}, f"it lacks what a host needs: {last}")
    try:
        said = json.loads(done.stdout)
        facts = {
            key: ", ".join(value) if isinstance(value, list) else value
            for key, value in said.items()
        }
        theirs = str(facts["uoarm"])
    except (ValueError, RecursionError, AttributeError, LookupError, TypeError):
        text = f"its interpreter prints what it was not asked: {done.stdout[:60]!r}"
        return EnvironmentFinding(name, {}, text)
    problem = ""
    if theirs != __version__:
        problem = f"it has uoarm {theirs}, this is {__version__}: make it anew"
    return EnvironmentFinding(
        name, facts, problem, {} if problem else _unusable(environment_python(name))
    )


def _run(interpreter: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # noqa: S603 - the environment's own interpreter
        [str(interpreter), *words],
        capture_output=True,
        env=passed_on(os.environ, is_environment=True),
        text=True,
        errors="replace",
        timeout=_SECONDS,
        check=False,
    )


def extras_in(interpreter: Path, names: Iterable[str]) -> dict[str, list[str]]:
    """Return the extras that projects have which an interpreter has; {} where it does not say."""
    return _answer(interpreter, "-I", "-c", _EXTRAS, *names)


def _unusable(interpreter: Path) -> dict[str, str]:
    """Return what the plugins of an environment lack, as hosts that this shell starts would."""
    report = _answer(interpreter, "-m", "uoarm", "doctor", "--json")
    try:
        found = {name: str(of["usable"]) for name, of in report.items() if "usable" in of}
    except (LookupError, TypeError):
        return {}
    return {
        name: usable.removeprefix("no: ")
        for name, usable in found.items()
        if usable.startswith("no: ")
    }


def _answer(interpreter: Path, *words: str) -> dict[str, Any]:
    """Return the object of JSON that an interpreter prints; {} where it prints none."""
    try:
        answer = json.loads(_run(interpreter, *words).stdout)
    except (OSError, subprocess.TimeoutExpired, ValueError, RecursionError):
        return {}
    return answer if isinstance(answer, dict) else {}
