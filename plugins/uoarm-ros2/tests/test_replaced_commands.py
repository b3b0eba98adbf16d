"""What moves is stopped before what takes its place gets a command, as a node of ROS 2 sees it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from endpoints import Make, Start
from peers import OPTIONS, Peer

from uoarm import Connection, RobotManager
from uoarm.config import loads
from uoarm.errors import UoarmError
from uoarm.model import Health
from uoarm.testing import patience, wait

STOP, GO = 0, 1
ROBOT = """
version: 1
bridges: {ros: {plugin: ros2, options: {OPTIONS}HOST}}
functions:
  drive:
    components:
      - name: left
        bridge: ros
        priority: LEFT
        input:
          {endpoint: [/left, std_msgs/msg/Int64], lifetime: 3600, stop: {message: {data: 0}}}
      - name: right
        bridge: ros
        priority: 2
        input:
          {endpoint: [/right, std_msgs/msg/Int64], lifetime: 3600, stop: {message: {data: 0}}}
"""


def text(left: int, host: str = "") -> str:
    """Return a robot whose left one has this priority."""
    text = ROBOT.replace("OPTIONS", OPTIONS).replace("HOST", host)
    return text.replace("LEFT", str(left))


@contextmanager
def commanding(connection: Connection) -> Iterator[None]:
    """Send commands all the time."""
    over = threading.Event()

    def send() -> None:
        while not over.wait(0.005):
            try:
                connection.send({"data": GO})
            except UoarmError:  # while it changes
                continue

    sending = threading.Thread(target=send)
    sending.start()
    try:
        yield
    finally:
        over.set()
        sending.join(patience())


@pytest.fixture
def base(peer: Start) -> Peer:
    base = peer("base")
    base.do("subscribe_timed", topics=["/left", "/right"])
    return base


def seen(base: Peer) -> list[tuple[str, int]]:
    return [(topic, number) for topic, number in base.do("report_timed")]


def has_come(base: Peer, topic: str) -> bool:
    """Say whether a command has come."""
    return (topic, GO) in seen(base)


def is_in_order(base: Peer) -> bool:
    """Say whether the left one stopped before the right one moved, and took nothing after that.

    What one topic brings may come after what another one brings and was sent later.
    """
    came = seen(base)
    first = came.index(("/right", GO))
    left = [number for topic, number in came[:first] if topic == "/left"]
    return left[-1] == STOP and ("/left", GO) not in came[first:]


@pytest.mark.parametrize("is_hosted", [False, True])
def test_a_configuration_stops_what_it_replaces_before_the_next_is_commanded(
    base: Peer, *, is_hosted: bool
) -> None:
    host = f", host: {{silence: {patience()}, start: {patience()}}}" if is_hosted else ""
    with RobotManager(loads(text(3, host))) as robot, robot.request("drive") as drive:
        with commanding(drive):
            wait(lambda: has_come(base, "/left"))
            robot.apply(loads(text(1, host)))
            wait(lambda: has_come(base, "/right"))
        wait(lambda: is_in_order(base), "the right one moved before the left one had stopped")


def test_a_provider_that_is_lost_is_stopped_before_the_next_is_commanded(
    base: Peer, make_bridge: Make
) -> None:
    bridge = make_bridge()
    with (
        RobotManager(loads(text(3)), bridges={"ros": bridge}) as robot,
        robot.request("drive") as drive,
    ):
        with commanding(drive):
            wait(lambda: has_come(base, "/left"))
            bridge.report(Health.LOST, "it was unplugged", component="left")
            wait(lambda: has_come(base, "/right"))
        wait(lambda: is_in_order(base), "the right one moved before the left one had stopped")
