"""Native links: each end is a part of its component, whose state ends with the link."""

from __future__ import annotations

from typing import Any

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.model import Health, StatusEvent
from uoarm.testing import MemoryBridge, wait

NUMBER: Any = {"type": "integer"}
OK, DEGRADED, LOST = Health.OK, Health.DEGRADED, Health.LOST
COMPONENT = "bridge: memory, {}: {{{}: {{{}endpoint: [{}], structure: {{type: integer}}}}}}"
EYE = COMPONENT.format("outputs", "image", "", "eye")
SCREEN, WALL = (
    COMPONENT.format("inputs", "frames", "from: camera.image, ", name)
    for name in ("screen", "wall")
)
ROBOT = f"""
version: 1
bridges: {{memory: {{}}}}
functions:
  camera: {{components: [{{name: eye, {EYE}}}]}}
  shown: {{components: [{{name: screen, {SCREEN}}}]}}
  projected: {{components: [{{name: wall, {WALL}}}]}}
"""


def test_what_was_reported_of_one_end_covers_no_other_and_ends_with_the_link() -> None:
    memory = MemoryBridge("memory", links=True)
    memory.emitter("eye", NUMBER)
    takers = {name: memory.taker(name, NUMBER) for name in ("screen", "wall")}
    with RobotManager(loads(ROBOT), bridges={"memory": memory}) as robot:
        changes: list[StatusEvent] = []
        robot.listen(changes.append)
        shown, projected = robot.request("shown"), robot.request("projected")
        links = {name: taker.channels()[0] for name, taker in takers.items()}

        def healths() -> list[Health]:
            found = {component.name: component.health for component in robot.status().components}
            return [found[name] for name in ("eye", "screen", "wall") if name in found]

        def report(name: str, health: Health, end: str) -> None:
            memory.report_channel(links[name], health, f"{name} at {end}", end)

        assert healths() == [OK, OK, OK]
        report("screen", DEGRADED, "eye")
        report("screen", DEGRADED, "screen")
        wait(lambda: healths() == [DEGRADED, DEGRADED, OK])
        report("wall", DEGRADED, "wall")
        report("wall", OK, "eye")
        report("screen", OK, "screen")
        wait(lambda: healths() == [DEGRADED, OK, DEGRADED])
        shown.kill()
        wait(lambda: healths() == [OK, DEGRADED])
        ended = ("component eye", "ok", "its native link has ended")
        wait(lambda: ended in [(item.subject, item.change, item.cause) for item in changes])
        report("wall", LOST, "wall")
        wait(lambda: projected.state.is_over)
