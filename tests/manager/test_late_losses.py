"""What is lost as a component is let go, or a moment later, in a thread that was under way."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from uoarm import RobotManager
from uoarm._control.live.connection_runtime import LossAccount
from uoarm._dataplane import FailureWatch, Outlet, Route
from uoarm._parts import LiveComponent
from uoarm._safety import EmergencyStop
from uoarm.bridge import Bridge, Sink, Source
from uoarm.config import loads
from uoarm.errors import BridgeError
from uoarm.model import (
    ConnectionState,
    Deliver,
    Endpoint,
    FailureLimits,
    Gap,
    Health,
    MessageStructure,
    RouteStatus,
    Step,
)
from uoarm.testing import (
    Background,
    Hang,
    ManualClock,
    MemoryBridge,
    hanging,
    losses,
    patience,
    raising,
    wait,
)

ROBOT = """
version: 1
bridges: {one: {plugin: memory}}
functions:
  found:
    components:
      - name: finder
        bridge: one
        input: {endpoint: [finder]}
        output: {endpoint: [finder]}
"""
CAMERA = """
  camera:
    components:
      - {name: best, bridge: one, priority: 2, output: {endpoint: [best]}}
      - {name: spare, bridge: one, priority: 1, output: {endpoint: [spare]}}
"""


class Calls(MemoryBridge):
    """A framework that answers a message as its input is closed, and goes on calling back."""

    def __init__(self) -> None:
        super().__init__("one")
        self.deliver: Deliver = lambda _: None

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Source:
        self.deliver = deliver
        return Source(endpoint, lambda: None)

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        return Sink(endpoint, lambda _: None, lambda: self.deliver("answer"))


class Hasty(Calls):
    """A framework that is gone when a source of it, which lost three, has opened."""

    while_opening: Callable[[], None]

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Source:
        self.while_opening()
        self.close()
        return LostThree(endpoint, lambda: deliver("after the close"))


class LostThree(Source):
    def facts(self) -> dict[str, object]:
        return {"lost_on_link": 3}


class Ended(Route):
    """A route that has ended, and drops another message at each look."""

    def __init__(self) -> None:
        super().__init__("p.out", "c.in", print, clock=ManualClock())
        self.looks = 0

    def status(self) -> RouteStatus:
        self.looks += 1
        return RouteStatus("p.out", "c.in", self.looks, 0, (("closed", self.looks),))


def finder(bridge: Bridge) -> LiveComponent:
    memory = MemoryBridge("one", {})
    memory.loop("finder", {"type": "integer"})
    with RobotManager(loads(ROBOT), bridges={"one": memory}) as robot:
        (step,) = robot.resolve("found").steps
    return _live(step, bridge)


def _live(step: Step, bridge: Bridge) -> LiveComponent:
    clock = ManualClock()
    failures = FailureWatch("finder", FailureLimits(), clock, lambda *_: None)
    return LiveComponent(step, bridge, failures, EmergencyStop(clock), lambda _: None)


def test_what_comes_after_a_component_was_let_go_is_lost_with_it() -> None:
    bridge, account = Calls(), LossAccount()
    live = finder(bridge)
    live.open_output("default")
    gone = account.close([live])
    account.settle(gone, ())
    assert account.lost == 0
    bridge.deliver("late")
    assert account.lost == 1
    for _ in range(20):  # so many more ends that it is looked at no longer
        account.settle((), (Ended(),))
    assert account.lost == 1
    bridge.close()


def test_what_a_source_had_lost_when_its_bridge_was_closed_as_it_opened_is_counted() -> None:
    bridge, account = Hasty(), LossAccount()
    live = finder(bridge)
    # Who replaces what died does not wait until it has opened.
    bridge.while_opening = lambda: account.settle(account.close([live]), ())
    with pytest.raises(BridgeError, match="was closed"):
        live.open_output("default")
    assert account.lost == 3 + 1


def test_an_input_is_closed_first_so_that_what_comes_of_its_messages_is_counted() -> None:
    bridge, account, got = Calls(), LossAccount(), list[object]()
    live = finder(bridge)
    route = Route("finder.default", "c1", got.append, clock=ManualClock())
    live.outlets["default"].attach(route)
    live.open_output("default")
    live.open_input(live.component.input("default"), lambda: False)
    account.settle(account.close([live]), ())
    assert (got, account.lost) == (["answer"], 0)
    bridge.close()


def test_a_route_that_ended_is_looked_at_until_eight_others_have_ended() -> None:
    account, first = LossAccount(), Ended()
    account.settle((), (first,))
    for _ in range(7):
        account.settle((), (Ended(),))
    first.looks = 100
    (ended,) = account.ended
    assert dict(ended.dropped)["closed"] == 101 + 7
    account.settle((), (Ended(),))
    first.looks = 1000
    (ended,) = account.ended
    assert dict(ended.dropped)["closed"] == 102 + 6 * 2 + 2 + 1


def test_what_a_component_emits_while_no_consumer_takes_it_is_in_the_status() -> None:
    memory = MemoryBridge("one", {})
    memory.loop("finder", {"type": "integer"})
    with RobotManager(loads(ROBOT), bridges={"one": memory}) as robot:
        robot.request("found")
        (outlet,) = _outlets(robot)
        for route in outlet.routes:
            outlet.detach(route)
        assert losses(robot.status()).total() == 0
        outlet.deliver(1)
        assert losses(robot.status()) == {"undelivered": 1}


CHAIN = """
version: 1
failover: {wait: 600}
bridges: {eye: {plugin: memory}, one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components: [{name: camera, bridge: eye, output: {endpoint: [camera]}}]
  found:
    components:
      - {name: near, bridge: one, priority: 2, output: {endpoint: [near]},
         inputs: {view: {from: camera, endpoint: [near]}, hint: {endpoint: [hint]}}}
      - {name: far, bridge: two, priority: 1, output: {endpoint: [far]},
         inputs: {view: {from: camera, endpoint: [far]}, hint: {endpoint: [hint]}}}
"""


class LateInput(MemoryBridge):
    """A framework in which one input takes its time to open."""

    def __init__(self, name: str, hang: Hang) -> None:
        super().__init__(name, {})
        self._hang = hang

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        if endpoint.port == "hint":
            self._hang.wait()
        return super()._open_sink(endpoint, structure)


def test_what_was_lost_in_a_plan_that_was_given_up_while_a_part_of_it_opened_is_counted() -> None:
    hang = Hang()
    eye, one, two = MemoryBridge("eye"), MemoryBridge("one"), LateInput("two", hang)
    camera = eye.emitter("camera", {"type": "integer"})
    one.loop("near", {"type": "integer"})
    far = two.loop("far", {"type": "integer"})
    for bridge in (one, two):
        bridge.taker("hint", {"type": "integer"})
    with RobotManager(loads(CHAIN), bridges={"eye": eye, "one": one, "two": two}) as robot:
        connection = robot.request("found")
        one.die("near")
        assert hang.entered.wait(patience())
        sink = next(channel for channel in far.channels() if isinstance(channel, Sink))
        with raising(sink, "_send", BridgeError("it is full")):
            for number in range(20):
                camera.emit(number)
            two.die("far")
            wait(lambda: connection.state is ConnectionState.WAITING)
            hang.release()
            wait(lambda: sink.closed)
            wait(lambda: losses(robot.status()).total() == 20)


class OneAtATime(MemoryBridge):
    """A framework that notes, for each output that it opens, how many are open already."""

    def __init__(self) -> None:
        super().__init__("one")
        self.opened: list[Source] = []
        self.beside: list[int] = []

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Source:
        self.beside.append(sum(source.is_in_use for source in self.opened))
        self.opened.append(super()._open_source(endpoint, structure, deliver))
        return self.opened[-1]


def test_a_component_that_is_wanted_again_while_it_closes_is_opened_after_that(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bridge = OneAtATime()
    bridge.loop("finder", {"type": "integer"})
    with RobotManager(loads(ROBOT), bridges={"one": bridge}) as robot:
        connection = robot.request("found")
        with hanging(bridge.opened[0], "_close") as hang:

            def wait_over(live: LiveComponent, timeout: float) -> None:
                hang.release()
                original(live, timeout)

            original = LiveComponent.wait_over
            monkeypatch.setattr(LiveComponent, "wait_over", wait_over)
            killing = Background(connection.kill)
            assert hang.entered.wait(patience())
            robot.request("found", timeout=patience())
            killing.result()
        assert bridge.beside == [0, 0]


def test_a_failover_to_another_component_does_not_wait_for_one_that_hangs_as_it_closes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    waited: list[str] = []

    def wait_over(live: LiveComponent, timeout: float) -> None:
        waited.append(live.component.name)
        original(live, timeout)

    original = LiveComponent.wait_over
    monkeypatch.setattr(LiveComponent, "wait_over", wait_over)
    bridge = OneAtATime()
    for name in ("finder", "best", "spare"):
        bridge.loop(name, {"type": "integer"})
    with RobotManager(loads(ROBOT + CAMERA), bridges={"one": bridge}) as robot:
        connection, camera = robot.request("found"), robot.request("camera")
        with hanging(bridge.opened[0], "_close") as hang:
            killing = Background(connection.kill)
            assert hang.entered.wait(patience())
            bridge.report(Health.LOST, "it is unplugged", component="best")
            wait(lambda: camera.gaps)
            assert camera.plan.names == ("spare",)
            assert waited == []
        killing.result()


def _outlets(robot: RobotManager) -> list[Outlet]:
    lives = robot._driver.live.components.values()
    return [outlet for live in lives for outlet in live.outlets.values()]


def test_gaps_find_only_so_much_room_and_the_last_is_there_in_any_case() -> None:
    account = LossAccount()
    for number in range(1000):
        account.add(Gap(float(number), 0, 0.0, 0, ("a",), ("b",), "x" * 1000))
    assert 10 < len(account.gaps) < 100
    assert account.gaps[-1].time == 999.0
    assert [gap.time for gap in account.gaps] == sorted(gap.time for gap in account.gaps)
    account.add(Gap(1000.0, 0, 0.0, 0, ("a",), ("b",), "x" * 2**20))
    assert [gap.time for gap in account.gaps] == [1000.0]
