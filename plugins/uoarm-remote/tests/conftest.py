"""A robot of plain Python components and a server before it; everything is on loopback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from parts import renew
from robots import ServedRobot

settings.register_profile(
    "remote", max_examples=40, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)  # fmt: skip
settings.load_profile("remote")


@pytest.fixture(autouse=True)
def _anew() -> Iterator[None]:
    """Have components forget what they took, also those of a robot that a test makes itself."""
    renew()
    yield
    renew()


@pytest.fixture
def robot() -> Iterator[ServedRobot]:
    made = ServedRobot()
    yield made
    renew()  # what holds a call up would hold up the close
    made.close()
