"""Everything on loopback, with a naming service and components of this test run."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from endpoints import ANSWERS, Make, Start
from peers import Peer
from tests.profiles import load_profile  # type: ignore[import-not-found]
from uoarm_rtm.nameserver import NameServer

from uoarm.bridge import Bridge, Registry
from uoarm.model import BridgeSpec
from uoarm.testing import patience

load_profile(40, 2000)


@pytest.fixture(scope="session", autouse=True)
def state(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where this run and its processes note their connectors: not at the user's."""
    folder = tmp_path_factory.mktemp("state")
    os.environ["XDG_STATE_HOME"] = str(folder)  # for good: a run ends within its last test
    return folder / "uoarm" / "rtm"


@pytest.fixture(scope="session")
def nameserver() -> Iterator[str]:
    """The address of a naming service of this run."""
    with NameServer() as server:
        yield server.address


@pytest.fixture
def make_bridge(nameserver: str) -> Iterator[Make]:
    """Makes bridges and closes them all at the end."""
    made: list[Bridge] = []
    registry = Registry()

    def make(name: str = "rtm", **options: object) -> Bridge:
        given = {"nameserver": nameserver, "watch": 0.1, "call_timeout": ANSWERS, **options}
        bridge = registry.create(BridgeSpec(name, "rtm", given))
        made.append(bridge)
        return bridge

    yield make
    for bridge in made:
        bridge.close(timeout=patience())


@pytest.fixture
def bridge(make_bridge: Make) -> Bridge:
    return make_bridge()


@pytest.fixture
def peer(nameserver: str) -> Iterator[Start]:
    """Starts peer processes and ends them all, frozen ones too."""
    started: list[Peer] = []

    def start(name: str, *words: str, at: str = nameserver) -> Peer:
        process = Peer(at, name, *words)
        started.append(process)
        return process

    yield start
    for process in started:  # one that ends disconnects from the others, of which none may hang
        process.thaw()
    for process in started:
        process.end()
