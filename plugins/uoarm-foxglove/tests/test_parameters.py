"""Parameters of components, as the configuration in force has them: shown, not set."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import pytest
from uoarm_foxglove._catalogue import (
    NOTHING,
    ChannelCatalogue,
    ListingAnswer,
    ListingQuestion,
    VisibleListing,
)
from viewer import Serve, Viewer

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server.access import hash_token, make_token
from uoarm.testing import patience

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  numbers:
    components:
      - name: counter
        bridge: python
        parameters: {fps: 30, gain: 2.0, name: front, sizes: [1.0, 2.5], lens: {on: true, pwd: x}}
        output: {endpoint: ["components:numbers"]}
  loose:
    components:
      - name: loose
        bridge: python
        parameters: {level: 1}
        output: {endpoint: ["components:loose"]}
"""
COUNTER = [
    {"name": "/counter/fps", "value": 30},
    {"name": "/counter/gain", "value": 2.0, "type": "float64"},
    {"name": "/counter/name", "value": "front"},
    {"name": "/counter/sizes", "value": [1.0, 2.5], "type": "float64_array"},
    {"name": "/counter/lens.on", "value": True},
    {"name": "/counter/lens.pwd", "value": "***"},
]
LOOSE = [{"name": "/loose/level", "value": 1}]


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    with RobotManager(loads(CONFIGURATION)) as robot:
        yield robot


def values(viewer: Viewer, *names: str, **more: object) -> Any:
    viewer.send("getParameters", parameterNames=names, **more)
    return viewer.until("parameterValues")


def test_all_or_some_are_shown(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        found = values(viewer, id="first")
        assert (found["parameters"], found["id"]) == ([*COUNTER, *LOOSE], "first")
        found = values(viewer, "/loose/level", "/none/x")
        assert found["parameters"] == [*LOOSE, {"name": "/none/x"}]
        assert "id" not in found


def test_none_is_set_and_the_viewer_gets_what_holds(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        viewer.send("setParameters", parameters=[{"name": "/loose/level", "value": 7}], id="x")
        refused = viewer.until("status")["message"]
        assert refused.startswith("setParameters: parameters are set by the configuration")
        assert viewer.until("parameterValues")["parameters"] == LOOSE


def test_a_whole_number_beyond_64_bits_is_shown_in_its_digits(
    serve: Serve, robot: RobotManager
) -> None:
    robot.apply(loads(CONFIGURATION.replace("level: 1", f"level: {2**70}")))
    with Viewer(serve()) as viewer:
        found = values(viewer, "/loose/level")["parameters"]
        assert found == [{"name": "/loose/level", "value": str(2**70)}]


def test_a_question_that_fails_is_answered(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> NoReturn:
        raise ValueError("a fault of this listing")

    monkeypatch.setattr(VisibleListing, "parameter_values", fail)
    with Viewer(serve()) as viewer:
        viewer.send("getParameters", parameterNames=[])
        assert "its log says more" in viewer.until("status")["message"]


def test_what_is_asked_is_held_until_it_is_answered(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, gate, made = threading.Event(), threading.Event(), VisibleListing.parameter_values

    def parameter_values(self: VisibleListing, *arguments: Any, **more: Any) -> bytes:
        begun.set()
        gate.wait(patience())
        return made(self, *arguments, **more)

    monkeypatch.setattr(VisibleListing, "parameter_values", parameter_values)
    server = serve()
    with Viewer(server) as viewer:
        try:
            viewer.send("getParameters", parameterNames=[f"{number:0200}" for number in range(999)])
            assert begun.wait(patience())
            assert viewer.socket.ping().wait(patience())
            assert server.held_octets > 199_800
        finally:
            gate.set()
        viewer.until("parameterValues")


def test_changes_come_to_those_who_want_them(serve: Serve, robot: RobotManager) -> None:
    with Viewer(serve()) as viewer:
        values(viewer)
        viewer.send("subscribeParameterUpdates", parameterNames=["/counter/fps", "/loose/level"])
        values(viewer)  # it has been subscribed by then
        changed = CONFIGURATION.replace("fps: 30, ", "").replace("name: front", "name: back")
        robot.apply(loads(changed.replace("level: 1", "level: 2")))
        assert viewer.until("parameterValues")["parameters"] == [
            {"name": "/counter/fps"},
            {"name": "/loose/level", "value": 2},
        ]
        viewer.send("unsubscribeParameterUpdates", parameterNames=[])
        values(viewer)
        robot.apply(loads(CONFIGURATION))
        while values(viewer, "/loose/level")["parameters"] != LOOSE:
            pass
        assert not [other for other in viewer.others if other["op"] == "parameterValues"]


@pytest.mark.parametrize("level", [True, 1.0])
def test_a_value_of_another_type_is_a_change(
    serve: Serve, robot: RobotManager, level: float
) -> None:
    with Viewer(serve()) as viewer:
        values(viewer)
        viewer.send("subscribeParameterUpdates", parameterNames=["/loose/level"])
        values(viewer)  # it has been subscribed by then
        robot.apply(loads(CONFIGURATION.replace("level: 1", f"level: {str(level).lower()}")))
        (changed,) = viewer.until("parameterValues")["parameters"]
        assert (changed["value"], type(changed["value"])) == (level, type(level))


LEVEL_2 = CONFIGURATION.replace("level: 1", "level: 2")


def test_what_changes_while_a_viewer_asks_for_it_is_sent(
    serve: Serve, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, gate, answer = threading.Event(), threading.Event(), ChannelCatalogue.answer

    async def late(catalogue: ChannelCatalogue, question: ListingQuestion) -> ListingAnswer:
        made = await answer(catalogue, question)
        if made.listing is not question.known and question.known is not NOTHING:
            begun.set()
            await asyncio.to_thread(gate.wait, patience())
        return made

    monkeypatch.setattr(ChannelCatalogue, "answer", late)
    with Viewer(serve()) as viewer:
        try:
            assert values(viewer, "/loose/level")["parameters"] == LOOSE
            robot.apply(loads(LEVEL_2))
            assert begun.wait(patience())
            viewer.send("subscribeParameterUpdates", parameterNames=["/loose/level"])
            values(viewer)  # it has been subscribed by then
        finally:
            gate.set()
        assert viewer.until("parameterValues")["parameters"] == [
            {"name": "/loose/level", "value": 2}
        ]


def test_no_answer_is_older_than_a_change_that_was_sent(
    serve: Serve, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, gate, made = threading.Event(), threading.Event(), VisibleListing.parameter_values

    def parameter_values(self: VisibleListing, *arguments: Any, **more: Any) -> bytes:
        written = made(self, *arguments, **more)
        if more and not begun.is_set():
            begun.set()
            gate.wait(patience())
        return written

    with Viewer(serve()) as viewer:
        viewer.send("subscribeParameterUpdates", parameterNames=["/loose/level"])
        values(viewer)
        monkeypatch.setattr(VisibleListing, "parameter_values", parameter_values)
        try:
            viewer.send("getParameters", parameterNames=["/loose/level"], id="x")
            assert begun.wait(patience())
            robot.apply(loads(LEVEL_2))
            changed = viewer.until("parameterValues")
        finally:
            gate.set()
        assert viewer.until("parameterValues") == {**changed, "id": "x"}


def test_a_role_sees_those_of_the_functions_that_it_sees(serve: Serve, tmp_path: Path) -> None:
    token = make_token()
    access = tmp_path / "access.yaml"
    access.write_text(
        f"""
version: 1
roles: {{guest: {{see: [loose]}}}}
tokens: [{{name: tablet, role: guest, sha256: {hash_token(token)}}}]
""",
        encoding="utf-8",
    )
    with Viewer(serve(access=access), query=f"?token={token}") as viewer:
        assert values(viewer)["parameters"] == LOOSE
        assert values(viewer, "/counter/fps")["parameters"] == [{"name": "/counter/fps"}]


@pytest.mark.parametrize("names", ["x", [1], None])
def test_names_that_are_none_are_refused(serve: Serve, names: object) -> None:
    with Viewer(serve()) as viewer:
        viewer.send("getParameters", parameterNames=names)
        refused = viewer.until("status")["message"]
        assert refused == "getParameters: parameterNames: expected a list of texts (UOA-502)"


@pytest.mark.parametrize("op", ["getParameters", "subscribeParameterUpdates"])
def test_a_name_that_is_too_long_is_refused_with_what_asked_for_it(serve: Serve, op: str) -> None:
    with Viewer(serve()) as viewer:
        viewer.send(op, parameterNames=["x" * 201])
        assert viewer.until("status")["message"].startswith(f"{op}: name: expected a text")
