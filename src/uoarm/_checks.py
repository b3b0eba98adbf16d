"""What `uoarm doctor` finds: bridges, and whatever else plugins can check."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from importlib.metadata import EntryPoint

from uoarm._plugins import cause_of, installed, values_of
from uoarm._raised import foreign
from uoarm.bridge import Registry
from uoarm.errors import PluginError
from uoarm.plugins import CONTRACT_VERSION, Check, CheckHooks

_GROUP = "uoarm.checks"
_BRIDGES = "uoarm.bridges"


def bridge_facts(
    registry: Registry, only: Container[str] | None = None
) -> dict[str, dict[str, str]]:
    """Return findings by bridge type, of these alone or of all; a doctor may load a middleware."""
    points = {point.name: point for point in installed(_BRIDGES)}
    return {
        kind.name: _findings(kind.doctor or dict, points.get(kind.name))
        for kind in registry.types.values()
        if only is None or kind.name in only
    }


def plugin_facts(registry: Registry) -> dict[str, dict[str, str]]:
    """Return findings by bridge type or check; one that fails says so and hurts no other."""
    facts = bridge_facts(registry)
    for problem in registry.problems:
        facts[problem.name] = {"usable": f"no: {problem.cause}"}
    for point in sorted(installed(_GROUP), key=lambda point: point.name):
        try:
            checks = values_of(point, CheckHooks, "uoarm_checks", Check)
        except Exception as error:  # noqa: BLE001 - a broken plugin may raise anything
            facts[f"check {point.name}"] = {"usable": f"no: {cause_of(error, point)}"}
            continue
        for check in checks:
            if check.name in facts:
                cause = f"another plugin has a check or a bridge type {check.name!r}"
                facts[f"check {point.name}"] = {"usable": f"no: {cause}"}
            else:
                facts[check.name] = _checked(check, point)
    return facts


def _checked(check: Check, point: EntryPoint) -> dict[str, str]:
    if check.contract != CONTRACT_VERSION:
        cause = (
            f"it is written for version {check.contract} of the hooks, this uoarm has version "
            f"{CONTRACT_VERSION}: install matching versions"
        )
        return {"usable": f"no: {cause}"}
    return _findings(check.run, point)


def _findings(run: Callable[[], Mapping[str, str]], point: EntryPoint | None) -> dict[str, str]:
    try:
        return {"usable": "yes", **foreign(run)}
    except PluginError as error:
        return {"usable": f"no: {error}"}
    except Exception as error:  # noqa: BLE001 - a plugin may raise anything
        return {"usable": f"no: {cause_of(error, point)}"}
