"""What bridges see, and the configuration that is written for it."""

from __future__ import annotations

from uoarm import RobotManager
from uoarm.config import loads, suggest
from uoarm.model import BridgeFindings, Robot, Schema
from uoarm.testing import MemoryBridge

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
