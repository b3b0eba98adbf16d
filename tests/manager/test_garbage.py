"""What a connection had is gone with its end, without the interpreter's garbage collector.

The collector holds up every thread while it looks at all that the process has, so that what leaves
cycles behind makes the slowest requests slower.
"""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.manager import stage
from tests.processes import run_python

from uoarm import RobotManager
from uoarm._control.engine.actions import Action
from uoarm._control.engine.events import Event
from uoarm._control.engine.state import State
from uoarm._control.engine.step import step
from uoarm._control.live import driver
from uoarm.testing import patience, wait

CHAIN = """
version: 1
bridges: {a: {plugin: python}}
functions:
  source:
    components: [{name: source, bridge: a, output: {endpoint: ["tests.manager.stage:narrow"]}}]
  sink:
    components:
      - name: sink
        bridge: a
        input: {from: source, endpoint: ["tests.manager.stage:take_narrow"]}
        output: {endpoint: ["tests.manager.stage:take_narrow"]}
"""

LASTING = """
from uoarm import RobotManager
from uoarm.config import loads

class Owner:
    def __init__(self):
        self.robot = RobotManager(loads('''
version: 1
bridges: {a: {plugin: python}}
functions:
  count:
    components: [{name: count, bridge: a, output: {endpoint: ["tests.manager.quitting:ticks"]}}]
'''))
        self.connection = self.robot.request("count")
    def __del__(self):
        self.connection.kill()
        self.robot.close()
        print("closed")

owner = Owner()
"""


@pytest.fixture
def uncollected() -> Iterator[None]:
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.usefixtures("uncollected")
@pytest.mark.parametrize("count", [0, 3], ids=["nothing flowed", "messages flowed"])
def test_a_connection_that_was_killed_leaves_nothing_to_the_collector(
    make_robot: Callable[[str], RobotManager], count: int
) -> None:
    robot = make_robot(CHAIN)
    connection = robot.request("sink")
    for number in range(count):
        stage.script.put({"value": number})
    for _ in range(count):
        connection.get(patience())
    live = robot._driver.live
    watched = [*live.components.values(), *live.edges.values(), *live.runtimes.values()]
    watched += [channel for component in live.components.values() for channel in component.channels]
    watched += [runtime.receiver for runtime in live.runtimes.values()]
    gone = [weakref.ref(item) for item in (*watched, connection)]
    watched.clear()
    connection.kill()
    stage.release()  # what iterates lets go
    del connection
    wait(lambda: not [reference_type() for reference_type in gone if reference_type() is not None])


@pytest.mark.usefixtures("uncollected")
def test_a_finalizer_may_end_a_connection_wherever_it_runs(
    make_robot: Callable[[str], RobotManager],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = make_robot(CHAIN)

    class Owner:
        def __init__(self) -> None:
            self.connection, self.itself = robot.request("sink"), self

        def __del__(self) -> None:
            self.connection.kill()

    def collected(state: State, event: Event, now: float) -> tuple[State, tuple[Action, ...]]:
        gc.collect()
        return step(state, event, now)

    connection = Owner().connection
    monkeypatch.setattr(driver, "step", collected)
    robot.request("source").kill()
    wait(lambda: connection.ended)


def test_a_finalizer_at_the_end_of_the_interpreter_waits_for_nothing() -> None:
    root = Path(__file__).parents[2]
    assert run_python("-c", LASTING, cwd=root, check=True).stdout == "closed\n"
