"""Whether an environment would work: its interpreter, its uoarm, its plugins."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterable
from pathlib import Path

from attrs import field, frozen

from uoarm._version import __version__
from uoarm.environments._place import Environment, environment_python, passed_on

__all__ = ["EnvironmentFinding", "examine", "extras_in"]

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
    command = [str(environment_python(name)), "-I", "-c", _QUESTION]
    try:
        done = subprocess.run(  # noqa: S603 - the environment's own interpreter
            command,
            capture_output=True,
            env=passed_on(os.environ, is_environment=True),
            text=True,
            timeout=_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return EnvironmentFinding(name, {}, f"its interpreter does not run: {error}")
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


def extras_in(interpreter: Path, names: Iterable[str]) -> dict[str, list[str]]:
    """Return the extras that projects have which an interpreter has; {} where it does not say."""
    try:
        done = subprocess.run(  # noqa: S603 - the environment's own interpreter
            [str(interpreter), "-I", "-c", _EXTRAS, *names],
            capture_output=True,
            env=passed_on(os.environ, is_environment=True),
            text=True,
            timeout=_SECONDS,
            check=False,
        )
        reports = json.loads(done.stdout)
    except (OSError, subprocess.TimeoutExpired, ValueError, RecursionError):
        return {}
    return reports if isinstance(reports, dict) else {}


def _unusable(interpreter: Path) -> dict[str, str]:
    """Return what the plugins of an environment lack, as hosts that this shell starts would."""
    try:
        done = subprocess.run(  # noqa: S603 - the environment's own interpreter
            [str(interpreter), "-m", "uoarm", "doctor", "--json"],
            capture_output=True,
            env=passed_on(os.environ, is_environment=True),
            text=True,
            timeout=_SECONDS,
            check=False,
        )
        report = json.loads(done.stdout)
        found = {name: str(of["usable"]) for name, of in report.items() if "usable" in of}
    except (
        OSError,
        subprocess.TimeoutExpired,
        ValueError,
        RecursionError,
        AttributeError,
        LookupError,
        TypeError,
    ):
        return {}
    return {
        name: usable.removeprefix("no: ")
        for name, usable in found.items()
        if usable.startswith("no: ")
    }
