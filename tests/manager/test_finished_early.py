"""A source that has nothing more before its opening has returned ends what takes over with it."""

from __future__ import annotations

from uoarm import RobotManager
from uoarm.bridge import Delivery, Source
from uoarm.config import loads
from uoarm.model import ConnectionState, Deliver, Endpoint, Health, MessageStructure
from uoarm.testing import MemoryBridge, patience, wait

ROBOT = """
version: 1
bridges: {memory: {plugin: memory}}
functions:
  camera:
    components:
      - {name: eye, bridge: memory, priority: 2, output: {endpoint: [eye]}}
      - {name: short, bridge: memory, priority: 1, output: {endpoint: [short]}}
"""


class ShortBridge(MemoryBridge):
    """One of its sources gives one message and finishes as it opens, as a short recording does."""

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver | Delivery
    ) -> Source:
        source = super()._open_source(endpoint, structure, deliver)
        if endpoint.address == ("short",):
            deliver(7)
            self.report(Health.FINISHED, "it has been played", channel=source)
        return source


def test_what_takes_over_and_has_finished_by_then_ends_the_connection() -> None:
    bridge = ShortBridge()
    for name in ("eye", "short"):
        bridge.emitter(name, {"type": "integer"})
    with (
        RobotManager(loads(ROBOT), bridges={"memory": bridge}) as robot,
        robot.request("camera") as connection,
    ):
        bridge.die("eye")
        assert connection.get(patience()) == 7
        wait(lambda: connection.ended, "the connection ends")
        assert connection.state is ConnectionState.CLOSED
        assert "component 'short' finished" in connection.cause
