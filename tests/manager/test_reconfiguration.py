"""Another configuration while the manager runs: who moves, who notices nothing, who is refused."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from attrs import evolve
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from tests.control.world import FACE
from tests.manager import stage

from uoarm import RobotManager
from uoarm._control.live import revisions
from uoarm._parts import ApplicationPorts
from uoarm.bridge import BridgeType, Delivery, Registry, Source
from uoarm.config import loads
from uoarm.errors import ConfigurationError, ConnectionClosedError, UsageError
from uoarm.model import (
    Deliver,
    Effect,
    Endpoint,
    Health,
    MessageStructure,
    Options,
    StatusEvent,
    StopOutcome,
)
from uoarm.testing import Background, Emitter, MemoryBridge, patience, wait

NUMBER = {"type": "integer"}
LAMP = """
  lamp:
    components:
      - {name: light, bridge: two, output: {endpoint: [light]}}
"""
ROBOT = FACE + LAMP
OTHER_CAMERA = ROBOT.replace("endpoint: [best]", "endpoint: [better]")
NO_LAMP = FACE


class Lab:
    """Two bridges with everything that the configurations name."""

    def __init__(self, *names: str) -> None:
        self.bridges: dict[str, MemoryBridge] = {}
        self.emitters: dict[str, Emitter] = {}
        for name in names:
            self.make(name)

    def make(self, name: str) -> MemoryBridge:
        """Return a new bridge of this name, which takes the place of the one before."""
        bridge = self.bridges[name] = MemoryBridge(name, {})
        for component in ("best", "better", "spare", "light"):
            self.emitters[f"{name}.{component}"] = bridge.emitter(component, NUMBER)
        bridge.loop("finder", NUMBER)
        return bridge

    def emit(self, emitter: str, number: int) -> None:
        """Let `BRIDGE.COMPONENT` emit."""
        self.emitters[emitter].emit(number)


@pytest.fixture
def lab() -> Lab:
    return Lab("one", "two")


@pytest.fixture
def robot(lab: Lab) -> Iterator[RobotManager]:
    with RobotManager(loads(ROBOT), bridges=lab.bridges) as manager:
        yield manager


def test_a_connection_goes_on_with_what_the_configuration_says_now(
    robot: RobotManager, lab: Lab
) -> None:
    face, lamp = robot.request("face"), robot.request("lamp")
    lab.emit("one.best", 1)
    assert face.get(timeout=patience()) == 1

    change = robot.apply(loads(OTHER_CAMERA))

    assert change.is_applied
    assert change.revision == robot.revision == 1
    assert change.differences == ("~ component best",)
    assert [(connection.connection, connection.effect) for connection in change.connections] == [
        (face.id, Effect.MOVES)
    ]
    lab.emit("one.better", 2)
    assert face.get(timeout=patience()) == 2
    assert [gap.cause for gap in face.gaps] == ["the configuration was changed"]
    assert lamp.gaps == ()
    wait(lambda: lab.bridges["one"].open_channels == 1)  # the one before was closed


def test_what_is_not_concerned_loses_nothing(robot: RobotManager, lab: Lab) -> None:
    received: list[object] = []
    robot.request("lamp", on_message=received.append)
    over = threading.Event()

    def emit() -> None:
        for number in range(2_000):
            lab.emit("two.light", number)
        over.set()

    sender = threading.Thread(target=emit)
    sender.start()
    while not over.is_set():
        robot.apply(loads(OTHER_CAMERA))
        robot.apply(loads(ROBOT))
    sender.join()
    wait(lambda: len(received) == 2_000)
    assert received == list(range(2_000))


def test_a_dry_run_says_what_would_happen_and_does_nothing(robot: RobotManager) -> None:
    face, lamp = robot.request("face"), robot.request("lamp")
    change = robot.apply(loads(NO_LAMP.replace("[best]", "[better]")), dry_run=True)
    assert not change.is_applied
    assert {connection.connection: connection.effect for connection in change.connections} == {
        face.id: Effect.MOVES,
        lamp.id: Effect.ENDS,
    }
    assert "- component light" in change.differences
    assert "- function lamp" in change.differences
    assert robot.revision == 0
    assert lamp.state.value == face.state.value == "running"


def test_a_change_that_would_end_a_connection_is_refused_unless_forced(
    robot: RobotManager, caplog: pytest.LogCaptureFixture
) -> None:
    lamp = robot.request("lamp")
    with pytest.raises(ConfigurationError, match=rf"(?s)force it.*{lamp.id} \(lamp\) ends"):
        robot.apply(loads(NO_LAMP))
    assert robot.revision == 0
    assert lamp.state.value == "running"

    with caplog.at_level("WARNING", "uoarm"):
        robot.apply(loads(NO_LAMP), force=True)
        wait(lambda: lamp.ended)
        wait(lambda: "failed" in caplog.text)
    assert "the configuration no longer has 'light'" in lamp.cause
    assert [lamp.id in record.message for record in caplog.records] == [True], "said once"
    assert "stays" not in caplog.text


def test_a_change_made_for_another_revision_is_refused(robot: RobotManager) -> None:
    robot.apply(loads(OTHER_CAMERA), revision=0)
    with pytest.raises(UsageError, match="made for revision 0, and revision 1 is in force"):
        robot.apply(loads(ROBOT), revision=0)


def test_what_was_in_force_before_can_be_applied_again(robot: RobotManager) -> None:
    robot.apply(loads(OTHER_CAMERA))
    before = robot.history()[0].robot
    assert before is not None
    robot.apply(before)
    assert [change.revision for change in robot.history()] == [0, 1, 2]
    assert robot.config.functions["camera"] == before.functions["camera"]


def test_of_large_configurations_fewer_revisions_are_kept(
    robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(revisions, "_KEPT_OCTETS", 3 * revisions.octets_of(robot.config))
    for _ in range(3):
        robot.apply(loads(OTHER_CAMERA))
        robot.apply(loads(ROBOT))
    kept = [change.revision for change in robot.history()]
    assert kept in ([4, 5, 6], [5, 6])
    with pytest.raises(UsageError, match=f"revision 1 is not kept: {kept[0]} to 6 are"):
        robot.rollback(1)
    monkeypatch.setattr(revisions, "_KEPT_OCTETS", 0)
    robot.apply(loads(OTHER_CAMERA))
    assert [change.revision for change in robot.history()] == [6, 7], "one to go back to, always"
    robot.rollback(6)


def test_another_order_of_candidates_moves_what_runs(robot: RobotManager, lab: Lab) -> None:
    camera, face = robot.request("camera"), robot.request("face")
    robot.apply(loads(ROBOT.replace("priority: 2", "priority: 0")))
    lab.emit("two.spare", 7)
    assert camera.get(timeout=patience()) == face.get(timeout=patience()) == 7
    assert "best" not in camera.plan.provider.component.name


def test_what_is_emitted_after_a_change_goes_the_new_way(
    robot: RobotManager, lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, real = threading.Event(), ApplicationPorts.letting_through

    @contextmanager
    def late(ports: ApplicationPorts) -> Iterator[None]:
        assert go_on.wait(patience())
        with real(ports):
            yield

    monkeypatch.setattr(ApplicationPorts, "letting_through", late)
    camera = robot.request("camera")
    applying = Background(lambda: robot.apply(loads(ROBOT.replace("priority: 2", "priority: 0"))))
    wait(lambda: camera.plan.provider.component.name == "spare")
    with pytest.raises(AssertionError, match="still running"):
        applying.result(0.2)
    go_on.set()
    applying.result()
    lab.emit("two.spare", 7)
    assert camera.get(timeout=patience()) == 7


def test_a_change_to_the_same_configuration_changes_nothing(robot: RobotManager) -> None:
    face = robot.request("face")
    change = robot.apply(loads(ROBOT))
    assert change.differences == ()
    assert change.connections == ()
    assert face.gaps == ()
    assert (change.revision, change.is_applied) == (robot.revision, True) == (0, True)
    assert len(robot.history()) == 1
    assert robot.apply(loads(f"{ROBOT}# a remark\n")).revision == 1
    assert robot.config.text.endswith("# a remark\n")


@pytest.fixture
def made() -> list[MemoryBridge]:
    return []


@pytest.fixture
def registry(lab: Lab, made: list[MemoryBridge]) -> Registry:
    """Return a registry that makes bridges of the lab."""

    def create(name: str, options: Options) -> MemoryBridge:
        del options
        made.append(lab.make(name))
        return made[-1]

    found = Registry(())
    schema = {"properties": {"level": {"type": "integer"}}}
    found.add(BridgeType("memory", "", create, bridge_options=schema, contract=2))
    return found


def test_a_bridge_with_other_options_is_another_one(
    lab: Lab, registry: Registry, made: list[MemoryBridge]
) -> None:
    other = ROBOT.replace("two: {plugin: memory}", "two: {plugin: memory, options: {level: 2}}")
    with RobotManager(loads(ROBOT), registry=registry) as robot:
        face, camera = robot.request("face"), robot.request("camera")
        robot.apply(loads(other))
        before, after = (memory_bridge for memory_bridge in made if memory_bridge.name == "two")
        lab.emit("one.best", 3)
        assert face.get(timeout=patience()) == camera.get(timeout=patience()) == 3
        assert after.open_channels > 0
        wait(lambda: before.closed)
        assert camera.gaps == ()
    assert after.closed


def test_a_bridge_that_was_not_well_is_so_no_more_where_the_configuration_has_another(
    registry: Registry, made: list[MemoryBridge]
) -> None:
    other = ROBOT.replace("two: {plugin: memory}", "two: {plugin: memory, options: {level: 2}}")
    with RobotManager(loads(ROBOT), registry=registry) as robot:
        changes: list[StatusEvent] = []
        robot.listen(changes.append)
        robot.request("lamp")
        (before,) = (bridge for bridge in made if bridge.name == "two")
        before.report(Health.DEGRADED, "the cable is loose")
        robot.apply(loads(other))

        def of_bridge() -> list[str]:
            return [event.change for event in changes if event.subject == "bridge two"]

        wait(lambda: len(of_bridge()) > 1, lambda: str(changes))
        assert of_bridge() == ["degraded", "ok"]
        assert {bridge.health for bridge in robot.status().bridges} == {Health.OK}


class Robots(MemoryBridge):
    """A bridge to another robot, which a stop reaches, too; it opens nothing until it may."""

    def __init__(self, name: str, options: Options) -> None:
        super().__init__(name, options)
        self.capabilities = evolve(self.capabilities, stop=True)
        self.emitter("light", NUMBER)
        self.is_opening, self.may_open = threading.Event(), threading.Event()
        self.stops = 0

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver | Delivery
    ) -> Source:
        self.is_opening.set()
        assert self.may_open.wait(patience())
        return super()._open_source(endpoint, structure, deliver)

    def _stop_all(self, release: bool, timeout: float) -> tuple[StopOutcome, ...]:
        del release, timeout
        self.stops += 1
        return ()


def test_a_stop_reaches_what_is_behind_a_bridge_until_its_connections_have_moved() -> None:
    made: list[Robots] = []

    def create(name: str, options: Options) -> Robots:
        made.append(Robots(name, options))
        return made[-1]

    registry = Registry(())
    schema = {"properties": {"level": {"type": "integer"}}}
    registry.add(BridgeType("memory", "", create, bridge_options=schema, contract=2))
    text = "version: 1\nbridges: {{two: {{plugin: memory, options: {{level: {0}}}}}}}\nfunctions:"
    with RobotManager(loads(text.format(1) + LAMP), registry=registry) as robot:
        requested = Background(lambda: robot.request("lamp"))
        wait(lambda: bool(made))
        made[0].may_open.set()
        requested.result()
        applied = Background(lambda: robot.apply(loads(text.format(2) + LAMP)))
        wait(lambda: len(made) > 1 and made[1].is_opening.is_set())
        robot.stop_all()
        assert [bridge.stops for bridge in made] == [1, 1]
        made[1].may_open.set()
        applied.result()


def test_a_change_that_is_refused_leaves_no_bridge_behind(
    lab: Lab, registry: Registry, made: list[MemoryBridge]
) -> None:
    other = NO_LAMP.replace("two: {plugin: memory}", "two: {plugin: memory, options: {level: 2}}")
    with RobotManager(loads(ROBOT), registry=registry) as robot:
        robot.request("lamp")
        robot.request("face")
        with pytest.raises(ConfigurationError):
            robot.apply(loads(other))
        before, after = (memory_bridge for memory_bridge in made if memory_bridge.name == "two")
        assert after.closed
        assert not before.closed


def test_a_change_that_comes_as_the_manager_closes_leaves_no_bridge_behind(
    registry: Registry, made: list[MemoryBridge], monkeypatch: pytest.MonkeyPatch
) -> None:
    other = ROBOT.replace("two: {plugin: memory}", "two: {plugin: memory, options: {level: 2}}")
    robot = RobotManager(loads(ROBOT), registry=registry)
    robot.request("lamp")
    monkeypatch.setattr(robot, "_require_none_ends", lambda _: robot.close())
    with pytest.raises(ConnectionClosedError, match="the robot manager is closed"):
        robot.apply(loads(other))
    assert len(made) > 1
    assert all(bridge.closed for bridge in made)


def test_a_new_function_and_a_new_bridge_can_be_requested(
    lab: Lab, registry: Registry, made: list[MemoryBridge]
) -> None:
    more = ROBOT.replace("bridges: {", "bridges: {three: {plugin: memory}, ")
    torch = "{name: torch, bridge: three, output: {endpoint: [light]}}"
    more += f"  torch:\n    components:\n      - {torch}\n"
    with RobotManager(loads(ROBOT), registry=registry) as robot:
        face = robot.request("face")
        robot.apply(loads(more))
        connection = robot.request("torch")
        lab.emit("three.light", 5)
        assert connection.get(timeout=patience()) == 5
        assert face.gaps == ()


EXCLUSIVE = """
version: 1
bridges: {py: {plugin: python}}
functions:
  numbers:
    components: [{name: numbers, bridge: py, output: {endpoint: ["tests.manager.stage:narrow"]}}]
  device:
    components:
      - {name: device, bridge: py, parameters: {offset: 1},
         input: {from: numbers, endpoint: ["tests.manager.stage:Exclusive"]},
         output: {endpoint: ["tests.manager.stage:Exclusive"]}}
"""


def test_what_can_be_open_only_once_is_closed_before_it_is_opened_anew(
    make_robot: Callable[[str], RobotManager],
) -> None:
    robot = make_robot(EXCLUSIVE)
    device = robot.request("device")
    stage.script.put({"value": 1})
    assert device.get(timeout=patience()) == {"value": 2}
    robot.apply(loads(EXCLUSIVE.replace("offset: 1", "offset: 5"), origin=robot.config.origin))
    wait(lambda: device.gaps)
    stage.script.put({"value": 1})
    assert device.get(timeout=patience()) == {"value": 6}


ARM = """
version: 1
bridges: {python: {}}
functions:
  arm:
    components:
      - {name: arm, bridge: python, input: {endpoint: ["tests.manager.stage:SlowlyExclusive"]}}
"""


def test_what_is_sent_while_the_device_is_opened_anew_is_counted_as_failed(
    make_robot: Callable[[str], RobotManager],
) -> None:
    robot = make_robot(ARM)
    arm = robot.request("arm")
    text = ARM.replace("bridge: python,", "bridge: python, parameters: {offset: 1},")
    anew = loads(text, origin=robot.config.origin)
    change = Background(lambda: robot.apply(anew))
    assert stage.building.wait(patience())
    arm.send({"value": 1})
    assert not arm.flush(patience())
    stage.gate.set()
    assert change.result().is_applied
    wait(lambda: any(gap.counted for gap in arm.gaps))
    assert arm.gaps[0].dropped == (("failed", 1),)
    assert arm.gaps[0].cause == "the configuration changed 'arm'"
    arm.send({"value": 2})
    assert arm.flush(patience())


STEPS = {
    "better": OTHER_CAMERA,
    "as it was": ROBOT,
    "spare first": ROBOT.replace("priority: 2", "priority: 0"),
    "finder of the other": ROBOT.replace(
        "{name: finder, bridge: two", "{name: finder, bridge: one"
    ),
}


def running(robot: RobotManager, lab: Lab) -> object:
    """Return what is open, as connections and bridges have it."""
    plans = sorted(str(connection.plan) for connection in robot.connections())
    components = sorted(
        (component.name, len(component.users)) for component in robot.status().components
    )
    return plans, components, {name: bridge.open_channels for name, bridge in lab.bridges.items()}


@settings(max_examples=10, phases=[Phase.generate])  # an example that fails takes long
@given(st.lists(st.sampled_from([*STEPS, "face", "camera", "kill"]), min_size=4, max_size=8))
def test_any_sequence_of_changes_ends_in_what_a_fresh_start_would_open(steps: list[str]) -> None:
    lab, received = Lab("one", "two"), list[object]()
    last = ROBOT
    with RobotManager(loads(ROBOT), bridges=lab.bridges) as robot:
        robot.request("lamp", on_message=received.append)
        others = [robot.request("face"), robot.request("camera")]
        for number, step in enumerate(steps):
            lab.emit("two.light", number)
            if step in STEPS:
                last = STEPS[step]
                robot.apply(loads(last))
            elif step != "kill":
                others.append(robot.request(step))
            elif len(others) > 1:
                others.pop(0).kill()
            lab.emit("two.light", -1 - number)
        fresh_lab = Lab("one", "two")
        with RobotManager(loads(last), bridges=fresh_lab.bridges) as fresh:
            for connection in robot.connections():
                fresh.request(connection.plan.function)
            expected = running(fresh, fresh_lab)
            wait(lambda: running(robot, lab) == expected)
        sent = [index for number in range(len(steps)) for index in (number, -1 - number)]
        wait(lambda: len(received) == len(sent))
        assert received == sent
