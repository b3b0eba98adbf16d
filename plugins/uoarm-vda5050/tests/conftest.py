"""A real Mosquitto on a loopback address of its own, for each process of tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# For the modules that the tests share, and for the broker of uoarm-mqtt's.
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(1, str(Path(__file__).parents[2] / "uoarm-mqtt" / "tests"))

from brokers import Broker, running
from tests.profiles import load_profile  # type: ignore[import-not-found]

load_profile(8)


@pytest.fixture(scope="session")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    with running(tmp_path_factory.mktemp("mosquitto")) as made:
        yield made
