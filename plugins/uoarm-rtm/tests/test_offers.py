"""Functions of another framework, offered as ports of an RT-Component of ours to real ones."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from endpoints import ANSWERS, Make, Start, endpoint, sink, source, stamped
from plain import plain
from tests.inbox import Inbox  # type: ignore[import-not-found]
from tests.structures import closed  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.model import OfferState, Role
from uoarm.testing import MemoryBridge, patience, wait

IDL = str(Path(__file__).parent / "service.idl")
PUSH = {"dataport.interface_type": "corba_cdr", "dataport.dataflow_type": "push"}
ROBOT = """
version: 1
bridges: {rtm: {}, one: {plugin: memory}}
functions:
  counter:
    components:
      - {name: best, bridge: one, priority: 1, output: {endpoint: [best]}}
      - {name: next, bridge: one, output: {endpoint: [next]}}
  arm: {components: [{name: arm, bridge: one, input: {endpoint: [arm]}}]}
  loud: {components: [{name: loud, bridge: one, service: {endpoint: [loud]}}]}
offer:
  rtm:
    counter: {output: {endpoint: [self, count, TimedLong]}}
    arm: {input: {endpoint: [self, goal, "IDL:RTC/TimedLong:1.0"]}}
    loud:
      service:
        endpoint: [self, helper, "Mover::echo"]
        options: {instance: mover0, interface: "Arm::Mover"}
"""


POSE = closed(
    frame={"type": "string"},
    at={"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
    marks={
        "type": "array",
        "maxItems": 8,
        "items": {
            "type": "object",
            "properties": {"id": {"type": "integer", "minimum": 0, "maximum": 65535}},
            "required": ["id"],
            "additionalProperties": False,
        },
    },
    octets={
        "type": "array",
        "items": {"type": "integer", "minimum": 0, "maximum": 255},
        "x-octets": True,
    },
    is_sure={"type": "boolean"},
)
POSED = {
    "frame": "map",
    "at": [1.0, 2.0, 3.0],
    "marks": [{"id": 7}],
    "octets": b"ab",
    "is_sure": True,
}
GOAL = closed(joint={"type": "integer", "minimum": -(2**31), "maximum": 2**31 - 1})
ASKED = closed(words={"type": "string"})
ANSWERED = {**ASKED, "properties": {"return": {"type": "string"}}, "required": ["return"]}
LOUD = "  loud: {components: [{name: loud, bridge: one, service: {endpoint: [loud]}}]}\n"
LOUD_OFFER = 'loud: {service: {endpoint: [self, helper, "Mover::echo"]}}'
UNTYPED = """
version: 1
bridges: {rtm: {}, one: {plugin: memory}}
functions:
  pose: {components: [{name: pose, bridge: one, output: {endpoint: [pose]}}]}
  goal: {components: [{name: goal, bridge: one, input: {endpoint: [goal]}}]}
  loose: {components: [{name: loose, bridge: one, output: {endpoint: [loose]}}]}
offer:
  rtm:
    pose: {output: {endpoint: [self, pose]}}
    goal: {input: {endpoint: [self, goal]}}
    loose: {output: {endpoint: [self, loose]}}
"""


class World:
    """A robot whose functions are not OpenRTM's, and what offers them there."""

    def __init__(self, make_bridge: Make, text: str) -> None:
        self.rtm, self.one = make_bridge(idl=IDL, component="Robot"), MemoryBridge("one")
        long: Any = self.rtm.describe(endpoint(Role.INPUT, "self", "x", "TimedLong")).message
        echo: Any = self.rtm.describe(endpoint(Role.SERVICE, "self", "x", "Mover::echo"))
        self.best = self.one.emitter("best", long.schema)
        self.next = self.one.emitter("next", long.schema)
        self.arm = self.one.taker("arm", long.schema)
        self.one.service(
            "loud",
            echo.request.schema,
            echo.reply.schema,
            lambda asked: {"return": asked["words"].upper()},
        )
        self.robot = RobotManager(loads(text), bridges={"rtm": self.rtm, "one": self.one})

    def offer(self) -> None:
        for status in self.robot.offer():
            assert status.state is OfferState.OPEN, status.cause


@pytest.fixture
def world(make_bridge: Make) -> Iterator[World]:
    made = World(make_bridge, ROBOT)
    yield made
    made.robot.close()


def test_ports_of_an_offer_are_found_and_used_by_other_components(
    world: World, make_bridge: Make, peer: Start, nameserver: str
) -> None:
    world.offer()
    theirs = make_bridge("other", idl=IDL)
    (found,) = [component for component in theirs.discover() if component.name == "Robot.rtc"]
    assert {at.address[1] for at, _ in found.endpoints} >= {"count", "goal", "helper"}

    talker = peer("Talker")
    assert talker.connect(nameserver, "Robot.rtc", "goal", PUSH) == "RTC_OK"
    talker.count(4, 5)
    assert world.arm.taken.wait(1)[-1]["data"] == 4
    assert talker.connectors() == [0, 1]

    helper = vars(theirs)["_directory"].peer("Robot.rtc").port("helper")
    assert [(interface.name, interface.type) for interface in helper.interfaces] == [
        ("mover0", "Arm::Mover")
    ]
    asked = endpoint(Role.SERVICE, "Robot.rtc", "helper", "Mover::echo", timeout=patience())
    assert theirs.call(asked, {"words": "hi"}) == {"return": "HI"}

    inbox = Inbox()
    source(theirs, endpoint(Role.OUTPUT, "Robot.rtc", "count"), inbox)
    world.best.emit(stamped(1))
    inbox.wait_for(1)
    world.one.die("best")
    wait(world.next.channels, "the next provider was never opened")

    def arrives() -> bool:
        world.next.emit(stamped(2))
        return 2 in inbox.numbers()

    wait(arrives, "what the next provider emits does not arrive at the port that is connected")

    world.robot.close()
    wait(lambda: talker.connectors() == [0, 0], "the offer left a connector in a component")


def test_types_are_derived_from_structures_and_their_idl_is_at_the_port(
    make_bridge: Make, peer: Start, nameserver: str
) -> None:
    rtm, one = make_bridge(component="Robot"), MemoryBridge("one")
    pose, goal = one.emitter("pose", POSE), one.taker("goal", GOAL)
    one.emitter("loose", {"type": "object", "properties": {"n": {"type": "integer"}}})
    with RobotManager(loads(UNTYPED), bridges={"rtm": rtm, "one": one}) as robot:
        states = {offer_status.function: offer_status for offer_status in robot.offer()}
        assert states["pose"].state is OfferState.OPEN, states["pose"].cause
        assert states["goal"].state is OfferState.OPEN, states["goal"].cause
        assert "field 'n': a struct has all its members" in states["loose"].cause

        ports: Any = {
            name: vars(rtm)["_directory"].peer("Robot.rtc").port(name) for name in ("pose", "goal")
        }
        theirs = make_bridge("other", idl=[port.properties["uoarm.idl"] for port in ports.values()])
        inbox = Inbox()
        source(theirs, endpoint(Role.OUTPUT, "Robot.rtc", "pose"), inbox)
        pose.emit(POSED)
        (came,) = inbox.wait_for(1)
        assert plain(came) == plain(POSED)

        talker = peer("Talker", ports["goal"].data_type, ports["goal"].properties["uoarm.idl"])
        asked = {**PUSH, "dataport.data_type": ports["goal"].data_type}
        assert talker.connect(nameserver, "Robot.rtc", "goal", asked) == "RTC_OK"
        talker.write({"joint": -5})
        assert goal.taken.wait(1) == [{"joint": -5}]


def test_an_interface_is_derived_from_the_structures_of_a_service(
    make_bridge: Make, peer: Start, nameserver: str
) -> None:
    rtm, one = make_bridge(component="Robot"), MemoryBridge("one")
    handed: list[Any] = []
    one.service("find", POSE, ANSWERED, lambda asked: {"return": asked["frame"].upper()})
    one.service("speak", {"type": "number"}, {"type": "null"}, handed.append)
    one.service("loose", {"type": "object"}, ANSWERED, lambda asked: {"return": "?"})
    text = """
version: 1
bridges: {rtm: {}, one: {plugin: memory}}
functions:
  find: {components: [{name: find, bridge: one, service: {endpoint: [find]}}]}
  speak: {components: [{name: speak, bridge: one, service: {endpoint: [speak]}}]}
  loose: {components: [{name: loose, bridge: one, service: {endpoint: [loose]}}]}
offer:
  rtm:
    find: {service: {endpoint: [self, find]}}
    speak: {service: {endpoint: [self, speak]}}
    loose: {service: {endpoint: [self, loose]}}
"""
    with RobotManager(loads(text), bridges={"rtm": rtm, "one": one}) as robot:
        states = {offer_status.function: offer_status for offer_status in robot.offer()}
        assert "no IDL can be derived" in states["loose"].cause

        def ask(name: str, arguments: Any) -> Any:
            assert states[name].state is OfferState.OPEN, states[name].cause
            port: Any = vars(rtm)["_directory"].peer("Robot.rtc").port(name)
            client = peer(f"Client_{name}")
            client.require(port.properties["uoarm.idl"], f"uoarm::{port.interfaces[0].type}")
            assert client.join(nameserver, "Robot.rtc", name) == "RTC_OK"
            return client.ask("call", arguments)

        assert ask("find", {"request": {**POSED, "octets": [97]}}) == {"return": {"return": "MAP"}}
        assert ask("speak", {"request": 0.5}) == {}
        assert handed == [0.5]


def test_offers_of_a_bridge_in_a_host_are_as_those_of_any(
    make_bridge: Make, nameserver: str
) -> None:
    one = MemoryBridge("one")
    pose, goal = one.emitter("pose", POSE), one.taker("goal", GOAL)
    one.emitter("loose", POSE)
    one.service("loud", ASKED, ANSWERED, lambda asked: {"return": asked["words"].upper()})
    options = {"nameserver": nameserver, "component": "Far", "idl": IDL, "call_timeout": ANSWERS}
    hosted = {"options": options, "host": {"silence": 600, "start": 600}}
    text = UNTYPED.replace("rtm: {}", f"rtm: {json.dumps(hosted)}")
    text = text.replace("loose: {output: {endpoint: [self, loose]}}", LOUD_OFFER)
    text = text.replace("offer:", LOUD + "offer:")
    with RobotManager(loads(text), bridges={"one": one}) as robot:
        for status in robot.offer():
            assert status.state is OfferState.OPEN, status.cause
        theirs: Any = make_bridge("other", idl=IDL)
        ports = {port.name: port for port in theirs._directory.peer("Far.rtc").ports}
        idl = [ports[name].properties["uoarm.idl"] for name in ("pose", "goal")]
        theirs = make_bridge("typed", idl=[IDL, *idl])
        inbox = Inbox()
        source(theirs, endpoint(Role.OUTPUT, "Far.rtc", "pose"), inbox)
        pose.emit(POSED)
        assert plain(inbox.wait_for(1)[0]) == plain(POSED)
        sink(theirs, endpoint(Role.INPUT, "Far.rtc", "goal")).send({"joint": -5})
        assert goal.taken.wait(1) == [{"joint": -5}]
        asked = endpoint(Role.SERVICE, "Far.rtc", "helper", "Mover::echo", timeout=patience())
        assert theirs.call(asked, {"words": "hi"}) == {"return": "HI"}
