"""The packages that bridges run with, as their environments have them installed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from importlib.metadata import Distribution, distributions
from pathlib import Path

from attrs import field, frozen

from uoarm.environments import environment_folder
from uoarm.errors import PluginError
from uoarm.model import Options, Robot

__all__ = ["LockedBridge", "bridges_of", "differing_packages"]

_GROUP = "uoarm.bridges"
_CORE = "uoarm"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_EXTRA = re.compile(r"""extra\s*==\s*['"]([^'"]+)['"]""")
_FOR_DEVELOPERS = frozenset({"dev", "test", "tests", "doc", "docs"})


@frozen
class LockedBridge:
    """What a bridge runs with.

    Attributes:
        plugin: which makes it.
        environment: the name of its environment, or the interpreter that was named instead; empty:
            that of the application.
        packages: versions by name: of uoarm, of the plugin's distribution, and of all that this
            asks for, as far as it is installed. None of what runs on other machines.
    """

    plugin: str
    environment: str = ""
    packages: dict[str, str] = field(factory=dict)


def bridges_of(robot: Robot) -> dict[str, LockedBridge]:
    """Return what the bridges of a robot run with. Reads what is installed, and runs nothing."""
    installed: dict[Path | None, dict[str, Distribution]] = {}
    found = {}
    for name, spec in sorted(robot.bridges.items()):
        environment, folder = _environment(spec.host or {})
        packages: dict[str, str] = {}
        if not environment or folder is not None:
            if folder not in installed:
                installed[folder] = _installed(folder)
            packages = _packages(installed[folder], spec.plugin)
        found[name] = LockedBridge(spec.plugin, environment, packages)
    return found


def differing_packages(
    before: Mapping[str, LockedBridge], after: Mapping[str, LockedBridge]
) -> list[str]:
    """Return a line for each package of a bridge of both that has another version."""
    return [
        f"bridge {name}: {package} {now or 'is gone'}, was {then or 'not there'}"
        for name, value in before.items()
        if name in after
        for package in sorted(value.packages.keys() | after[name].packages)
        if (then := value.packages.get(package)) != (now := after[name].packages.get(package))
    ]


def _environment(host: Options) -> tuple[str, Path | None]:
    """Return what the settings of a host say of its environment, and its folder if it has one."""
    if "machine" in host:
        return f"of machine {host['machine']}", None
    if "environment" in host:
        name = str(host["environment"])
        try:
            return name, environment_folder(name)
        except PluginError:  # it cannot be the name of one
            return name, None
    if "python" in host:
        python = str(host["python"])
        return python, Path(python).expanduser().parent.parent
    return "", None


def _installed(folder: Path | None) -> dict[str, Distribution]:
    if folder is None:
        found = distributions()
    else:
        found = distributions(path=[str(path) for path in folder.glob("lib/python*/site-packages")])
    by_name: dict[str, Distribution] = {}
    for distribution in found:
        name = distribution.metadata["Name"]
        if name:
            by_name.setdefault(
                _normal(name), distribution
            )  # the first on the path is what is imported
    return by_name


def _packages(installed: Mapping[str, Distribution], plugin: str) -> dict[str, str]:
    own = [
        name
        for name, value in installed.items()
        if any(point.group == _GROUP and point.name == plugin for point in value.entry_points)
    ]
    waiting, found = list(own), {}
    while waiting:
        name = waiting.pop()
        if name in found or name not in installed:
            continue
        found[name] = installed[name].version
        if name != _CORE:  # what that asks for concerns no message
            # The plugin's own extras name the versions of the middleware.
            waiting += _required(installed[name], with_extras=name in own)
    return dict(sorted(found.items()))


def _required(one: Distribution, *, with_extras: bool) -> Iterable[str]:
    for line in one.requires or ():
        name, extra = _NAME.match(line), _EXTRA.search(line)
        if name and (extra is None or (with_extras and extra[1] not in _FOR_DEVELOPERS)):
            yield _normal(name[0])


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
