"""What a role may see of the robot: its functions and the status map."""

from __future__ import annotations

from typing import Any

from uoarm._wire import Form
from uoarm.model import Component, Function, Plan, Robot, StatusMap, to_json
from uoarm.server.access import Operation, Role

__all__ = ["list_functions", "show_plan", "visible_status"]


def list_functions(robot: Robot, role: Role) -> list[dict[str, Any]]:
    """Return the functions that a role may see, as List tells them."""
    return [
        _describe(function)
        for function in robot.functions.values()
        if role.allows(Operation.SEE, function.name)
    ]


def _describe(function: Function) -> dict[str, Any]:
    outputs: dict[str, None] = {}
    inputs: dict[str, None] = {}
    for component in function.components:
        outputs |= dict.fromkeys(one.name for one in component.outputs)
        inputs |= dict.fromkeys(one.name for one in component.inputs if one.source is None)
    return {
        "name": function.name,
        "description": function.description,
        "service": any(one.service is not None for one in function.components),
        "outputs": list(outputs),
        "inputs": list(inputs),
        "components": [
            {
                "name": one.name,
                "bridge": one.bridge,
                "priority": one.priority,
                "uses": _uses(one),
            }
            for one in function.components
        ],
    }


def _uses(component: Component) -> list[str]:
    """Return the functions that a component takes its inputs from."""
    sources = (one.source.function for one in component.inputs if one.source is not None)
    return list(dict.fromkeys(sources))


def show_plan(plan: Plan, form: Form) -> dict[str, Any]:
    """Return a plan as Resolve tells it: data, with structures as the form carries them; text."""
    data = to_json(plan)
    for step in data["steps"]:
        for structure in step["structures"].values():
            structure["schema"] = form.schema(structure["schema"])
    for edge in data["edges"]:
        del edge["producer_structure"], edge["consumer_structure"]
    return {"plan": data, "text": str(plan)}


def visible_status(robot: Robot, status: StatusMap, role: Role) -> dict[str, Any]:
    """Return the part of the status map that concerns functions which a role may see.

    Bridges and other machines are shown where such a function has a component there, open or not.
    """
    components = [one for one in status.components if role.allows(Operation.SEE, one.function)]
    connections = [one for one in status.connections if role.allows(Operation.SEE, one.function)]
    names = {one.name for one in components} | {one.id for one in connections}
    routes = [
        one
        for one in status.routes
        if one.producer.rpartition(".")[0] in names or one.producer in names
    ]
    seen = {one.name for one in robot.components() if role.allows(Operation.SEE, one.function)}
    possible = {
        one.bridge for one in robot.components() if role.allows(Operation.SEE, one.function)
    }
    shown = StatusMap(
        bridges=tuple(one for one in status.bridges if one.name in possible),
        components=tuple(components),
        connections=tuple(connections),
        routes=tuple(routes),
        machines=tuple(one for one in status.machines if possible.intersection(one.bridges)),
        held=status.held,
        lock=tuple(one for one in status.lock if one.component in seen),
    )
    data: dict[str, Any] = to_json(shown)
    return data
