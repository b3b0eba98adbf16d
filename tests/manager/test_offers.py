"""Functions of one framework, offered in another: who lives there knows nothing of uoarm."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from tests.structures import closed

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import ConfigurationError, MessageError, ResolutionError
from uoarm.model import Endpoint, Health, OfferState, OfferStatus, Role
from uoarm.testing import MemoryBridge, patience, wait

NUMBER = {"type": "integer", "minimum": 0, "maximum": 1000}
TEXT = {"type": "string"}
SCAN = {"type": "object", "properties": {"range": NUMBER}, "required": ["range"]}
READING = closed(distance={"type": "number"})

ROBOT = """
version: 1
bridges: {{one: {{plugin: memory}}, net: {{plugin: memory}}}}
functions:
  camera:
    components:
      - {{name: best, bridge: one, priority: 2, output: {{endpoint: [best]}}}}
      - {{name: next, bridge: one, priority: 1, output: {{endpoint: [next]}}}}
  arm:
    components: [{{name: mover, bridge: one, input: {{endpoint: [mover]}}}}]
  scan:
    components: [{{name: laser, bridge: one, output: {{endpoint: [laser]}}}}]
  carry:
    components:
      - {{name: cart, bridge: one, priority: 2,
          inputs: {{goal: {{endpoint: [cart]}}}}, outputs: {{status: {{endpoint: [rolled]}}}}}}
      - {{name: lift, bridge: one, priority: 1,
          inputs: {{goal: {{endpoint: [lift], stop: {{message: 0}}}}}},
          outputs: {{status: {{endpoint: [raised]}}}}}}
  double:
    components: [{{name: doubler, bridge: one, service: {{endpoint: [doubler]}}}}]
{}
"""


class Stage:
    """A robot whose functions are in `one`, and a framework `net` that wants some of them."""

    def __init__(self, offers: str) -> None:
        self.one, self.net = MemoryBridge("one"), MemoryBridge("net")
        self.best = self.one.emitter("best", NUMBER)
        self.next = self.one.emitter("next", NUMBER)
        self.laser = self.one.emitter("laser", SCAN)
        self.mover = self.one.taker("mover", NUMBER)
        self.cart, self.lift = self.one.taker("cart", NUMBER), self.one.taker("lift", NUMBER)
        self.rolled = self.one.emitter("rolled", STATUS)
        self.raised = self.one.emitter("raised", STATUS)
        self.wanted = self.net.emitter("wanted", NUMBER)
        self.reports = self.net.taker("reported", STATUS)
        self.one.service("doubler", NUMBER, {"type": "integer"}, lambda asked: 2 * asked)
        self.seen = self.net.taker("seen", NUMBER)
        self.wish = self.net.emitter("wish", {**NUMBER, "maximum": 10})
        bridges = {"one": self.one, "net": self.net}
        self.robot = RobotManager(loads(ROBOT.format(offers)), bridges=bridges)

    def offer(self) -> OfferStatus:
        """Offer, and return the only offer."""
        (status,) = self.robot.offer(timeout=patience())
        return status

    def state(self) -> OfferState:
        return self.robot.status().offers[0].state

    def apply(self, offers: str) -> None:
        self.robot.apply(loads(ROBOT.format(offers)), timeout=patience())


@pytest.fixture
def stage() -> Iterator[Callable[[str], Stage]]:
    made: list[Stage] = []

    def make(offers: str) -> Stage:
        made.append(Stage(offers))
        return made[-1]

    yield make
    for item in made:
        item.robot.close()


ACTION = """
offer:
  net:
    carry:
      inputs: {goal: {endpoint: [wanted]}}
      outputs: {status: {endpoint: [reported]}}
"""
STATUS = closed(goal_id=TEXT, status=TEXT)
CAMERA = "offer: {net: {camera: {output: {endpoint: [seen]}}}}"
ARM = "offer: {net: {arm: {input: {endpoint: [wish]}}}}"
DOUBLE = "offer: {net: {double: {service: {endpoint: [twice]}}}}"


def served(stage: Stage, message: Any) -> Any:
    asked = Endpoint("net", "doubler", Role.SERVICE, ("twice",))
    return stage.net.call(asked, message, timeout=patience())


def test_an_address_of_several_ports_is_named_once(stage: Callable[[str], Stage]) -> None:
    there = stage(ACTION.replace("[reported]", "[wanted]"))
    assert there.offer().endpoints == (("wanted",),)


def test_an_output_reaches_a_framework_and_goes_on_when_its_provider_dies(
    stage: Callable[[str], Stage],
) -> None:
    there = stage(CAMERA)
    assert there.robot.status().offers == ()  # nothing is opened before that is asked for
    status = there.offer()
    assert status.state is OfferState.OPEN, status.cause
    assert status.name == "net:camera"
    assert status.endpoints == (("seen",),)
    there.best.emit(7)
    assert there.seen.taken.wait(1)[-1] == 7
    (sink,) = there.seen.channels()

    there.one.die("best")
    wait(there.next.channels, "the next provider was never opened")

    def arrives() -> bool:
        there.next.emit(8)
        return 8 in there.seen.taken.messages

    wait(arrives, "nothing came from the next provider")
    assert there.seen.channels() == (sink,)

    def delivered() -> int:
        routes = there.robot.status().routes
        (route,) = [
            route_status for route_status in routes if route_status.consumer == "net:camera.default"
        ]
        assert route.producer == status.connections[0]
        return route.delivered

    wait(lambda: delivered() >= 2)  # counted once it was taken


def test_an_input_is_fed_by_a_framework(stage: Callable[[str], Stage]) -> None:
    there = stage(ARM)
    assert there.offer().state is OfferState.OPEN
    there.wish.emit(3)
    assert there.mover.taken.wait(1)[-1] == 3


def test_a_service_is_called_from_a_framework(stage: Callable[[str], Stage]) -> None:
    there = stage(DOUBLE)
    assert there.offer().state is OfferState.OPEN
    assert served(there, 21) == 42
    with pytest.raises(MessageError, match="expected at most 1000, got 2000"):
        served(there, 2000)
    status = there.robot.status().offers[0]
    assert (status.calls, status.failed) == (1, 1)


def test_goals_of_a_provider_that_dies_and_goals_that_are_refused_are_reported_so(
    stage: Callable[[str], Stage],
) -> None:
    there = stage(ACTION)
    assert there.offer().state is OfferState.OPEN
    accepted = {"goal_id": "first", "status": "accepted"}
    there.wanted.emit(1)
    assert there.cart.taken.wait(1) == [1]
    there.rolled.emit(accepted)
    there.wanted.emit(2)
    assert there.cart.taken.wait(2) == [1, 2]
    there.one.die("cart")
    lost = {"goal_id": "first", "status": "lost"}
    rejected = {"goal_id": "", "status": "rejected"}
    assert there.reports.taken.wait(3) == [accepted, lost, rejected]

    wait(there.lift.channels, "the next provider was never opened")
    there.robot.stop_all()
    there.wanted.emit(3)
    assert there.reports.taken.wait(4)[-1] == rejected


def test_a_service_stays_while_no_component_answers(stage: Callable[[str], Stage]) -> None:
    there = stage(DOUBLE)
    there.offer()
    there.one.die("doubler")
    there.one.report(Health.LOST, "it was killed", component="doubler")
    with pytest.raises(ResolutionError, match="no component"):
        served(there, 1)
    there.one.service("doubler", NUMBER, {"type": "integer"}, lambda asked: 3 * asked)
    there.one.report(Health.OK, "it is back", component="doubler")
    assert served(there, 2) == 6


def test_what_does_not_fit_is_refused_with_the_map_that_would_mend_it(
    stage: Callable[[str], Stage],
) -> None:
    wrong = "offer: {net: {scan: {output: {endpoint: [readings]}}}}"
    there = stage(wrong)
    readings = there.net.taker("readings", READING)
    status = there.offer()
    assert status.state is OfferState.FAILED
    assert "output 'default' does not fit ['readings']" in status.cause
    assert "distance" in status.cause
    assert not readings.channels()
    assert not there.robot.connections()

    there.apply(
        "offer: {net: {scan: {output: {endpoint: [readings], map: {distance: range},"
        " allow_loss: [range]}}}}"
    )
    wait(lambda: there.state() is OfferState.OPEN, "the mended offer never opened")
    there.laser.emit({"range": 4})
    assert readings.taken.wait(1)[-1] == {"distance": 4}


def test_what_is_not_there_yet_is_tried_again(stage: Callable[[str], Stage]) -> None:
    there = stage("offer: {net: {camera: {output: {endpoint: [late]}}}}")
    assert "there is no component at ['late']" in there.offer().cause
    late = there.net.taker("late", NUMBER)
    wait(lambda: there.state() is OfferState.OPEN, "it was not tried again")
    there.best.emit(1)
    assert late.taken.wait(1)[-1] == 1


def test_a_channel_that_is_lost_is_opened_again(stage: Callable[[str], Stage]) -> None:
    there = stage(CAMERA)
    there.offer()
    (sink,) = there.seen.channels()
    there.net.report(Health.LOST, "it was unplugged", channel=sink)
    wait(lambda: there.seen.channels() not in {(), (sink,)}, "it was not opened again")
    wait(lambda: there.state() is OfferState.OPEN)
    there.best.emit(5)
    assert there.seen.taken.wait(1)[-1] == 5


def test_a_change_of_configuration_opens_and_closes_offers(
    stage: Callable[[str], Stage],
) -> None:
    there = stage(CAMERA)
    there.offer()
    (sink,) = there.seen.channels()
    there.apply(f"{CAMERA[:-2]}, arm: {{input: {{endpoint: [wish]}}}}}}}}")
    wait(lambda: len(there.mover.channels()) == 1, "the new one was not opened")
    assert there.seen.channels() == (sink,)
    there.apply("")
    assert not there.seen.channels()
    assert not there.robot.connections()
    assert there.robot.history()[-1].differences == ("- offer net:camera", "- offer net:arm")


def test_closing_leaves_nothing(stage: Callable[[str], Stage]) -> None:
    there = stage(CAMERA)
    there.offer()
    there.robot.close()
    assert not there.seen.channels()
    assert there.robot.status().offers[0].state is OfferState.CLOSED


def test_a_source_that_has_finished_is_reported_and_not_played_again(
    stage: Callable[[str], Stage],
) -> None:
    there = stage(f"{CAMERA[:-2]}, arm: {{input: {{endpoint: [wish]}}}}}}}}")
    reports: list[str] = []
    there.robot.listen(
        lambda event: reports.append(event.change) if event.subject == "offer net:camera" else None
    )
    there.robot.offer(timeout=patience())
    there.best.emit(1)
    assert there.seen.taken.wait(1)[-1] == 1
    there.one.report(Health.FINISHED, "the film is over", component="best")
    wait(lambda: there.state() is OfferState.FINISHED, "the end was never reported")
    status = there.robot.status().offers[0]
    assert (status.cause, status.connections) == ("component 'best' finished", ())
    assert not there.seen.channels()
    there.one.report(Health.OK, "all is well")  # upon which what failed would be opened again
    wait(lambda: reports == ["open", "finished"])
    there.apply("")
    assert there.robot.status().offers == ()


@pytest.mark.parametrize(
    ("robot", "function", "port", "fits"),
    [
        ("", "", "", True),
        ("meaning: strict", "", "", False),
        ("meaning: strict", "", ", meaning: stated", True),
        ("", "meaning: strict,", "", False),
        ("", "", ", meaning: strict", False),
    ],
)
def test_an_offer_is_judged_by_meaning_as_robot_function_and_port_say(
    robot: str, function: str, port: str, *, fits: bool
) -> None:
    one, net = MemoryBridge("one"), MemoryBridge("net")
    one.emitter("gyro", {**NUMBER, "x-unit": "deg"})
    net.taker("angle", NUMBER)
    text = f"""
version: 1
{robot}
bridges: {{one: {{plugin: memory}}, net: {{plugin: memory}}}}
functions:
  turn: {{{function} components: [{{name: gyro, bridge: one, output: {{endpoint: [gyro]}}}}]}}
offer: {{net: {{turn: {{output: {{endpoint: [angle]{port}}}}}}}}}
"""
    with RobotManager(loads(text), bridges={"one": one, "net": net}) as manager:
        (status,) = manager.offer(timeout=patience())
    assert (status.state is OfferState.OPEN) is fits, status.cause
    assert fits or "`meaning: strict` demands" in status.cause


@pytest.mark.parametrize(
    ("offers", "text"),
    [
        ("offer: {nte: {camera: {output: {endpoint: [a]}}}}", 'there is no bridge "nte'),
        ("offer: {net: {camra: {output: {endpoint: [a]}}}}", 'there is no function "camra'),
        ("offer: {net: {camera: {}}}", "the offer has no port"),
        ("offer: {net: {camera: {outputs: {x: {endpoint: [a]}}}}}", 'camera has no output "x'),
        ("offer: {net: {camera: {input: {endpoint: [a]}}}}", "no component of camera has an input"),
        ("offer: {net: {arm: {output: {endpoint: [a]}}}}", "no component of arm has an output"),
        ("offer: {net: {arm: {service: {endpoint: [a]}}}}", "no component of arm is a service"),
        ("offer: {net: {arm: {input: {endpoint: []}}}}", "endpoint"),
    ],
)
def test_mistakes_in_the_file_are_reported(offers: str, text: str) -> None:
    with pytest.raises(ConfigurationError, match=text):
        loads(ROBOT.format(offers))


def test_what_is_lost_twice_in_a_row_is_opened_twice(
    stage: Callable[[str], Stage],
) -> None:
    there = stage(CAMERA)
    reports: list[str] = []
    there.robot.listen(
        lambda event: reports.append(event.change) if "offer" in event.subject else None
    )
    there.offer()

    def opened(count: int) -> None:
        wait(lambda: reports.count("open") == count, "it was not opened again")

    for count in (1, 2):
        opened(count)
        (sink,) = there.seen.channels()
        there.net.report(Health.LOST, "it was unplugged", channel=sink)
    opened(3)
    assert reports == ["open", "opening"] * 2 + ["open"]
