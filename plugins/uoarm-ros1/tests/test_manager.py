"""What applications meet when functions are ROS 1: takeovers, offers, commands that expire."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from endpoints import bridge_to
from peers import Master, Peer
from tests.processes import ForkedProgram  # type: ignore[import-not-found]
from tests.structures import closed  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.model import ConnectionState, OfferState, StatusEvent
from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import MemoryBridge, patience, slowness, wait

NUMBER = closed(data={"type": "integer", "minimum": -(2**31), "maximum": 2**31 - 1})
FLAG = closed(data={"type": "boolean"})
OUTCOME = closed(success={"type": "boolean"}, message={"type": "string"})
INTEGER = {"type": "integer", "minimum": -(2**63), "maximum": 2**63 - 1}
TERMS = closed(a=INTEGER, b=INTEGER)
SUM = closed(sum=INTEGER)
HEADER = """
version: 1
{more}
bridges:
  ros: {{plugin: ros1, options: {{master: "{master}", check: 0.1, wait: 60}}{host}}}
functions:
{functions}
"""


def robot(master: Master, functions: str, more: str = "", host: str = "") -> str:
    return HEADER.format(more=more, master=master.uri, host=host, functions=functions)


def test_a_camera_that_is_killed_is_replaced_and_returned_to(master: Master) -> None:
    functions = """
  numbers:
    components:
      - name: first
        bridge: ros
        output: {endpoint: [/camera/first, std_msgs/Int32]}
      - name: second
        bridge: ros
        output: {endpoint: [/camera/second, std_msgs/Int32]}
"""
    peers = {name: master.peer(name) for name in ("first", "second")}
    for name, peer in peers.items():
        peer.do("advertise", topic=f"/camera/{name}", type="std_msgs/Int32")
    more = "failover: {return_after: 0.1}"
    text = robot(master, functions, more)
    with RobotManager(loads(text)) as manager, manager.request("numbers") as connection:
        came: list[Any] = []
        connection.subscribe(came.append)

        def comes_from(name: str, number: int) -> None:
            # What is published without a subscriber is lost: that is ROS 1.
            def has_come() -> bool:
                topic = f"/camera/{name}"
                values = {"data": number}
                peers[name].do("publish", topic=topic, type="std_msgs/Int32", values=values)
                return values in came

            wait(has_come, lambda: f"nothing of {name}: {came}")

        comes_from("first", 1)
        peers["first"].kill()
        comes_from("second", 2)
        peers["first"] = master.peer("first")
        peers["first"].do("advertise", topic="/camera/first", type="std_msgs/Int32")
        comes_from("first", 3)
        assert connection.state is ConnectionState.RUNNING
    for peer in peers.values():
        peer.kill()


def test_functions_are_offered_as_topics_services_and_actions(
    master: Master, lasting: Peer
) -> None:
    functions = """
  counter: {components: [{name: counter, bridge: one, output: {endpoint: [counter]}}]}
  arm: {components: [{name: arm, bridge: one, input: {endpoint: [arm]}}]}
  switch: {components: [{name: switch, bridge: one, service: {endpoint: [switch]}}]}
  add: {components: [{name: adder, bridge: one, service: {endpoint: [add]}}]}
offer:
  ros:
    counter: {output: {endpoint: [/offered/count, std_msgs/Int32]}}
    arm: {input: {endpoint: [/offered/goal, std_msgs/Int32]}}
    switch: {service: {endpoint: [/offered/switch, std_srvs/SetBool]}}
    add: {service: {endpoint: [/offered/add, actionlib/TwoIntsAction]}}
"""
    memory = MemoryBridge("one")
    counter: Any = memory.emitter("counter", NUMBER)
    arm = memory.taker("arm", NUMBER)
    memory.service("switch", FLAG, OUTCOME, lambda ask: {"success": ask["data"], "message": "done"})
    memory.service("add", TERMS, SUM, lambda goal: {"sum": goal["a"] + goal["b"]})
    text = robot(master, functions).replace("\nfunctions", "\n  one: {plugin: memory}\nfunctions")
    with (
        bridge_to(master) as bridge,
        RobotManager(loads(text), bridges={"ros": bridge, "one": memory}) as manager,
    ):
        manager.offer()
        wait(lambda: {offer.state for offer in manager.status().offers} == {OfferState.OPEN})
        lasting.do("subscribe", topic="/offered/count", type="std_msgs/Int32")
        lasting.do("advertise", topic="/offered/goal", type="std_msgs/Int32")

        def has_come() -> bool:
            counter.emit({"data": 5})
            return bool(lasting.do("count", topic="/offered/count"))

        wait(has_come, "nothing is published")
        lasting.publish("/offered/goal", type="std_msgs/Int32", values={"data": 9})
        wait(lambda: {"data": 9} in arm.taken.messages, "nothing is taken")
        ask = {"service": "/offered/switch", "type": "std_srvs/SetBool"}
        assert lasting.do("call", **ask, values={"data": True})["message"] == "done"
        goal = {"action": "/offered/add", "type": "actionlib/TwoIntsAction"}
        done = lasting.do("send_goal", **goal, values={"a": 40, "b": 2}, timeout=patience())
        assert done["result"] == {"sum": 42}


def test_two_topics_of_one_type_are_linked_by_the_plan(master: Master, lasting: Peer) -> None:
    """The bridge moves the octets: no message comes through the manager."""
    peer = master.peer("linked")
    peer.do("advertise", topic="/plan/from", type="std_msgs/Int32")
    lasting.do("subscribe", topic="/plan/to", type="std_msgs/Int32")
    functions = """
  numbers: {components: [{name: numbers, bridge: ros, output: {endpoint: [/plan/from]}}]}
  shown:
    components:
      - {name: screen, bridge: ros, input: {from: numbers, endpoint: [/plan/to]}}
"""
    with (
        RobotManager(loads(robot(master, functions))) as manager,
        manager.request("shown"),
    ):
        peer.publish("/plan/from", type="std_msgs/Int32", values={"data": 5})
        lasting.wait_for("came", lambda came: came == [{"data": 5}], topic="/plan/to")
        (route,) = manager.status().routes
        assert route.native
    peer.kill()


@pytest.mark.parametrize("goes", ["/taker/{}", "/linked"], ids=["two topics", "one topic"])
def test_a_consumer_of_a_link_that_is_killed_is_replaced_and_no_producer_blamed(
    master: Master, lasting: Peer, goes: str
) -> None:
    lasting.do("advertise", topic="/linked", type="std_msgs/Int32")
    topics = {name: goes.format(name) for name in ("first", "second")}
    peers = {name: master.peer(name) for name in topics}
    peers["first"].do("subscribe", topic=topics["first"], type="std_msgs/Int32")
    functions = f"""
  numbers: {{components: [{{name: numbers, bridge: ros, output: {{endpoint: [/linked]}}}}]}}
  taker:
    components:
      - name: first
        bridge: ros
        priority: 2
        input: {{from: numbers, endpoint: [{topics["first"]}]}}
      - name: second
        bridge: ros
        input: {{from: numbers, endpoint: ["/taker/second"]}}
"""
    peers["second"].do("subscribe", topic="/taker/second", type="std_msgs/Int32")
    with (
        RobotManager(loads(robot(master, functions))) as manager,
        manager.request("taker") as connection,
    ):
        assert [route.native for route in manager.status().routes] == [True]
        changes: list[StatusEvent] = []
        manager.listen(changes.append)
        peers["first"].kill()
        wait(lambda: connection.plan.provider.component.name == "second", lambda: str(changes))
        assert [event.change for event in changes if event.subject == "component numbers"] == []
    peers["second"].kill()


TWIST = """
  drive:
    components:
      - name: base
        bridge: ros
        input:
          endpoint: [{topic}, geometry_msgs/Twist]
          options: {{wait: 60}}
          lifetime: {lifetime}
          stop: {stop}
          meaning: stated
"""
ZERO = {axis: {"x": 0.0, "y": 0.0, "z": 0.0} for axis in ("linear", "angular")}
STOP = "{message: {linear: {x: 0, y: 0, z: 0}, angular: {x: 0, y: 0, z: 0}}}"
FORWARD = {**ZERO, "linear": {"x": 1.0, "y": 0.0, "z": 0.0}}


def test_a_twist_that_no_sender_repeats_is_followed_by_the_stop(
    master: Master, lasting: Peer
) -> None:
    topic = "/expiring/cmd_vel"
    lasting.do("subscribe", topic=topic, type="geometry_msgs/Twist")
    lifetime = 0.2 * slowness()
    functions = TWIST.format(topic=topic, lifetime=lifetime, stop=STOP)
    with (
        RobotManager(loads(robot(master, functions))) as manager,
        manager.request("drive") as connection,
    ):
        while not (came := lasting.do("came", topic=topic)):
            connection.send(FORWARD)  # one that waited for longer than it lives is refused
        assert came[0] == FORWARD
        lasting.wait_for("came", lambda came: came[-1] == ZERO, topic=topic)


DRIVER = """
import sys
from uoarm import RobotManager
from uoarm.config import load

with RobotManager(load(sys.argv[1])) as manager:
    with manager.request("drive") as connection:
        still = {"x": 0.0, "y": 0.0, "z": 0.0}
        forward = {"linear": {**still, "x": 1.0}, "angular": still}
        while True:
            connection.send(forward)
            print("sent", flush=True)
            sys.stdin.readline()
"""


def test_the_base_stops_when_the_manager_is_killed(
    master: Master, lasting: Peer, tmp_path: Path
) -> None:
    """The bridge is in a host: it outlives the manager for as long as it takes to stop."""
    topic = "/orphaned/cmd_vel"
    lasting.do("subscribe", topic=topic, type="geometry_msgs/Twist")
    functions = TWIST.format(topic=topic, lifetime=60, stop=STOP)
    host = f", host: {{silence: {patience()}, start: {patience()}}}"
    file = tmp_path / "robot.yaml"
    file.write_text(robot(master, functions, host=host))
    driver = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert driver.stdout is not None
        assert driver.stdout.readline() == b"sent\n"
        lasting.wait_for("came", lambda came: came == [FORWARD], topic=topic)
    finally:
        driver.kill()
        driver.communicate()
    lasting.wait_for("came", lambda came: came[-1] == ZERO, topic=topic)


CLIENT = """
import asyncio, sys
from uoarm.client import connect

async def main():
    still = {"x": 0.0, "y": 0.0, "z": 0.0}
    async with connect(sys.argv[1]) as robot:
        base = await robot.request("drive")
        async with base.hold({"linear": {**still, "x": 1.0}, "angular": still}):
            print("sent", flush=True)
            await asyncio.Event().wait()

asyncio.run(main())
"""


def test_the_base_stops_when_the_client_is_killed(master: Master, lasting: Peer) -> None:
    """What it held expires: its session outlives it for half a minute, its command does not."""
    topic = "/abandoned/cmd_vel"
    lasting.do("subscribe", topic=topic, type="geometry_msgs/Twist")
    text = robot(master, TWIST.format(topic=topic, lifetime=0.2 * slowness(), stop=STOP))
    with (
        RobotManager(loads(text)) as manager,
        serve_in_thread(manager, ServerOptions(port=0)) as server,
        subprocess.Popen(
            [sys.executable, "-c", CLIENT, f"ws://127.0.0.1:{server.ports[0]}/"],
            stdout=subprocess.PIPE,
        ) as client,
    ):
        try:
            assert client.stdout is not None
            assert client.stdout.readline() == b"sent\n"
            lasting.wait_for("came", lambda came: FORWARD in came, topic=topic)
        finally:
            client.kill()
        lasting.wait_for("came", lambda came: came[-1] == ZERO, topic=topic)


def test_the_base_can_see_that_the_host_was_killed(master: Master, lasting: Peer) -> None:
    """Nothing of uoarm is left that could send a stop: the end of the connection says so."""
    topic = "/hostless/cmd_vel"
    lasting.do("subscribe", topic=topic, type="geometry_msgs/Twist")
    functions = TWIST.format(topic=topic, lifetime=60, stop=STOP)
    host = f", host: {{silence: {patience()}, start: {patience()}}}"
    with RobotManager(loads(robot(master, functions, host=host))) as manager:
        connection = manager.request("drive")
        connection.send(FORWARD)
        lasting.wait_for("came", lambda came: came == [FORWARD], topic=topic)
        (process,) = [bridge.process for bridge in manager.status().bridges]
        assert process is not None
        assert lasting.do("writers", topic=topic) == 1
        os.kill(process, signal.SIGKILL)
        lasting.wait_for("writers", lambda count: count == 0, topic=topic)
        wait(lambda: connection.state is ConnectionState.FAILED, "the connection ends")
        assert lasting.do("came", topic=topic) == [FORWARD]


FORKED = """
import sys
from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Endpoint, MessageStructure, Role
from uoarm.testing import patience

options = {"master": sys.argv[1], "wait": min(patience(), 60)}
bridge = Registry().create(BridgeSpec("ros", "ros1", options))
at = [
    Endpoint("ros", role.value, role, (f"/forked/{role.value}", "std_msgs/Int64"))
    for role in (Role.INPUT, Role.OUTPUT)
]
sink = bridge.open_sink(at[0], MessageStructure(True), timeout=patience())
source = bridge.open_source(at[1], MessageStructure(True), print, timeout=patience())
"""


def test_a_child_that_is_forked_holds_no_connection(master: Master, lasting: Peer) -> None:
    """A base sees that its subscription has none any more, whatever the process has forked."""
    lasting.do("subscribe", topic="/forked/input", type="std_msgs/Int64")
    lasting.do("advertise", topic="/forked/output", type="std_msgs/Int64")
    with ForkedProgram(FORKED, master.uri) as forked:
        assert forked.read() == "forked"
        assert lasting.do("writers", topic="/forked/input") == 1
        forked.kill_parent()
        lasting.wait_for("writers", lambda count: count == 0, topic="/forked/input")
        lasting.wait_for("connections", lambda count: count == 0, topic="/forked/output")
