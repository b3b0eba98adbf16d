"""What a payload may be, said by structures: how large, and of finite numbers alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from brokers import Broker, running

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import ResolutionError
from uoarm.testing import patience

OCTETS = "type: array, items: {type: integer, minimum: 0, maximum: 255}, x-octets: true"
ROBOT = """
version: 1
bridges:
  mqtt: {{plugin: mqtt, options: {{url: "{url}", max_octets: {most}}}{host}}}
functions:
  given:
    components:
      - {{name: giver, bridge: mqtt, output: {{endpoint: [given], structure: {structure}}}}}
  shown:
    components:
      - name: screen
        bridge: mqtt
        input:
          from: given
          endpoint: [shown]
          structure: {taken}
          options: {{content: {content}}}
"""


def robot(broker: Broker, structure: str, **more: Any) -> RobotManager:
    values = {"most": 4000, "taken": "true", "content": "json", "host": "", **more}
    return RobotManager(loads(ROBOT.format(url=broker.url, structure=structure, **values)))


HOSTED = f", host: {{silence: {patience():g}, start: {patience():g}}}"


@pytest.mark.parametrize("host", ["", HOSTED], ids=["here", "hosted"])
def test_what_is_always_too_large_is_refused_before_anything_opens(
    broker: Broker, host: str
) -> None:
    frames = f"{{{OCTETS}, minItems: 3000, maxItems: 3000}}"
    wanted = "every message has at least 4,002 octets as JSON, and 4,000 are taken"
    with robot(broker, frames, host=host) as manager, pytest.raises(ResolutionError, match=wanted):
        manager.resolve("shown")
    with robot(broker, frames, host=host, most=5000) as manager:
        manager.resolve("shown")
    with robot(broker, frames, host=host, content="octets", taken=frames) as manager:
        manager.resolve("shown")


def test_what_the_broker_takes_is_a_bound_as_well(tmp_path: Path) -> None:
    with running(tmp_path, "allow_anonymous true\nmax_packet_size 3000\n") as broker:
        frames = f"{{{OCTETS}, maxItems: 2990}}"
        given = {"content": "octets", "taken": frames}
        wanted = "a message may have about 2,990 octets, and 2,9"
        with (
            robot(broker, frames, **given) as manager,
            pytest.raises(ResolutionError, match=wanted),
        ):
            manager.resolve("shown")
        given = {"content": "octets", "taken": f"{{{OCTETS}}}"}
        with robot(broker, f"{{{OCTETS}, maxItems: 2000}}", **given) as manager:
            manager.resolve("shown")


@pytest.mark.parametrize("taken", ["true", "{type: object}"])
def test_that_numbers_may_not_be_finite_is_a_note_of_the_plan(broker: Broker, taken: str) -> None:
    member = "{type: number, x-nonfinite: true, x-unit: m}"
    pose = f"{{type: object, properties: {{x: {member}, y: {member}}}, required: [x, y]}}"
    with robot(broker, pose, taken=taken) as manager:
        [note] = manager.resolve("shown").warnings
        assert "x: the producer may emit NaN or infinity" in note
        assert "here and in 1 more places" in note


@pytest.mark.parametrize("structure", ["{type: string}", "{type: array, items: {type: string}}"])
def test_what_nothing_bounds_fits(broker: Broker, structure: str) -> None:
    with robot(broker, structure) as manager:
        assert manager.resolve("shown").warnings == ()
