"""What bridges see, and the configuration that is written for it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from attrs import evolve

from uoarm import RobotManager
from uoarm._resolve import _discovery as discovery
from uoarm.bridge import Description, Discovered
from uoarm.config import loads, suggest
from uoarm.model import BridgeFindings, Endpoint, FoundComponent, Robot, Role, Schema
from uoarm.testing import ManualClock, MemoryBridge, patience, wait

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


def test_what_a_bridge_sees_is_reported_with_who_uses_it() -> None:
    seen, gone = find(loads(ROBOT), make_lab())
    detector, head = seen.components
    assert [port.used_by for port in head.ports] == [("head",)]
    assert all(port.used_by == () for port in detector.ports)
    assert str(seen).splitlines()[0] == "lab  2 components"
    assert "output  head  used by head" in str(seen)
    assert gone.components == ()
    assert "there is no plugin 'nowhere'" in gone.cause
    assert (gone.error_code, seen.error_code) == ("UOA-301", "")


class Stating(MemoryBridge):
    """A framework that states how often its components run."""

    def _discover(self) -> tuple[Discovered, ...]:
        rates = {"default": 100.0}
        return tuple(evolve(discovered, rates=rates) for discovered in super()._discover())


def test_what_is_open_has_the_rate_that_is_measured_and_the_rest_what_is_stated() -> None:
    lab = Stating("lab", {})
    head = lab.emitter("head", SMALL)
    lab.loop("detector", NUMBER)
    clock = ManualClock()
    with RobotManager(loads(ROBOT), bridges={"lab": lab}, clock=clock) as manager:
        seen, _ = manager.discover()
        assert "output  head  100 a second, as stated  used by head" in str(seen)
        manager.request("camera")
        for number in range(4):
            clock.advance(0.05)
            head.emit(number)
        again, _ = manager.discover()
    assert "output  head  20 a second  used by head" in str(again)
    assert "output  detector  100 a second, as stated" in str(again)
    assert again == seen  # what only flows otherwise is nothing new


def test_a_port_whose_structure_is_huge_is_left_out_and_counted() -> None:
    huge: Schema = {"enum": list(range(400_000))}
    seen, _ = find(loads(ROBOT), make_lab(hostile=huge))
    assert [component.name for component in seen.components] == ["detector", "head"]
    assert seen.left_out == 1
    assert "and 1 ports more, beyond the limit" in str(seen)


def test_a_part_of_a_configuration_says_how_it_is_added() -> None:
    robot, seen = loads(ROBOT), find(loads(ROBOT), make_lab())
    assert "uoarm suggest --merge FILE" in suggest(robot, seen, configured=robot.bridges)
    assert "--merge" not in suggest(robot, seen), "it has bridges of its own"


def test_a_long_detail_of_several_components_is_said_once() -> None:
    why, short = "there is no such package here: " + "install it, " * 5, "inactive"
    details = {"a": why, "b": short, "c": why, "d": short}
    components = tuple(FoundComponent(name, (), detail) for name, detail in details.items())
    assert str(BridgeFindings("lab", "memory", components)).splitlines()[1:] == [
        f"  a  ({why})",
        "  b  (inactive)",
        "  c  (the same as a)",
        "  d  (inactive)",
    ]


class Crowded(MemoryBridge):
    """A bridge of a framework in which a node advertises without end."""

    def _discover(self) -> tuple[Discovered, ...]:
        hand = Endpoint("lab", "flood", Role.OUTPUT, ("hand",))
        ports = tuple(
            (evolve(hand, address=(f"t{number}",), port=f"t{number}"), Description())
            for number in range(10_500)
        )
        return (*super()._discover(), Discovered("flood", ports))


def test_of_ten_thousand_topics_and_more_those_beyond_the_limit_are_counted() -> None:
    lab = Crowded("lab", {})
    lab.emitter("arm", NUMBER)
    robot = loads("version: 1\nbridges: {lab: {plugin: memory}}\nfunctions: {}\n")
    (seen,) = find(robot, lab)
    assert [component.name for component in seen.components] == ["arm", "flood"]
    assert sum(len(component.ports) for component in seen.components) == 10_000
    assert seen.left_out == 501


def test_an_input_is_fed_by_the_one_output_that_is_proven_to_fit() -> None:
    robot = loads(ROBOT)
    text = suggest(robot, find(robot, make_lab()))
    assert "# proven: camera.default fits it: every message is accepted" in text
    suggested = loads(text.replace("functions:\n", ROBOT[ROBOT.index("functions:") :].lstrip()))
    (component,) = suggested.functions["detector"].components
    assert str(component.inputs[0].source) == "camera.default"
    with RobotManager(suggested, bridges={"lab": make_lab()}) as manager:
        assert [step.component.name for step in manager.resolve("detector").steps] == [
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


def test_a_slow_bridge_delays_no_other_and_is_in_a_later_look(slow: Slow) -> None:
    robot = loads(
        "version: 1\nbridges: {slow: {plugin: memory}, lab: {plugin: memory}}\nfunctions: {}\n"
    )
    lab, limit = make_lab(), 10 * patience()
    with RobotManager(robot, bridges={"slow": slow, "lab": lab}) as manager:

        def seen() -> list[list[str]]:
            found = manager.discover(timeout=limit, grace=0.0)
            assert bool(found[0].components) != (found[0].cause == "has not answered yet")
            return [[component.name for component in findings.components] for findings in found]

        assert seen() == [[], ["detector", "head"]]
        lab.emitter("eye", NUMBER)
        wait(lambda: seen() == [[], ["detector", "eye", "head"]])
        wait(lambda: slow.asked)  # in a thread of its own, which may come to run only now
        assert slow.asked == 1
        slow.may_answer.set()
        wait(lambda: seen()[0] == ["hand"])
        assert [len(component.components) for component in manager.discover(timeout=limit)] == [
            1,
            3,
        ]


def test_a_bridge_that_starts_slowly_is_started_once_and_holds_up_who_waits_for_so_long() -> None:
    lab, may_start, starts = make_lab(), threading.Event(), list[str]()
    robot = loads("version: 1\nbridges: {lab: {plugin: memory}}\nfunctions: {}\n")

    def start(name: str) -> MemoryBridge:
        if not may_start.is_set():
            starts.append(name)
            may_start.wait()
        return lab

    looks = discovery.Discovery(start)
    try:
        for _ in range(3):
            assert looks.look(robot, 0.01, 0.0)[0].cause == "has not answered yet"
        assert looks.is_whole
        wait(lambda: bool(starts))
        may_start.set()
        wait(lambda: bool(looks.look(robot, patience(), 0.0)[0].components))
        assert starts == ["lab"]
    finally:
        may_start.set()
        looks.close()
        lab.close()


def test_a_bridge_that_fails_is_reported_as_it_answered_last_for_some_answers() -> None:
    lab = make_lab()
    robot = loads("version: 1\nbridges: {lab: {plugin: memory}}\nfunctions: {}\n")
    looks = discovery.Discovery(lambda _: lab, kept=2)
    try:
        assert looks.look(robot, patience())[0].components
        lab.cut()
        reports = [bool(looks.look(robot, patience())[0].cause) for _ in range(4)]
        lab.mend()
        reports.append(bool(looks.look(robot, patience())[0].cause))
    finally:
        looks.close()
        lab.close()
    assert reports == [False, False, True, True, False]


def test_a_bridge_that_started_late_has_its_time_to_answer_from_then_on(
    slow: Slow, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who asks for candidates waits for it: a host of a busy machine starts for some seconds."""
    robot = loads(
        "version: 1\nbridges: {slow: {plugin: memory}, lab: {plugin: memory}}\nfunctions: {}\n"
    )
    lab, may_start, limit, now = make_lab(), threading.Event(), 10 * patience(), [0.0]
    monkeypatch.setattr(discovery, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def start(name: str) -> MemoryBridge:
        if name == "lab":
            return lab
        may_start.wait()
        return slow

    looking = discovery.Discovery(start)

    def is_whole() -> bool:
        looking.look(robot, limit, 0.0)
        return looking.is_whole

    try:
        wait(lambda: bool(looking.look(robot, limit, 0.0)[1].components))
        assert not is_whole()
        now[0] = limit + 1.0
        assert is_whole()
        may_start.set()
        wait(lambda: slow.asked)
        assert not is_whole()
        slow.may_answer.set()
        wait(is_whole)
    finally:
        may_start.set()
        slow.may_answer.set()
        looking.close()
        lab.close()


@pytest.mark.parametrize(
    ("addresses", "is_used"),
    [
        ([("/head", "Image")], [True]),
        ([("head", "Image")], [False]),
        ([("/head", "Image"), ("/head", "parameter")], [False, False]),
        ([("/head", "Image"), ("/head",)], [False, True]),
        ([("/head", "Image", "more")], [False]),
    ],
)
def test_an_address_that_leaves_out_the_type_is_that_of_what_is_listed(
    addresses: list[tuple[str, ...]], is_used: list[bool]
) -> None:
    robot = loads(ROBOT.replace("[head]", "[/head]"))
    ends = [Endpoint("lab", "node", Role.OUTPUT, address) for address in addresses]
    node = Discovered("node", tuple((end, Description()) for end in ends))
    found = discovery._findings("lab", "memory", (node,), discovery._users(robot))
    (measured,) = discovery.with_rates((found,), {"head.default": 30.0}, robot)
    ports = measured.components[0].ports
    assert [port.used_by == ("head",) for port in ports] == is_used
    assert [port.rate == 30.0 for port in ports] == is_used
