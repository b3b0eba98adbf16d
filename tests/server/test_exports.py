"""What another manager gets: what is exported to its role, and no name of anything else."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.server.conftest import Serve
from tests.server.robot import CONFIGURATION, script
from tests.server.talk import SECONDS, Talk
from websockets.exceptions import ConnectionClosed, InvalidStatus

from uoarm import RobotManager
from uoarm.bridge import MOST_HOPS
from uoarm.config import loads
from uoarm.errors import ConfigurationError
from uoarm.server import Server, hash_token, make_token

TOKEN, OTHER = make_token(), make_token()
DESK, SECOND = "a" * 32, "b" * 32
EXPORTS = "export: {fleet: [echo, doubled, 'add'], other: [picture]}\n"
ACCESS = f"""
version: 1
roles:
  fleet: {{see: all, request: all, send: [echo], call: all, kill: all, configure: all, stop: all}}
  other: {{see: [picture, echo], request: [picture]}}
tokens:
  - {{name: desk, role: fleet, sha256: {hash_token(TOKEN)}}}
  - {{name: screen, role: other, sha256: {hash_token(OTHER)}}}
"""
HIDDEN = ("numbers", "picture", "many", "parrot", "slow", "broken", "quits", "hang", "missing")


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    script.reset()
    origin = str(Path(__file__).parent / "robot.yaml")
    with RobotManager(loads(CONFIGURATION + EXPORTS, origin=origin)) as manager:
        yield manager
        script.release()


@pytest.fixture
def guarded(serve: Serve, tmp_path: Path) -> Server:
    access = tmp_path / "access.yaml"
    access.write_text(ACCESS, encoding="utf-8")
    return serve(access=access)


def enter(server: Server, importer: str | None = DESK, token: str = TOKEN) -> Talk:
    headers = {"Authorization": f"Bearer {token}"}
    if importer is not None:
        headers["Uoarm-Manager"] = importer
    return Talk(f"ws://127.0.0.1:{server.ports[0]}/", additional_headers=headers)


def test_a_manager_has_an_identity_of_its_own(guarded: Server, robot: RobotManager) -> None:
    with enter(guarded) as client:
        assert client.hello["manager"] == robot.identity
        assert len(robot.identity) == 32
    with RobotManager(loads(CONFIGURATION)) as second:
        assert second.identity != robot.identity


def test_another_manager_sees_what_is_exported_to_its_role(guarded: Server) -> None:
    with enter(guarded) as client:
        listed = client.ask("List")["functions"]
        assert [function["name"] for function in listed] == ["doubled", "echo", "add"]
    with enter(guarded, token=OTHER) as client:
        assert [function["name"] for function in client.ask("List")["functions"]] == ["picture"]
    with enter(guarded, importer=None) as client:
        assert len(client.ask("List")["functions"]) > 3


def test_without_an_export_nothing_is_shown(serve: Serve, robot: RobotManager) -> None:
    server = serve()  # its clients have the role local, of which the list says nothing
    with Talk(
        f"ws://127.0.0.1:{server.ports[0]}/", additional_headers={"Uoarm-Manager": DESK}
    ) as client:
        assert client.ask("List")["functions"] == []
        status = client.ask("Status")
        assert not status["components"]
        assert not status["connections"]
        assert not status["bridges"]
        assert client.refused("Request", "echo")["code"] == "denied"


@pytest.mark.parametrize("op", ["Request", "Resolve", "Call"])
def test_what_is_not_exported_and_what_is_not_there_are_refused_alike(
    guarded: Server, op: str
) -> None:
    more: dict[str, object] = {"message": {}} if op == "Call" else {}
    with enter(guarded) as client:
        texts = {
            client.refused(op, name, **more)["text"].replace(name, "X")
            for name in ("numbers", "number", "ech", "nothing_like_it", "picture")
        }
    (text,) = texts
    assert "export" in text
    assert "did you mean" not in text


def test_no_answer_names_what_is_not_exported(guarded: Server, robot: RobotManager) -> None:
    with enter(guarded) as client, enter(guarded, importer=None) as local:
        local.open("picture")
        local.open("numbers")
        connection = client.open("doubled")  # is fed by numbers, which is not exported
        said = [
            client.ask("List"),
            client.ask("Status"),
            client.ask("Status", "watch"),
            client.ask("Resolve", "doubled"),
            client.refused("Request", "echos"),
            client.refused("Data", f"{connection}.nowhere", {"value": 1}),
            client.refused("Configure"),
            client.refused("Discover"),
        ]
    shown = json.dumps(said)
    for name in HIDDEN:
        assert f'"{name}"' not in shown
        assert f" {name} " not in shown


def test_an_export_gives_no_right_that_the_role_has_not(guarded: Server) -> None:
    with enter(guarded) as client:
        client.open("echo")
        connection = client.open("doubled")
        assert client.refused("Data", connection, {"value": 1})["code"] == "denied"
        for op in ("Configure", "Discover"):
            assert client.refused(op)["code"] == "denied"
        client.ask("Stop")  # the emergency stop of a desk reaches its robots
        assert client.refused("Stop", message={"release": True})["code"] == "denied"


def test_a_session_goes_on_for_the_manager_that_has_it_only(guarded: Server) -> None:
    with enter(guarded) as client:
        key = client.ask("Resume")["key"]
        client.socket.socket.close()
    for importer, token in ((SECOND, TOKEN), (None, TOKEN), (DESK, OTHER)):
        with enter(guarded, importer, token) as stranger:
            refused = stranger.refused("Resume", message={"key": key, "waiting": []})
            assert refused["code"] == "unknown"


def test_a_changed_export_ends_what_rested_on_it(guarded: Server, robot: RobotManager) -> None:
    with enter(guarded) as client:
        client.open("echo")
        robot.apply(loads(CONFIGURATION + "export: {fleet: [add]}\n", origin=robot.config.origin))
        with pytest.raises(ConnectionClosed, match="rights have changed"):
            client.socket.recv(timeout=SECONDS)
    with enter(guarded) as client:
        assert [function["name"] for function in client.ask("List")["functions"]] == ["add"]


@pytest.mark.parametrize("identity", ["", "a" * 31, "A" * 32, "../../../../etc/passwd"])
def test_an_identity_that_is_none_is_refused(guarded: Server, identity: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        enter(guarded, identity)
    assert refused.value.response.status_code == 400


def test_a_way_that_comes_back_is_refused_and_shown(guarded: Server, robot: RobotManager) -> None:
    way = [robot.identity, DESK]
    with enter(guarded) as client:
        for op in ("Request", "Resolve"):
            text = client.refused(op, "echo", **{"x-managers": way})["text"]
            shown = f"{robot.identity[:8]} -> aaaaaaaa -> {robot.identity[:8]}"
            assert f"a loop through managers: {shown}" in text


def test_hops_are_bounded(guarded: Server) -> None:
    way = [f"{number:032x}" for number in range(MOST_HOPS)]
    with enter(guarded) as client:
        client.ask("Resolve", "echo", **{"x-managers": way[1:]})
        text = client.refused("Resolve", "echo", **{"x-managers": way})["text"]
        assert f"{MOST_HOPS} at most" in text


def test_answers_say_through_which_managers(guarded: Server, robot: RobotManager) -> None:
    with enter(guarded) as client:
        assert client.ask("Request", "echo")["managers"] == [robot.identity]
        assert client.ask("Resolve", "add")["managers"] == [robot.identity]


def test_what_is_exported_must_be_there() -> None:
    with pytest.raises(ConfigurationError, match=r'"ecko" to export.*did you mean "echo"'):
        loads(CONFIGURATION + "export: {fleet: [echo, ecko]}\n")
    robot = loads(CONFIGURATION + "export: {fleet: ['e*', echo]}\n")
    assert robot.exports == {"fleet": ("e*", "echo")}
