"""A component with several channels is doing as its worst channel does."""

from __future__ import annotations

from typing import Any

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.model import Health, StatusEvent
from uoarm.testing import Collector, MemoryBridge

NUMBER: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {memory: {}}
functions:
  both:
    components:
      - {name: both, bridge: memory, input: {endpoint: [both]}, output: {endpoint: [both]}}
"""


def test_what_is_judged_well_of_a_component_covers_up_no_other_judgment() -> None:
    bridge, causes = MemoryBridge(), Collector()
    bridge.loop("both", NUMBER)

    def listen(event: StatusEvent) -> None:
        if event.subject == "component both":
            causes.deliver(event.cause)

    with RobotManager(loads(ROBOT), bridges={"memory": bridge}) as robot, robot.request("both"):
        robot.listen(listen)
        bridge.report(Health.DEGRADED, "it is inactive", component="both", about="lifecycle")
        bridge.report(Health.DEGRADED, "it is hot", component="both", about="temperature")
        bridge.report(Health.OK, "it is cool", component="both", about="temperature")
        bridge.report(Health.OK, "it was seen", component="both")
        causes.wait(3)
        (status,) = robot.status().components
        assert (status.health, status.cause) == (Health.DEGRADED, "it is inactive")
        bridge.report(Health.OK, "it is active", component="both", about="lifecycle")
        causes.wait(4)
    assert causes.messages[:4] == ["it is inactive", "it is hot", "it is inactive", "it is active"]


def test_what_is_opened_at_a_bridge_that_is_not_well_is_so_until_that_is() -> None:
    bridge = MemoryBridge()
    bridge.loop("both", NUMBER)
    with RobotManager(loads(ROBOT), bridges={"memory": bridge}) as robot:
        said = Collector()
        robot.listen(lambda event: said.deliver(event.subject))
        bridge.report(Health.DEGRADED, "the cable is loose")
        said.wait_for(lambda subject: subject == "bridge memory")
        for _ in range(2):
            with robot.request("both"):
                (status,) = robot.status().components
                assert (status.health, status.cause) == (Health.DEGRADED, "the cable is loose")
        with robot.request("both"):
            bridge.report(Health.OK, "the cable is firm")
            said.wait_for(lambda subject: subject == "component both")
            (status,) = robot.status().components
            assert (status.health, status.cause) == (Health.OK, "the cable is firm")
        with robot.request("both"):
            (status,) = robot.status().components
            assert status.health is Health.OK


def test_what_is_well_covers_up_nothing() -> None:
    bridge = MemoryBridge()
    loop = bridge.loop("both", NUMBER)
    report = Collector()

    def listen(event: StatusEvent) -> None:
        if event.subject == "component both":
            report.deliver((event.change, event.cause))

    with RobotManager(loads(ROBOT), bridges={"memory": bridge}) as robot, robot.request("both"):
        robot.listen(listen)
        into, out = sorted(loop.channels(), key=lambda channel: channel.endpoint.role.value)
        bridge.report(Health.DEGRADED, "its input limps", channel=into)
        bridge.report(Health.OK, "its output flows", channel=out)
        bridge.report(Health.DEGRADED, "its output limps, too", channel=out)
        report.wait(2)
        (status,) = robot.status().components
        assert (status.health, status.cause) == (Health.DEGRADED, "its output limps, too")
        bridge.report(Health.OK, "its output flows again", channel=out)
        report.wait(3)
        (status,) = robot.status().components
        assert (status.health, status.cause) == (Health.DEGRADED, "its input limps")
        bridge.report(Health.DEGRADED, "the whole bridge limps")
        bridge.report(Health.OK, "its input flows again", channel=into)
        bridge.report(Health.OK, "all is well")
        report.wait(5)
        (status,) = robot.status().components
        assert (status.health, status.cause) == (Health.OK, "all is well")
    assert report.messages[:5] == [
        ("degraded", "its input limps"),
        ("degraded", "its output limps, too"),
        ("degraded", "its input limps"),
        ("degraded", "the whole bridge limps"),
        ("ok", "all is well"),
    ]
