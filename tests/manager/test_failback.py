"""A connection returns to better components, also where one that stays must be fed by others."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from typing import Any

import pytest
from attrs import evolve
from tests.control.world import FACE

from uoarm import Connection, RobotManager
from uoarm._control.engine.events import TimeReached
from uoarm._control.engine.state import ConnectionRecord
from uoarm.config import loads
from uoarm.model import ConnectionState, FailoverPolicy, ValidationMode
from uoarm.testing import (
    ManualClock,
    MemoryBridge,
    copies,
    losses,
    patience,
    wait,
)

NUMBER = {"type": "integer", "minimum": 0, "maximum": 100_000}
PATIENCE = 1000.0
BETWEEN_LOOKS = PATIENCE / 4

NAME = """
  name:
    components:
      - name: namer
        bridge: one
        input: {from: face, endpoint: [namer]}
        output: {endpoint: [namer]}
"""


def look(robot: RobotManager) -> None:
    """Have a robot look whether it is time, and wait until what follows is over."""
    robot._driver.post(TimeReached())  # another thread may own the state, and then handles it
    wait(lambda: rests(robot))


def rests(robot: RobotManager) -> bool:
    """Say whether no event waits, none is being handled, and no work follows from one."""
    driver = robot._driver
    if not driver._owning.acquire(blocking=False):
        return False
    try:  # what is being done posts its event before it is over, and none is handled meanwhile
        return not driver._lanes._lanes and not driver._events
    finally:
        driver._owning.release()
        driver.work()  # what came meanwhile was left to us


class Stage:
    """A robot whose clock stands still, so that it returns only when a test looks."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.one, self.two = MemoryBridge("one", {}), MemoryBridge("two", {})
        self.best = self.one.emitter("best", NUMBER)
        self.spare = self.two.emitter("spare", NUMBER)
        self.finder = self.two.loop("finder", NUMBER)
        self.namer = self.one.loop("namer", NUMBER)
        robot = evolve(loads(FACE + NAME), failover=FailoverPolicy(return_after=PATIENCE))
        bridges = {"one": self.one, "two": self.two}
        self.robot = RobotManager(robot, bridges=bridges, clock=self.clock)

    def lose_best(self, *users: Connection) -> None:
        """Let the better camera die, and wait until its users go on."""
        self.one.die("best", "it was unplugged")
        wait(lambda: all(user.gaps for user in users))

    def revive_best(self) -> None:
        self.best = self.one.emitter("best", NUMBER)

    def look(self) -> None:
        """Have it look whether it is time, and wait until what follows is over."""
        look(self.robot)

    def look_twice(self) -> None:
        """Look when the better camera is seen again, and when patience is over."""
        self.clock.advance(BETWEEN_LOOKS)
        self.look()
        self.clock.advance(PATIENCE)
        self.look()

    def records(self) -> tuple[ConnectionRecord, ...]:
        return tuple(self.robot._driver.state.connections.values())


@pytest.fixture
def stage() -> Iterator[Stage]:
    made = Stage()
    yield made
    made.robot.close()


def cameras(stage: Stage) -> list[str]:
    open_now = stage.robot.status().components
    return [live.name for live in open_now if live.function == "camera"]


def set_user(robot: RobotManager, user: str, mode: ValidationMode | None) -> None:
    """Let it use every edge, or, with None, those no more that it uses."""
    driver = robot._driver
    edges = driver.state.edges
    for number, edge in edges.items():
        if mode is not None or user in edge.users:
            edges = edges.insert(number, edge.used_by(user, mode))
    driver.state = evolve(driver.state, edges=edges)


def test_a_component_in_the_middle_is_fed_by_the_better_one_again(stage: Stage) -> None:
    connection = stage.robot.request("face")
    stage.lose_best(connection)
    stage.spare.emit(1)
    assert connection.get(patience()) == 1
    stage.revive_best()
    stage.look_twice()
    assert [gap.after for gap in connection.gaps] == [("spare", "finder"), ("best", "finder")]
    assert connection.gaps[1].lost == 0
    assert cameras(stage) == ["best"]
    stage.spare.emit(2)
    stage.best.emit(3)
    assert connection.get(patience()) == 3
    assert stage.two.open_channels == 2  # the finder's own


def test_it_does_not_return_before_its_patience_is_over(stage: Stage) -> None:
    connection = stage.robot.request("face")
    stage.lose_best(connection)
    stage.revive_best()
    stage.clock.advance(BETWEEN_LOOKS)
    stage.look()
    stage.clock.advance(PATIENCE - 1)
    stage.look()
    assert len(connection.gaps) == 1
    stage.one.die("best")
    stage.clock.advance(BETWEEN_LOOKS)
    stage.look()  # gone again: patience begins anew
    stage.revive_best()
    stage.clock.advance(BETWEEN_LOOKS)
    stage.look()
    assert len(connection.gaps) == 1
    assert cameras(stage) == ["spare"]


def test_all_that_share_what_is_fed_return_together(stage: Stage) -> None:
    moved = stage.robot.request("face")
    stage.lose_best(moved)
    later, deeper = stage.robot.request("face"), stage.robot.request("name")
    stage.revive_best()
    stage.look_twice()
    assert [len(connection.gaps) for connection in (moved, later, deeper)] == [2, 1, 1]
    assert cameras(stage) == ["best"]
    stage.best.emit(4)
    assert [connection.get(patience()) for connection in (moved, later, deeper)] == [4, 4, 4]
    assert not any(record.preferred for record in stage.records())  # nothing is left to look for


def test_one_that_cannot_return_leaves_all_where_they_are(stage: Stage) -> None:
    connection = stage.robot.request("face")
    stage.lose_best(connection)
    stage.revive_best()
    # A stranger who is fed by the spare, and stays.
    set_user(stage.robot, "c99", ValidationMode.OFF)
    stage.look_twice()
    assert len(connection.gaps) == 1
    assert cameras(stage) == ["spare"]
    assert stage.one.open_channels == 0  # what was opened of the better one is closed again
    stage.spare.emit(5)
    assert connection.get(patience()) == 5
    set_user(stage.robot, "c99", None)
    stage.look_twice()
    assert [gap.after[0] for gap in connection.gaps] == ["spare", "best"]


def test_every_message_is_received_or_counted_through_death_and_return(stage: Stage) -> None:
    got: list[int] = []
    connection = stage.robot.request("name", on_message=got.append)
    emitted = 0

    def emit(camera: str, count: int) -> None:
        nonlocal emitted
        for _ in range(count):
            getattr(stage, camera).emit(emitted)
            emitted += 1

    emit("best", 500)
    stage.lose_best(connection)
    emit("spare", 500)
    stage.revive_best()
    stage.clock.advance(BETWEEN_LOOKS)
    stage.look()
    stage.clock.advance(PATIENCE)
    returning = threading.Thread(target=stage.look)
    returning.start()
    while returning.is_alive():
        emit("spare", 1)
    emit("best", 500)
    status = connection.status
    fed = sum(
        route.received
        for route in (*stage.robot.status().routes, *status().ended)
        if route.consumer == "finder.default"
    )
    assert 1500 <= fed <= emitted  # once its edge has ended, the spare is received no more

    def accounted() -> int:
        routes = (*stage.robot.status().routes, *status().ended)
        return len(got) + sum(sum(dict(route_status.dropped).values()) for route_status in routes)

    wait(lambda: accounted() == fed)
    assert status().lost <= emitted - fed  # what the spare emitted until it was closed
    assert got == sorted(set(got))
    assert connection.state is ConnectionState.RUNNING


def returned_while_the_spare_runs_out(
    stage: Stage, connection: Connection, monkeypatch: pytest.MonkeyPatch
) -> threading.Event:
    """Return from the spare camera to the better one; the plan with it runs out at the event."""
    stage.lose_best(connection)
    stage.revive_best()
    stage.clock.advance(BETWEEN_LOOKS)
    stage.look()
    stage.clock.advance(PATIENCE)
    live = stage.robot._driver.live
    finish, gate = live.finish, threading.Event()

    def finish_late(*ending: Any) -> None:
        gate.wait(patience())
        finish(*ending)

    monkeypatch.setattr(live, "finish", finish_late)
    stage.robot._driver.post(TimeReached())
    wait(lambda: len(connection.gaps) == 2)
    return gate


def test_a_component_that_is_wanted_again_while_its_plan_runs_out_is_not_opened_twice(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What two instances of it get counted once as received, and once as lost."""
    got = list[int]()
    connection = stage.robot.request("face", on_message=got.append)
    gate = returned_while_the_spare_runs_out(stage, connection, monkeypatch)
    stage.spare.emit(0)  # it is not taken
    stage.one.die("best", "it was unplugged again")
    wait(lambda: len(connection.gaps) == 3)
    assert cameras(stage) == ["spare"]
    for number in range(1, 11):
        stage.spare.emit(number)
    gate.set()
    wait(lambda: rests(stage.robot))
    stage.spare.emit(11)
    wait(lambda: len(got) == 11)
    assert got == list(range(1, 12))
    assert losses(stage.robot.status()).total() == 1
    assert stage.two.open_channels == len(["spare", "finder's input", "finder's output"])
    assert all(gap.counted for gap in connection.gaps)


def test_what_no_request_wants_again_is_closed_when_its_plan_has_run_out(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection = stage.robot.request("face")
    gate = returned_while_the_spare_runs_out(stage, connection, monkeypatch)
    stage.spare.emit(0)
    connection.kill()
    assert cameras(stage) == []
    gate.set()
    wait(lambda: rests(stage.robot))
    assert (stage.one.open_channels, stage.two.open_channels) == (0, 0)
    assert [gap.lost for gap in connection.gaps] == [0, 1]


SHARED = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components: [{name: camera, bridge: two, output: {endpoint: [camera]}}]
  face:
    components:
      - name: near
        bridge: one
        priority: 2
        input: {from: camera, endpoint: [near]}
        output: {endpoint: [near]}
      - name: far
        bridge: two
        priority: 1
        input: {from: camera, endpoint: [far]}
        output: {endpoint: [far]}
"""


def test_what_two_candidates_get_as_one_takes_over_counts_as_a_copy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both work until the inputs have changed hands: one is received, the other one counts."""
    one, two = MemoryBridge("one", {}), MemoryBridge("two", {})
    camera = two.emitter("camera", NUMBER)
    one.loop("near", NUMBER)
    two.loop("far", NUMBER)
    robot = evolve(loads(SHARED), failover=FailoverPolicy(return_after=PATIENCE))
    got, clock = list[int](), ManualClock()
    with RobotManager(robot, bridges={"one": one, "two": two}, clock=clock) as manager:
        connection = manager.request("face", on_message=got.append)
        camera.emit(1)
        wait(lambda: got == [1])
        one.die("near", "it was unplugged")
        wait(lambda: connection.gaps)
        camera.emit(2)
        one.loop("near", NUMBER)
        live = manager._driver.live
        switch = live.switch_inputs

        def delivered(finder: str) -> int:
            routes = manager.status().routes
            return sum(route.delivered for route in routes if route.consumer == f"{finder}.default")

        def emit_and_switch(edges: Iterable[tuple[int, int | None]]) -> None:
            for number in (3, 4, 5):
                camera.emit(number)
            # What near makes of them later is received as well: what far had made of them is, too.
            wait(lambda: delivered("near") == 3 and delivered("far") == 4)
            switch(edges)

        monkeypatch.setattr(live, "switch_inputs", emit_and_switch)
        for seconds in (BETWEEN_LOOKS, PATIENCE):
            clock.advance(seconds)
            look(manager)
        camera.emit(6)
        assert [gap.after[-1] for gap in connection.gaps] == ["far", "near"]
        wait(lambda: len(got) == 6)
        assert got == [1, 2, 3, 4, 5, 6]
        assert losses(manager.status()) == {"replaced": 3}
        assert copies(manager.status()) == 3
