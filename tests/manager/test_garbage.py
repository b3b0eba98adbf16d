"""What a connection had is gone with its end, without the interpreter's garbage collector.

The collector holds up every thread while it looks at all that the process has, so that what leaves
cycles behind makes the slowest requests slower.
"""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator

import pytest
from tests.manager import stage

from uoarm import RobotManager
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
