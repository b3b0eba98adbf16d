"""Functions of another framework, offered as topics and services to nodes that know only ROS."""

from __future__ import annotations

from typing import Any

from endpoints import Make, Start
from tests.structures import closed  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.model import OfferState
from uoarm.testing import MemoryBridge, wait

NUMBER = closed(data={"type": "integer", "minimum": -(2**63), "maximum": 2**63 - 1})
FLAG = closed(data={"type": "boolean"})
OUTCOME = closed(success={"type": "boolean"}, message={"type": "string"})
ROBOT = """
version: 1
bridges: {ros: {plugin: ros2}, one: {plugin: memory}}
functions:
  counter: {components: [{name: counter, bridge: one, output: {endpoint: [counter]}}]}
  arm: {components: [{name: arm, bridge: one, input: {endpoint: [arm]}}]}
  switch: {components: [{name: switch, bridge: one, service: {endpoint: [switch]}}]}
offer:
  ros:
    counter: {output: {endpoint: [/offered/count, std_msgs/msg/Int64]}}
    arm: {input: {endpoint: [/offered/goal, std_msgs/msg/Int64]}}
    switch: {service: {endpoint: [/offered/switch, std_srvs/srv/SetBool]}}
"""


def test_nodes_use_what_is_offered_in_any_order_of_start(make_bridge: Make, peer: Start) -> None:
    memory = MemoryBridge("one")
    counter: Any = memory.emitter("counter", NUMBER)
    arm = memory.taker("arm", NUMBER)
    memory.service(
        "switch", FLAG, OUTCOME, lambda item: {"success": item["data"], "message": "done"}
    )
    bridge = make_bridge()
    with RobotManager(loads(ROBOT), bridges={"ros": bridge, "one": memory}) as robot:
        robot.offer()
        wait(lambda: {offer.state for offer in robot.status().offers} == {OfferState.OPEN})
        node = peer("node")
        assert node.do("call", name="/offered/switch", value=True) == {
            "success": True,
            "message": "done",
        }
        node.do("subscribe", topic="/offered/count")

        def received() -> list[int]:
            counter.emit({"data": 7})
            seen: list[int] = node.do("report", topic="/offered/count", expected=1, timeout=0.1)
            return seen

        wait(received)
        node.do("advertise", topic="/offered/goal")
        node.do("subscriptions", topic="/offered/goal", expected=1)
        node.do("publish", topic="/offered/goal", count=3)
        wait(lambda: [message["data"] for message in arm.taken.messages][-1:] == [3])
        reports: list[str] = []
        robot.listen(lambda event: reports.append(event.cause))
        node.end()
        ros: Any = bridge
        wait(lambda: [item.facts().get("matched") for item in ros._watched].count(0) == 2)
        assert [offer.cause for offer in robot.status().offers] == ["", "", ""]
        assert not any("is gone" in cause for cause in reports)
