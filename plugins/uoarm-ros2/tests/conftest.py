# ruff: noqa: E402 - the path for the shared modules comes before their import
"""Everything on loopback, in a domain of this test run, with peers that are processes."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # for the modules that the tests share

from endpoints import Make, Start
from peers import DOMAIN, WAIT_SECONDS, Peer
from tests.profiles import load_profile  # type: ignore[import-not-found]

from uoarm.bridge import Bridge, Registry
from uoarm.model import BridgeSpec

load_profile(60, 1000)

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(HERE / "discovery.xml")
os.environ.pop("ROS_LOCALHOST_ONLY", None)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "filterwarnings",
        "ignore:module 'sre_:DeprecationWarning",  # lark, inside ROS 2's own parser
    )


@pytest.fixture
def make_bridge() -> Iterator[Make]:
    """Makes bridges and closes them all at the end."""
    made: list[Bridge] = []
    registry = Registry()

    def make(name: str = "ros", **options: object) -> Bridge:
        bridge = registry.create(
            BridgeSpec(name, "ros2", {"domain_id": DOMAIN, "wait": WAIT_SECONDS, **options})
        )
        made.append(bridge)
        return bridge

    yield make
    for bridge in made:
        bridge.close()


@pytest.fixture
def bridge(make_bridge: Make) -> Bridge:
    return make_bridge()


@pytest.fixture
def peer() -> Iterator[Start]:
    """Starts peer processes and ends them all, frozen ones too."""
    started: list[Peer] = []

    def start(name: str, *words: str, **environment: str) -> Peer:
        process = Peer(name, {"ROS_DOMAIN_ID": str(DOMAIN), **environment}, *words)
        started.append(process)
        return process

    yield start
    for process in started:
        process.end()


@pytest.fixture(scope="session")
def share() -> Path:
    """The folder in which the definitions of installed types are."""
    import std_msgs

    folders = [parent / "share" for parent in Path(str(std_msgs.__file__)).parents]
    return next(folder for folder in folders if (folder / "std_msgs" / "msg").is_dir())
