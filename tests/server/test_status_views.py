"""The status map in versions: what a client has, with the changes since then, is the whole map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from attrs import evolve, fields
from tests.server.test_role_views import ALL, BLIND, GUEST, ROBOT, STATUS
from tests.sweeps import for_all

from uoarm._wire import BINARY_FORM, TEXT_FORM, Form, read_binary, read_text
from uoarm.client._requests import merged_status
from uoarm.model import Budget, BudgetUse, RouteStatus, StatusMap, to_json
from uoarm.server.access import AccessRole, RoleViews
from uoarm.server.session._views import StatusQuestion, StatusViews, visible_status
from uoarm.testing import ManualClock

VIEWS = RoleViews(lambda: ROBOT)
ROUTE = RouteStatus("front.a", "c1", 5, 5, age=2.0)


class Robot:
    """A status map that a test changes."""

    def __init__(self) -> None:
        self.status = STATUS
        self.clock = ManualClock()
        self.views = StatusViews(lambda: self.status, list, VIEWS, clock=self.clock)

    def ask(
        self, since: int | None = None, *, role: AccessRole = ALL, form: Form = TEXT_FORM
    ) -> dict[str, Any]:
        question = StatusQuestion(role, form, since)
        report = form.map_of(self.views.make([question])[question].fields)
        spending = BudgetUse(Budget())
        found: Any = (
            read_text(report.decode(), spending) if form.text else read_binary(report, spending)
        )
        return dict(found)


def plain(status: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: sorted(value, key=str) if isinstance(value, list) else value
        for name, value in status.items()
        if name != "version"
    }


CHANGES: Mapping[str, StatusMap] = {
    "nothing": STATUS,
    "everything gone": StatusMap(),
    "held": evolve(STATUS, held=None),
    "a component gone": evolve(STATUS, components=STATUS.components[:1]),
    "a component changed": evolve(
        STATUS, components=(evolve(STATUS.components[0], failed=3), *STATUS.components[1:])
    ),
    "a connection new": evolve(
        STATUS, connections=(*STATUS.connections, evolve(STATUS.connections[0], id="c3"))
    ),
    "another order": evolve(STATUS, components=STATUS.components[::-1]),
    "a component beside its successor": evolve(
        STATUS, components=(*STATUS.components, evolve(STATUS.components[0], failed=4))
    ),
    "routes": evolve(STATUS, routes=(*STATUS.routes, ROUTE)),
    "deaths": evolve(STATUS, deaths=(("front", 2),)),
    "a cause": evolve(STATUS, bridges=(evolve(STATUS.bridges[0], cause="x"),)),
}


@for_all("role", [ALL, GUEST, BLIND], lambda role: role.name)
@for_all("form", [TEXT_FORM, BINARY_FORM], lambda form: form.name)
@for_all("change", CHANGES)
def test_what_is_known_with_what_has_changed_is_the_whole(
    change: str, form: Form, role: AccessRole
) -> None:
    robot = Robot()
    known: Mapping[str, Any] = robot.ask(role=role, form=form)
    for status in (STATUS, CHANGES[change]) * 2:
        robot.status = status
        reports = robot.ask(known["version"], role=role, form=form)
        assert reports["since"] == known["version"]
        known = merged_status(known, reports)
        assert plain(known) == plain(to_json(visible_status(status, VIEWS.of(role))))


def test_what_has_not_changed_is_not_reported() -> None:
    robot = Robot()
    reports = robot.ask(robot.ask()["version"])
    assert not reports.keys() & {attribute.name for attribute in fields(StatusMap)}


def test_the_age_of_a_route_alone_is_not_reported_and_known_all_the_same() -> None:
    robot = Robot()
    robot.status = evolve(STATUS, routes=(ROUTE,))
    known = robot.ask()
    robot.clock.advance(3)
    robot.status = evolve(STATUS, routes=(evolve(ROUTE, age=5.0),))
    reports = robot.ask(known["version"])
    assert "routes" not in reports
    assert merged_status(known, reports)["routes"][0]["age"] == 5
    assert robot.ask()["routes"][0]["age"] == 5


def test_a_version_that_is_not_known_gets_the_whole_map() -> None:
    robot = Robot()
    first = robot.ask()["version"]
    for _ in range(300):
        robot.ask()
    for version in (0, first, 2**52):
        reports = robot.ask(version)
        assert "since" not in reports
        assert reports["components"]


def test_versions_of_another_server_are_not_those_of_this() -> None:
    versions = {Robot().ask()["version"] for _ in range(5)}
    assert len(versions) == 5


def test_one_look_answers_whatever_is_asked_at_the_same_time() -> None:
    looks: list[None] = []

    def status() -> StatusMap:
        looks.append(None)
        return STATUS

    views = StatusViews(status, list, VIEWS)
    questions = [
        StatusQuestion(role, form, past=past)
        for role in (ALL, GUEST)
        for form in (TEXT_FORM, BINARY_FORM)
        for past in (False, True)
    ]
    assert views.make(questions).keys() == set(questions)
    assert len(looks) == 1
