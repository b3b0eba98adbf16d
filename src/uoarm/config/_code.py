"""Which version of its code a bridge of Python components runs, among the options uoarm chooses."""

from __future__ import annotations

from attrs import evolve

from uoarm.model import BridgeSpec, Robot

__all__ = ["with_code", "without_code"]

_CODE = "code"
_PLUGIN = "python"


def without_code(spec: BridgeSpec) -> BridgeSpec:
    """Return a bridge as its configuration has it, whichever version of the code it runs."""
    if _CODE not in spec.assigned:
        return spec
    options = {name: option for name, option in spec.options.items() if name != _CODE}
    assigned = {name: value for name, value in spec.assigned.items() if name != _CODE}
    return evolve(spec, options=options, assigned=assigned)


def with_code(robot: Robot, running: Robot | None, version: str = "") -> Robot:
    """Return a configuration whose Python components run this version of their code.

    Args:
        robot: the configuration.
        running: the one in force, whose bridges go on with the version that they have; None:
            none is in force, and none has a version.
        version: hexadecimal digits, for all bridges; "": as they run.
    """
    bridges = {name: without_code(bridge) for name, bridge in robot.bridges.items()}
    for name, spec in bridges.items():
        old = None if running is None else running.bridges.get(name)
        chosen = version or ("" if old is None else old.assigned.get(_CODE, ""))
        if spec.plugin == _PLUGIN and chosen and _CODE not in spec.options:
            code = {_CODE: chosen}
            bridges[name] = evolve(
                spec, options={**spec.options, **code}, assigned={**spec.assigned, **code}
            )
    return evolve(robot, bridges=bridges)
