"""No text names what a role does not see, and nothing is left out for one that sees everything."""

from __future__ import annotations

from typing import Any

import pytest
from attrs import evolve, fields

from uoarm.config import loads
from uoarm.model import (
    BridgeStatus,
    ComponentStatus,
    ConnectionState,
    ConnectionStatus,
    Health,
    LockDifference,
    MachineStatus,
    OfferState,
    OfferStatus,
    Robot,
    RouteStatus,
    StatusEvent,
    StatusMap,
)
from uoarm.server.access import AccessRole, Operation, RoleView, RoleViews
from uoarm.server.session._views import visible_status

ROBOT: Robot = loads(
    """
version: 1
bridges: {python: {}, vault: {plugin: python}}
functions:
  public:
    components:
      - name: front
        bridge: python
        input: {from: secret, endpoint: ["tests.server.robot:echo"]}
        output: {endpoint: ["tests.server.robot:echo"]}
  secret:
    components:
      - {name: hidden-one, bridge: vault, output: {endpoint: ["tests.server.robot:numbers"]}}
""",
    "robot.yaml",
)
ALL = AccessRole("all", everything=frozenset(Operation))
GUEST = AccessRole("guest", {Operation.SEE: ("public", "p?b*")})
BLIND = AccessRole("blind", {})
CAUSE = "component 'hidden-one' of secret: bridge 'vault' is gone"
ROUTE = RouteStatus("hidden-one.default", "front.default", 1, 1, last_error=CAUSE)
STATUS = StatusMap(
    bridges=(
        BridgeStatus("python", "python", Health.OK, 1, cause=CAUSE),
        BridgeStatus("vault", "python", Health.LOST, 0),
    ),
    components=(
        ComponentStatus("front", "public", "python", Health.OK, ("c1",), cause=CAUSE),
        ComponentStatus("hidden-one", "secret", "vault", Health.LOST, ("c1",)),
    ),
    connections=(
        ConnectionStatus(
            "c1", "public", ConnectionState.WAITING, ("hidden-one", "front"), CAUSE, ended=(ROUTE,)
        ),
        ConnectionStatus("c2", "secret", ConnectionState.RUNNING, ("hidden-one",)),
    ),
    routes=(ROUTE, RouteStatus("front.default", "c1", 1, 1, last_error=CAUSE)),
    machines=(MachineStatus("arm", False, ("python", "vault"), cause=CAUSE),),
    deaths=(("front", 1), ("hidden-one", 2)),
    takeovers=(("public", 1), ("secret", 2)),
    offers=(
        OfferStatus("python:public", "public", "python", OfferState.OPEN, cause=CAUSE),
        OfferStatus("vault:secret", "secret", "vault", OfferState.OPEN),
    ),
    held=1.5,
    lock=(
        LockDifference("front", "output.default", False, 1, CAUSE),
        LockDifference("hidden-one", "output.default", False, 1, CAUSE),
    ),
)
PARTS = [attribute.name for attribute in fields(StatusMap)]


def view(role: AccessRole) -> RoleView:
    return RoleViews(lambda: ROBOT).of(role)


def test_every_part_of_the_status_map_is_tried_here() -> None:
    assert all(getattr(STATUS, part) for part in PARTS), "give a new part of the map a value above"


def test_a_role_that_sees_everything_lacks_nothing() -> None:
    assert visible_status(STATUS, view(ALL)) == STATUS


@pytest.mark.parametrize("part", [part for part in PARTS if part != "held"])
def test_a_role_that_sees_no_function_gets_nothing_of_a_part(part: str) -> None:
    """So a part that is new and not narrowed down for roles fails here."""
    assert not getattr(visible_status(STATUS, view(BLIND)), part)


@pytest.mark.parametrize("part", PARTS)
def test_a_role_gets_what_it_sees_and_no_name_of_the_rest(part: str) -> None:
    shown: Any = getattr(visible_status(STATUS, view(GUEST)), part)
    assert shown
    for name in ("secret", "hidden-one", "vault"):
        assert name not in str(shown)


def test_a_component_that_has_the_name_of_a_connection_is_another() -> None:
    robot = loads(
        """
version: 1
bridges: {python: {}}
functions:
  public: {components: [{name: c2, bridge: python, output: {endpoint: ["a:b"]}}]}
  secret: {components: [{name: c1, bridge: python, output: {endpoint: ["a:b"]}}]}
""",
        "robot.yaml",
    )
    seen = RouteStatus("c2.default", "c1", 1, 1)
    secret = RouteStatus("c1.default", "c1", 1, 1), RouteStatus("c2.default", "c2", 1, 1)
    status = evolve(
        STATUS,
        components=(
            ComponentStatus("c2", "public", "python", Health.OK, ("c1",)),
            ComponentStatus("c1", "secret", "python", Health.OK, ("c2",)),
        ),
        connections=(
            ConnectionStatus("c1", "public", ConnectionState.RUNNING, ("c2",)),
            ConnectionStatus("c2", "secret", ConnectionState.RUNNING, ("c1",)),
        ),
        routes=(seen, *secret),
        deaths=(("c1", 1),),
    )
    shown = visible_status(status, RoleViews(lambda: robot).of(GUEST))
    assert shown.routes == (seen,)
    assert shown.deaths == ()


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (CAUSE, "component '…' of …: bridge '…' is gone"),
        ("public gets its input from secret.default", "public gets its input from ….default"),
        ("there is no function 'publix'; did you mean 'secret'?", "there is no function 'publix'"),
        ("no 'publix'; did you mean 'public'?", "no 'publix'; did you mean 'public'?"),
        ("secretary is no name of this robot", "secretary is no name of this robot"),
    ],
)
def test_names_in_texts(text: str, shown: str) -> None:
    assert view(GUEST).text(text) == shown
    assert view(ALL).text(text) == text


def test_what_the_client_itself_named_stays_whether_it_is_there_or_not() -> None:
    texts = {
        name: view(GUEST).text(f"may not see {name!r}", name).replace(name, "NAME")
        for name in ("secret", "nothing")
    }
    assert len(set(texts.values())) == 1


def test_names_of_a_moment_ago_are_hidden_still() -> None:
    robot = [ROBOT]
    views = RoleViews(lambda: robot[0])
    views.of(GUEST)
    robot[0] = loads("version: 1\nbridges: {python: {}}\nfunctions: {}\n", "robot.yaml")
    assert views.of(GUEST).text("component hidden-one is gone") == "component … is gone"


@pytest.mark.parametrize("pattern", ["*", "?", "[!s]*", "[*]", "", "all"])
def test_no_pattern_gives_what_is_of_no_function(pattern: str) -> None:
    role = AccessRole("r", dict.fromkeys(Operation, (pattern,)))
    for operation in Operation:
        assert not role.allows_all(operation)
        assert not role.allows(operation, "")


def test_changes_are_of_functions_and_bridges_that_a_role_sees() -> None:
    events = {
        "component front": "public", "component hidden-one": "secret", "connection c1": "public",
        "bridge python": "", "bridge vault": "", "machine arm": "",
    }  # fmt: skip
    seen = {
        role.name: [
            subject
            for number, (subject, function) in enumerate(events.items())
            if view(role).has_event(StatusEvent(number, 0, subject, "lost", function=function))
        ]
        for role in (ALL, GUEST, BLIND)
    }
    assert seen == {
        "all": list(events),
        "guest": ["component front", "connection c1", "bridge python"],
        "blind": [],
    }
