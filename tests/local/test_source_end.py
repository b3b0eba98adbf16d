"""The end of a source: a closed manager leaves no thread of it in foreign code."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import TypedDict

import pytest

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.testing import patience

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  numbers:
    components:
      - {name: counter, bridge: python, output: {endpoint: ["ending_source:numbers"]}}
"""


class Number(TypedDict):
    value: int


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Set when the source has ended, which takes it a moment."""
    ended = threading.Event()

    def numbers() -> Iterator[Number]:
        try:
            while True:
                yield {"value": 1}
        finally:
            threading.Event().wait(0.02)
            ended.set()

    module = ModuleType("ending_source")
    module.__dict__["numbers"] = numbers
    monkeypatch.setitem(sys.modules, "ending_source", module)
    return ended


def test_a_source_has_ended_when_the_manager_is_closed(
    left: threading.Event, tmp_path: Path
) -> None:
    with (
        RobotManager(loads(ROBOT, str(tmp_path / "robot.yaml"))) as robot,
        robot.request("numbers") as numbers,
    ):
        assert numbers.get(timeout=patience()) == {"value": 1}
    assert left.is_set()
