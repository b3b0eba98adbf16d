"""Robots whose components a test plays on, and reading what was recorded with the package mcap."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from attrs import frozen
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from tests.structures import closed

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.testing import MemoryBridge

ROBOT = """
version: 1
bridges: {memory: {plugin: memory}}
functions:
  camera:
    components:
      - {name: eye, bridge: memory, priority: 2, output: {endpoint: [eye]}}
      - {name: spare, bridge: memory, priority: 1, output: {endpoint: [spare]}}
  counter: {components: [{name: clicks, bridge: memory, output: {endpoint: [clicks]}}]}
"""
COUNT: Any = closed(n={"type": "integer"})
OCTETS: Any = {
    "type": "array",
    "items": {"type": "integer", "minimum": 0, "maximum": 255},
    "x-octets": True,
}
PICTURE: Any = closed(
    width={"type": "integer", "minimum": 0, "maximum": 2**32 - 1},
    name={"type": "string"},
    data=OCTETS,
)


@pytest.fixture
def bridge() -> Iterator[MemoryBridge]:
    made = MemoryBridge()
    yield made
    made.close()


@pytest.fixture
def make_robot(bridge: MemoryBridge) -> Iterator[Callable[[], RobotManager]]:
    robots: list[RobotManager] = []

    def make(text: str = ROBOT) -> RobotManager:
        robots.append(RobotManager(loads(text), bridges={"memory": bridge}))
        return robots[-1]

    yield make
    for robot in robots:
        robot.close()


@frozen
class Read:
    """A message of a file, as the package mcap reads it."""

    topic: str
    encoding: str
    schema: Any
    data: bytes
    log_time: int
    sequence: int
    metadata: Any


def messages(path: Path | str) -> list[Read]:
    """Return all messages of a file with its index, in the order of their times."""
    with Path(path).open("rb") as file:
        return [
            Read(
                channel.topic,
                channel.message_encoding,
                schema,
                message.data,
                message.log_time,
                message.sequence,
                channel.metadata,
            )
            for schema, channel, message in make_reader(file).iter_messages()
        ]


def of_topic(path: Path | str, topic: str) -> list[Read]:
    return [message for message in messages(path) if message.topic == topic]


def readable(path: Path | str) -> list[Any]:
    """Return the records that can be read of a file without an end."""
    found: list[Any] = []
    with Path(path).open("rb") as file:
        try:
            found.extend(StreamReader(file).records)
        except Exception:  # noqa: BLE001 - it ends somewhere
            return found
    return found
