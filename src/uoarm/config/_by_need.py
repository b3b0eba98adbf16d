"""Functions that nobody wrote: one for whatever is seen, by what it needs."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator

from attrs import evolve

from uoarm.config._suggestion import new_name
from uoarm.model import BridgeFindings, FoundComponent, Function, Need, Robot, Role

__all__ = ["add_functions"]

_MOST_FUNCTIONS = 500
_ABOUT_ITSELF = "@"  # begins the names of ports that are about the component, not part of it


def add_functions(
    robot: Robot, findings: Iterable[BridgeFindings], *, unfed: tuple[str, ...] = ()
) -> Robot:
    """Return a robot with a function for each output and service that is seen and not named.

    Such a function names nobody: it needs what has that name in that framework, so that it is
    fed by whatever is proven to fit, may go and come back, and says why it cannot be had. It is
    called after the component, and after the port where there are several. What is about a
    component itself, such as its state, is no function. Equal arguments give equal robots; a robot
    that has them already is returned as it is.

    Args:
        robot: the configuration, which stays as it is otherwise.
        findings: what its bridges see. Beyond five hundred functions nothing is added.
        unfed: patterns of inputs that may stay without a feed.
    """
    known = {function.needs for function in robot.functions.values() if function.needs is not None}
    taken = {*robot.functions, *(component.name for component in robot.components())}
    more: dict[str, Function] = {}
    for finding in findings:
        for found in finding.components if finding.bridge in robot.bridges else ():
            for wanted, need in _needs(finding.bridge, found, unfed):
                if need in known or len(robot.functions) + len(more) >= _MOST_FUNCTIONS:
                    continue
                name = new_name(wanted, taken)
                more[name] = Function(name, (), f"{found.name} of {finding.bridge}", needs=need)
    return evolve(robot, functions={**robot.functions, **more}) if more else robot


def _needs(
    bridge: str, found: FoundComponent, unfed: tuple[str, ...]
) -> Iterator[tuple[str, Need]]:
    """Yield what would be needed of a component, and a name for it."""
    for role in (Role.OUTPUT, Role.SERVICE):
        ports = [found_port for found_port in found.ports if found_port.endpoint.role is role]
        for found_port in ports:
            port = found_port.endpoint.port
            if found_port.used_by or port.startswith(_ABOUT_ITSELF):
                continue
            if found_port.message is None and found_port.request is None:
                continue
            need = Need(
                role=role,
                names=(glob.escape(found.name),),
                ports=(glob.escape(port),) if len(ports) > 1 else (),
                prefer=(bridge,),
                unfed=unfed if role is Role.OUTPUT else (),
            )
            is_plain = port == "default" or (len(ports) == 1 and role is Role.OUTPUT)
            yield found.name if is_plain else f"{found.name}_{port}", need
