"""What bridges see, and the configuration that is written for it."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from uoarm import RobotManager
from uoarm._control.discovery.discovery import Discovery
from uoarm.bridge import Discovered
from uoarm.config import loads, suggest
from uoarm.model import BridgeFindings, Robot, Schema
from uoarm.testing import MemoryBridge, patience, wait

SMALL = {"type": "integer", "minimum": 0, "maximum": 9}
NUMBER = {"type": "integer"}
TEXT = {"type": "string"}
ROBOT = """
version: 1
bridges: {lab: {plugin: memory}, gone: {plugin: nowhere}}
functions:
  camera:
    components: [{name: head, bridge: lab, output: {endpoint: [head]}}]
"""


def make_lab(**emitters: Schema) -> MemoryBridge:
    """Return a bridge with a camera, a detector, and these emitters."""
    bridge = MemoryBridge("lab", {})
    bridge.emitter("head", SMALL)
    bridge.loop("detector", NUMBER)
    for name, schema in emitters.items():
        bridge.emitter(name, schema)
    return bridge


def find(robot: Robot, lab: MemoryBridge) -> tuple[BridgeFindings, ...]:
    with RobotManager(robot, bridges={"lab": lab}) as manager:
        return manager.discover()


def test_what_a_bridge_sees_is_told_with_who_uses_it() -> None:
    seen, gone = find(loads(ROBOT), make_lab())
    detector, head = seen.components
    assert [port.used_by for port in head.ports] == [("head",)]
    assert all(port.used_by == () for port in detector.ports)
    assert str(seen).splitlines()[0] == "lab  2 components"
    assert "output  head  used by head" in str(seen)
    assert gone.components == ()
    assert "there is no plugin 'nowhere'" in gone.cause


def test_a_port_whose_structure_is_huge_is_left_out_and_counted() -> None:
    huge: Schema = {"enum": list(range(400_000))}
    seen, _ = find(loads(ROBOT), make_lab(hostile=huge))
    assert [one.name for one in seen.components] == ["detector", "head"]
    assert seen.left_out == 1
    assert "and 1 ports more, beyond the limit" in str(seen)


def test_an_input_is_fed_by_the_one_output_that_is_proven_to_fit() -> None:
    robot = loads(ROBOT)
    text = suggest(robot, find(robot, make_lab()))
    assert "# proven: camera.default fits it: every message is accepted" in text
    suggested = loads(text.replace("functions:\n", ROBOT[ROBOT.index("functions:") :].lstrip()))
    (component,) = suggested.functions["detector"].components
    assert str(component.inputs[0].source) == "camera.default"
    with RobotManager(suggested, bridges={"lab": make_lab()}) as manager:
        assert [one.component.name for one in manager.resolve("detector").steps] == [
            "head",
            "detector",
        ]


def test_of_several_that_fit_none_is_guessed() -> None:
    robot = loads(ROBOT)
    text = suggest(robot, find(robot, make_lab(spare=SMALL)))
    assert "# from: one of camera.default, spare" in text
    assert "{from:" not in text


def test_the_one_with_the_very_structure_comes_before_those_that_fit() -> None:
    robot = loads(ROBOT)
    text = suggest(robot, find(robot, make_lab(exact=NUMBER)))
    assert "{from: exact, " in text
    assert "# proven: exact has its structure" in text


def test_what_does_not_fit_feeds_nothing() -> None:
    robot = loads(ROBOT.replace("head", "speaker"))
    lab = make_lab(speaker=TEXT)
    with RobotManager(robot, bridges={"lab": lab}) as manager:
        text = suggest(robot, manager.discover())
    assert "proven: head fits it" in text
    assert "camera" not in text


def test_names_are_such_that_a_configuration_takes_them() -> None:
    names = {"/lab/head": SMALL, "camera": SMALL, "9 lives": SMALL, "\u00fcber": SMALL}
    robot = loads(ROBOT)
    suggested = loads(suggest(robot, find(robot, make_lab(**names))))
    assert set(suggested.functions) == {"detector", "lab_head", "camera_2", "c_9_lives", "ber"}


def test_where_time_is_up_it_is_said_what_was_not_compared() -> None:
    robot = loads(ROBOT)
    text = suggest(robot, find(robot, make_lab()), seconds=-1.0)
    assert "1 outputs were not compared, for want of time" in text
    assert "{from:" not in text


class Slow(MemoryBridge):
    """A bridge that answers when it is let."""

    def __init__(self) -> None:
        super().__init__("slow", {})
        self.emitter("hand", NUMBER)
        self.may_answer = threading.Event()
        self.asked = 0

    def _discover(self) -> tuple[Discovered, ...]:
        self.asked += 1
        self.may_answer.wait()
        return super()._discover()


@pytest.fixture
def slow() -> Iterator[Slow]:
    bridge = Slow()
    yield bridge
    bridge.may_answer.set()


def test_a_slow_bridge_delays_nobody_and_is_in_a_later_look(slow: Slow) -> None:
    robot = loads(
        "version: 1\nbridges: {slow: {plugin: memory}, lab: {plugin: memory}}\nfunctions: {}\n"
    )
    lab, limit = make_lab(), 10 * patience()
    with RobotManager(robot, bridges={"slow": slow, "lab": lab}) as manager:

        def seen() -> list[list[str]]:
            found = manager.discover(timeout=limit, grace=0.0)
            assert bool(found[0].components) != (found[0].cause == "has not answered yet")
            return [[one.name for one in each.components] for each in found]

        assert seen() == [[], ["detector", "head"]]
        lab.emitter("eye", NUMBER)
        wait(lambda: seen() == [[], ["detector", "eye", "head"]])
        assert slow.asked == 1
        slow.may_answer.set()
        wait(lambda: seen()[0] == ["hand"])
        assert [len(one.components) for one in manager.discover(timeout=limit)] == [1, 3]


def test_a_bridge_that_fails_is_told_as_it_answered_last_for_some_answers() -> None:
    lab = make_lab()
    robot = loads("version: 1\nbridges: {lab: {plugin: memory}}\nfunctions: {}\n")
    discovery = Discovery(lambda _: lab, kept=2)
    try:
        assert discovery.look(robot, patience())[0].components
        lab.cut()
        told = [bool(discovery.look(robot, patience())[0].cause) for _ in range(4)]
        lab.mend()
        told.append(bool(discovery.look(robot, patience())[0].cause))
    finally:
        discovery.close()
        lab.close()
    assert told == [False, False, True, True, False]
