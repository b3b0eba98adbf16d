"""The edge check is truly made between producer and consumer, of asymmetric types."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest
from tests.manager import stage

from uoarm import Connection, ResolutionError, RobotManager
from uoarm._dataplane import Clock
from uoarm._parts import LiveEdge
from uoarm._resolve import NoPlanError
from uoarm.config import loads
from uoarm.testing import Background, MemoryBridge, patience, wait

Make = Callable[[str], RobotManager]


def robot(source: str, sink: str, extra: str = "") -> str:
    return f"""
version: 1
bridges: {{a: {{plugin: python}}, b: {{plugin: python}}}}
functions:
  source:
    components:
      - {{name: source, bridge: a, output: {{endpoint: ["tests.manager.stage:{source}"]}}}}
  wanted:
    components:
      - name: sink
        bridge: b
        input: {{from: source, endpoint: ["tests.manager.stage:{sink}"]{extra}}}
        output: {{endpoint: ["tests.manager.stage:{sink}"]}}
"""


def test_narrow_into_broad_is_accepted(make_robot: Make) -> None:
    plan = make_robot(robot("narrow", "take_broad")).resolve("wanted")
    assert [step.component.name for step in plan.steps] == ["source", "sink"]
    (edge,) = plan.edges
    assert edge.producer_structure != edge.consumer_structure


def test_broad_into_narrow_is_refused_with_a_counterexample(make_robot: Make) -> None:
    """Swapping the two sides, or comparing one with itself, turns this or the last test red."""
    with pytest.raises(NoPlanError) as caught:
        make_robot(robot("broad", "take_narrow")).resolve("wanted")
    (sink,) = caught.value.rejections
    (source,) = sink.because_of
    (reason,) = source.reasons
    assert reason.path == "value"
    assert isinstance(reason.example, int)
    assert not 0 <= reason.example <= 255
    assert "32767" in reason.producer
    assert "255" in reason.consumer


def test_a_renamed_field_is_refused_with_the_lines_that_mend_it(make_robot: Make) -> None:
    with pytest.raises(ResolutionError, match=r"map: \{amount: value\}"):
        make_robot(robot("narrow", "take_renamed")).resolve("wanted")


def test_the_suggested_lines_do_mend_it(make_robot: Make) -> None:
    manager = make_robot(robot("narrow", "take_renamed", ", map: {amount: value}"))
    with manager.request("wanted", validate="always") as connection:
        stage.script.put({"value": 7})
        assert connection.get(patience()) == {"amount": 7}


def test_the_adapter_is_applied_to_every_message(make_robot: Make) -> None:
    text = robot("narrow", "take_broad", ", map: {value: {from: value, scale: -2, offset: 1}}")
    with make_robot(text).request("wanted", validate="always") as connection:
        for value in (0, 255):
            stage.script.put({"value": value})
        assert [connection.get(patience()) for _ in range(2)] == [{"value": 1}, {"value": -509}]


def test_a_scale_that_leaves_the_range_is_refused(make_robot: Make) -> None:
    text = robot("narrow", "take_broad", ", map: {value: {from: value, scale: 1000}}")
    with pytest.raises(ResolutionError, match="value"):
        make_robot(text).resolve("wanted")


def test_a_check_that_is_wished_for_while_its_edge_opens_is_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one, two = MemoryBridge("one"), MemoryBridge("two")
    one.emitter("eye", {"type": "integer"})
    two.loop("finder", {"type": "integer"})
    bridges = {"one": one, "two": two}
    asked: list[Background[Connection]] = []
    open_edge = LiveEdge.open

    with RobotManager(loads(stage.FACE), bridges=bridges) as robot:

        def opening(edge: LiveEdge, clock: Clock) -> None:
            open_edge(edge, clock)
            asked.append(Background(partial(robot.request, "face", validate="always")))
            wait(lambda: len(robot._driver.state.connections) == 2)

        monkeypatch.setattr(LiveEdge, "open", opening)
        robot.request("face", validate="off")
        asked[0].result()
        (edge,) = robot._driver.live.feeding()
        assert edge.route is not None
        assert edge.route.check is not None
