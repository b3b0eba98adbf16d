"""What a role is shown of the robot: its functions, plans and the status map."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from attrs import evolve, frozen

from uoarm._wire import Form
from uoarm.model import (
    Component,
    ComponentStatus,
    ConnectionStatus,
    Function,
    Plan,
    Robot,
    RouteStatus,
    StatusMap,
    StopReport,
    to_json,
)
from uoarm.server.access import Role, RoleView, RoleViews

__all__ = [
    "FunctionLists",
    "ListQuestion",
    "list_functions",
    "show_plan",
    "show_stop",
    "visible_status",
]


_MOST_LISTS = 64


@frozen
class ListQuestion:
    """Which list of functions is asked for."""

    role: Role
    form: Form


class FunctionLists:
    """Lists of functions as List tells them, written once for each revision, role and form.

    Args:
        robot: returns the configuration in force.
        views: of roles.
    """

    def __init__(self, robot: Callable[[], Robot], views: RoleViews) -> None:
        self._robot = robot
        self._views = views
        self._of: Robot | None = None
        self._written: dict[ListQuestion, bytes] = {}

    def make(self, questions: Collection[ListQuestion]) -> dict[ListQuestion, bytes]:
        """Return lists, in the thread of the views."""
        robot = self._robot()
        if self._of is not robot or len(self._written) > _MOST_LISTS:
            self._of, self._written = robot, {}
        for question in questions:
            if question not in self._written:
                functions = list_functions(robot, self._views.of(question.role))
                self._written[question] = question.form.write({"functions": functions})
        return {question: self._written[question] for question in questions}


def list_functions(robot: Robot, view: RoleView) -> list[dict[str, Any]]:
    """Return the functions that a role sees, as List tells them."""
    return [
        _describe(function, view)
        for function in robot.functions.values()
        if view.has_function(function.name)
    ]


def _describe(function: Function, view: RoleView) -> dict[str, Any]:
    outputs: dict[str, None] = {}
    inputs: dict[str, None] = {}
    for component in function.components:
        outputs |= dict.fromkeys(port.name for port in component.outputs)
        inputs |= dict.fromkeys(port.name for port in component.inputs if port.source is None)
    return {
        "name": function.name,
        "description": function.description,
        "service": any(component.service is not None for component in function.components),
        "outputs": list(outputs),
        "inputs": list(inputs),
        "components": [
            {
                "name": component.name,
                "bridge": component.bridge,
                "priority": component.priority,
                "uses": [name for name in _uses(component) if view.has_function(name)],
            }
            for component in function.components
        ],
    }


def _uses(component: Component) -> list[str]:
    """Return the functions that a component takes its inputs from."""
    sources = (port.source.function for port in component.inputs if port.source is not None)
    return list(dict.fromkeys(sources))


def show_plan(plan: Plan, form: Form, view: RoleView) -> dict[str, Any]:
    """Return a plan as Resolve tells it: data, with structures as the form carries them; text.

    Steps of functions that the role does not see are left out, with the edges to them.
    """
    seen = {step.component.name for step in plan.steps if view.has_component(step.component.name)}
    shown = evolve(
        plan,
        steps=tuple(step for step in plan.steps if step.component.name in seen),
        edges=tuple(edge for edge in plan.edges if {edge.producer, edge.consumer} <= seen),
    )
    data = to_json(shown)
    for part in ("rejected", "warnings"):
        data[part] = view.data(data[part], plan.function)
    for step in data["steps"]:
        step["component"]["inputs"] = view.data(step["component"]["inputs"], plan.function)
        for structure in step["structures"].values():
            structure["schema"] = form.schema(structure["schema"])
    for edge in data["edges"]:
        del edge["producer_structure"], edge["consumer_structure"]
    return {"plan": data, "text": view.text(str(shown), plan.function)}


def show_stop(report: StopReport, view: RoleView) -> dict[str, Any]:
    """Return what an emergency stop came to: every input, with the names that the role sees."""
    reports = {**to_json(report), "stopped": report.stopped, "text": str(report)}
    shown: dict[str, Any] = view.data(reports)
    return shown


def visible_status(status: StatusMap, view: RoleView) -> StatusMap:
    """Return the part of the status map that concerns functions which a role sees.

    Bridges and other machines are shown where such a function has a component there, open or not.
    Derived from the whole map, so that a role that sees everything lacks nothing of it.
    """
    if view.sees_all:
        return status
    components = [
        component_status
        for component_status in status.components
        if view.has_function(component_status.function)
    ]
    connections = [
        connection for connection in status.connections if view.has_function(connection.function)
    ]
    names = {component_status.name for component_status in components} | {
        connection.id for connection in connections
    }
    return evolve(
        status,
        bridges=tuple(
            evolve(bridge, cause=view.text(bridge.cause))
            for bridge in status.bridges
            if view.has_bridge(bridge.name)
        ),
        components=tuple(_shown_component(component, view) for component in components),
        connections=tuple(_shown_connection(connection, names, view) for connection in connections),
        routes=_shown_routes(status.routes, names, view),
        machines=tuple(
            evolve(machine, bridges=bridges, cause=view.text(machine.cause))
            for machine in status.machines
            if (bridges := tuple(name for name in machine.bridges if view.has_bridge(name)))
        ),
        deaths=tuple(
            (name, count)
            for name, count in status.deaths
            if name in names or view.has_component(name)
        ),
        takeovers=tuple(
            (name, count) for name, count in status.takeovers if view.has_function(name)
        ),
        offers=tuple(
            evolve(offer, cause=view.text(offer.cause))
            for offer in status.offers
            if view.has_function(offer.function)
        ),
        lock=tuple(
            evolve(difference, cause=view.text(difference.cause))
            for difference in status.lock
            if view.has_component(difference.component)
        ),
    )


def _shown_component(component: ComponentStatus, view: RoleView) -> ComponentStatus:
    if not (component.cause or component.last_error):
        return component
    cause, last_error = view.text(component.cause), view.text(component.last_error)
    return evolve(component, cause=cause, last_error=last_error)


def _shown_connection(
    connection: ConnectionStatus, names: Collection[str], view: RoleView
) -> ConnectionStatus:
    return evolve(
        connection,
        components=tuple(
            name for name in connection.components if name in names or view.has_component(name)
        ),
        cause=view.text(connection.cause),
        ended=_shown_routes(connection.ended, names, view),
    )


def _shown_routes(
    routes: Collection[RouteStatus], names: Collection[str], view: RoleView
) -> tuple[RouteStatus, ...]:
    """Return the routes of which the role sees both ends."""

    def sees(end: str) -> bool:
        component = end.rpartition(".")[0]
        return end in names or component in names or view.has_component(component)

    return tuple(
        evolve(route, last_error=view.text(route.last_error), refusal=view.text(route.refusal))
        if route.last_error or route.refusal
        else route
        for route in routes
        if sees(route.producer) and sees(route.consumer)
    )
