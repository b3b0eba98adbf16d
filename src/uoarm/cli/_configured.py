"""What is special to the bridges of a file, for commands that list plugins."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from uoarm.bridge import Registry
from uoarm.cli._shared import needing, reporting
from uoarm.config import assign, installation, load
from uoarm.errors import BridgeError

__all__ = ["assigned_options", "environment_facts"]

_SECONDS = 60.0


def assigned_options(file: str | None, registry: Registry) -> Iterator[tuple[str, str]]:
    """Yield every option that uoarm chose, as `bridge.option` and its value."""
    if file is None:
        return
    with reporting():
        robot = assign(load(file, registry.types), registry.types)
    for bridge in robot.bridges.values():
        for option, value in bridge.assigned.items():
            yield f"{bridge.name}.{option}", str(value)


def environment_facts(file: str | None, registry: Registry) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield what each bridge with a Python of its own finds there, asked of that Python.

    Every one of them is given a minute.
    """
    if file is None:
        return
    with reporting():
        robot = load(file, registry.types)
    for bridge in robot.bridges.values():
        place = installation(bridge.host)
        if not place:
            continue
        with reporting(), needing("hosts"):
            from uoarm._host import HostSettings  # noqa: PLC0415 - needs an extra
        settings = HostSettings.read(bridge.host or {})
        name = f"{bridge.name}, with {place.partition(' ')[2]}"
        try:
            interpreter = settings.interpreter()
        except BridgeError as error:
            yield name, {"usable": f"no: {error}"}
        else:
            variables = settings.process_variables(os.environ)
            yield name, _asked(interpreter, variables, bridge.plugin)


def _asked(interpreter: Path, variables: dict[str, str], plugin: str) -> dict[str, str]:
    command = [str(interpreter), "-m", "uoarm", "doctor", "--json"]
    try:
        done = subprocess.run(  # noqa: S603 - the interpreter that the configuration names
            command, capture_output=True, env=variables, text=True, timeout=_SECONDS, check=False
        )
        report: Any = json.loads(done.stdout)
        found = report.get(plugin, {"usable": f"no: the plugin {plugin} is not installed there"})
        return {"uoarm": report["uoarm"]["version"], **found}
    except subprocess.TimeoutExpired:
        return {"usable": f"no: it did not answer within {_SECONDS:g} s"}
    except OSError as error:
        return {"usable": f"no: {error}"}
    except (ValueError, LookupError, TypeError, AttributeError):
        last = done.stderr.strip().rpartition("\n")[2]
        return {"usable": f"no: it has no uoarm that answers: {last}"}
