"""What a role is shown of the robot: its functions, plans and the status map.

The status map is kept in numbered versions: a client gets it whole, or what has changed since.
"""

from __future__ import annotations

import secrets
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from attrs import define, evolve, field, fields, frozen

from uoarm._dataplane import Clock
from uoarm._wire import Form
from uoarm.model import (
    Component,
    ComponentStatus,
    ConfigurationChange,
    ConnectionStatus,
    Function,
    Message,
    Plan,
    Robot,
    RouteStatus,
    StatusEvent,
    StatusMap,
    StopReport,
    to_json,
)
from uoarm.server.access import AccessRole, Approval, Approvals, RoleView, RoleViews
from uoarm.server.streams import shown_event

_MOST_LISTS = 64


@frozen
class ListQuestion:
    """Which list of functions is asked for."""

    role: AccessRole
    form: Form


class FunctionLists:
    """Lists of functions as List shows them, written once for each revision, role and form.

    Args:
        robot: returns the configuration in force.
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
    """Return the functions that a role sees, as List shows them."""
    return [
        _describe(function, robot, view)
        for function in robot.functions.values()
        if view.has_function(function.name)
    ]


def _describe(function: Function, robot: Robot, view: RoleView) -> dict[str, Any]:
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
                "plugin": robot.bridges[component.bridge].plugin,
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
    """Return a plan as Resolve shows it: data, with structures as the form carries them; text.

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


def show_changes(changes: Iterable[ConfigurationChange]) -> list[Message]:
    """Return changes of the configuration as they are shown, without the robots themselves."""
    return [{**to_json(evolve(change, robot=None)), "text": str(change)} for change in changes]


def show_stop(report: StopReport, view: RoleView) -> dict[str, Any]:
    """Return what an emergency stop came to: every input, with the names that the role sees."""
    reports = {**to_json(report), "stopped": report.stopped, "text": str(report)}
    shown: dict[str, Any] = view.data(reports)
    return shown


def show_approval(approvals: Approvals, approval: Approval, view: RoleView) -> dict[str, Any]:
    """Return an approval as it is shown to who decides about it, and to who asked for it."""
    request = approval.request
    components = [name for name in request.foundation.components if view.has_component(name)]
    return {
        **approval.facts(),
        "arguments": request.arguments,
        "left": approvals.left(approval),
        "components": components,
        "revision": request.foundation.revision,
        "preview": view.text(request.preview, request.function),
    }


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
    names = {component_status.name for component_status in components}
    ids = {connection.id for connection in connections}
    return evolve(
        status,
        bridges=tuple(
            evolve(bridge, cause=view.text(bridge.cause))
            for bridge in status.bridges
            if view.has_bridge(bridge.name)
        ),
        components=tuple(_shown_component(component, view) for component in components),
        connections=tuple(
            _shown_connection(connection, names, ids, view) for connection in connections
        ),
        routes=_shown_routes(status.routes, names, ids, view),
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
    connection: ConnectionStatus, names: Collection[str], ids: Collection[str], view: RoleView
) -> ConnectionStatus:
    return evolve(
        connection,
        components=tuple(
            name for name in connection.components if name in names or view.has_component(name)
        ),
        cause=view.text(connection.cause),
        ended=_shown_routes(connection.ended, names, ids, view),
    )


def _shown_routes(
    routes: Collection[RouteStatus], names: Collection[str], ids: Collection[str], view: RoleView
) -> tuple[RouteStatus, ...]:
    """Return the routes of which the role sees both ends.

    An end is a connection by its id, or a port of a component; a component may be named as an id.
    """

    def sees(end: str) -> bool:
        component, is_port, _ = end.rpartition(".")
        if not is_port:
            return end in ids
        return component in names or view.has_component(component)

    return tuple(
        evolve(route, last_error=view.text(route.last_error), refusal=view.text(route.refusal))
        if route.last_error or route.refusal
        else route
        for route in routes
        if sees(route.producer) and sees(route.consumer)
    )


_ROLES = 32
_VERSIONS = 256
_FORGOTTEN = 10_000
_KEYS: Mapping[str, Callable[[Any], Any]] = {
    "components": lambda component: component.name,
    "connections": lambda connection: connection.id,
    "routes": lambda route: [route.producer, route.consumer],
}
"""What the entries of the large parts are known by; the other parts are sent as a whole."""


@frozen
class StatusQuestion:
    """What a client asks.

    Attributes:
        form: in which it wants the answer.
        since: the version that it has; None: it wants the whole map.
        past: whether it wants the last changes, too.
        clients: whether it wants to know who is connected, too.
    """

    role: AccessRole
    form: Form
    since: int | None = None
    past: bool = False
    clients: bool = False


@frozen
class StatusAnswer:
    """The answer, but for what is the client's own.

    Attributes:
        fields: of the message, each as it is written.
        number: of the last change that it has in `past`.
    """

    fields: Mapping[str, bytes]
    number: int


@define(eq=False)
class StatusViews:
    """Answers from one look at the robot, whatever is asked; for one thread.

    Args:
        status: returns the whole status map.
        past: returns the last changes, and how many seconds ago they were.
        clients: returns who is connected.
        clock: seconds.
    """

    _status: Callable[[], StatusMap]
    _past: Callable[[], list[tuple[float, StatusEvent]]]
    _views: RoleViews
    _clients: Callable[[], list[dict[str, Any]]] = list
    _clock: Clock = time.monotonic
    _boards: OrderedDict[AccessRole, _RoleStatus] = field(factory=OrderedDict, init=False)

    def make(self, questions: Collection[StatusQuestion]) -> dict[StatusQuestion, StatusAnswer]:
        # What changes after this is sent to who watches; the map may have it already.
        past = self._past()
        number = past[-1][1].number if past else 0
        status, now = self._status(), self._clock()
        views = {
            role: self._views.of(role)
            for role in {status_question.role for status_question in questions}
        }
        for role, view in views.items():
            self._board(role).look(visible_status(status, view), now)
        answers = {}
        for question in questions:
            reports = self._boards[question.role].write(question.form, question.since)
            if question.past:
                shown = _shown_past(past, views[question.role])
                reports["past"] = question.form.write(shown)
            if question.clients:
                reports["clients"] = question.form.write(self._clients())
            answers[question] = StatusAnswer(reports, number)
        return answers

    def _board(self, role: AccessRole) -> _RoleStatus:
        board = self._boards.setdefault(role, _RoleStatus())
        self._boards.move_to_end(role)
        if len(self._boards) > _ROLES:
            self._boards.popitem(last=False)
        return board


@define(eq=False)
class _Entry:
    """A value of the map, since which version it is so, and how it is written."""

    value: Any
    version: int
    written: dict[str, bytes] = field(factory=dict)

    def write(self, form: Form) -> bytes:
        if form.name not in self.written:
            self.written[form.name] = form.write(to_json(self.value))
        return self.written[form.name]


@define(eq=False)
class _Part:
    """The entries of a large part of the map, by key.

    Attributes:
        gone: keys that were there, with the version that was the first without them.
        whole: the version up to which what has changed is not known by keys.
    """

    key: Callable[[Any], Any]
    entries: dict[Any, _Entry] = field(factory=dict)
    gone: deque[tuple[int, Any]] = field(factory=deque)
    whole: int = 0
    had_twins: bool = False

    def look(self, values: Iterable[Any], version: int) -> None:
        former, self.entries = self.entries, {}
        seen: Counter[Any] = Counter()
        for value in values:
            key = self.key(value)
            name = tuple(key) if isinstance(key, list) else key
            place = name, seen[name]  # a component that was replaced may run beside the new one
            seen[name] += 1
            entry = former.pop(place, None)
            if entry is None or not _is_same(entry.value, value):
                entry = _Entry(value, version)
            elif entry.value != value:  # only the clock has gone on
                entry.value = value
                entry.written.clear()
            self.entries[place] = entry
        has_twins = any(count > 1 for count in seen.values())
        if has_twins or self.had_twins:
            self.whole = version
        self.had_twins = has_twins
        self.gone.extend((version, name) for name, _ in former if name not in seen)
        while len(self.gone) > _FORGOTTEN:
            self.whole = max(self.whole, self.gone.popleft()[0])

    def write(self, form: Form) -> bytes:
        return form.list_of([entry.write(form) for entry in self.entries.values()])

    def write_since(self, form: Form, since: int) -> bytes | None:
        """Return what has changed; None: nothing has."""
        if since < self.whole:
            return self.write(form)
        changed = [entry.write(form) for entry in self.entries.values() if entry.version > since]
        gone = [
            list(name) if isinstance(name, tuple) else name
            for version, name in self.gone
            if version > since and (name, 0) not in self.entries
        ]
        if not changed and not gone:
            return None
        return form.map_of({"changed": form.list_of(changed), "gone": form.write(gone)})


class _RoleStatus:
    """The map as one role sees it, and since which version each part of it is as it is."""

    def __init__(self) -> None:
        # A number that no other server begins with: what a client has of another is not of this.
        self._version = secrets.randbits(40)
        self._times: OrderedDict[int, float] = OrderedDict()
        self._parts = {name: _Part(key) for name, key in _KEYS.items()}
        self._small: dict[str, _Entry] = {}

    def look(self, status: StatusMap, now: float) -> None:
        self._version += 1
        self._times[self._version] = now
        if len(self._times) > _VERSIONS:
            self._times.popitem(last=False)
        for name in (attribute.name for attribute in fields(StatusMap)):
            value = getattr(status, name)
            if name in self._parts:
                self._parts[name].look(value, self._version)
            elif name not in self._small or self._small[name].value != value:
                self._small[name] = _Entry(value, self._version)

    def write(self, form: Form, since: int | None) -> dict[str, bytes]:
        """Return the fields of the whole map, or those that have changed since a known version."""
        parts = {"version": form.write(self._version)}
        known = None if since is None else self._times.get(since)
        if since is None or known is None:
            parts |= {name: entry.write(form) for name, entry in self._small.items()}
            return parts | {name: part.write(form) for name, part in self._parts.items()}
        elapsed = self._times[self._version] - known
        parts |= {"since": form.write(since), "elapsed": form.write(elapsed)}
        parts |= {
            name: entry.write(form) for name, entry in self._small.items() if entry.version > since
        }
        for name, part in self._parts.items():
            report = part.write_since(form, since)
            if report is not None:
                parts[name] = report
        return parts


def _is_same(former: Any, value: Any) -> bool:
    """Say whether nothing has changed but the age of a route's last message, which grows."""
    if former == value:
        return True
    return (
        isinstance(value, RouteStatus)
        and None not in (former.age, value.age)
        and former.received == value.received
        and evolve(former, age=value.age) == value
    )


def _shown_past(past: list[tuple[float, StatusEvent]], view: RoleView) -> list[dict[str, Any]]:
    shown = ((age, shown_event(event, view)) for age, event in past)
    return [{**reports, "age": age} for age, reports in shown if reports is not None]
