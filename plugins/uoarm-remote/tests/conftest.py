"""A robot of plain Python components and a server before it; everything is on loopback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from parts import renew
from robots import ServedRobot
from tests.profiles import load_profile  # type: ignore[import-not-found]

load_profile(40)


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
