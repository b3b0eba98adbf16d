"""A real ROS master on a loopback address of its own, for each process of tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from peers import Master, Peer, running
from tests.profiles import load_profile  # type: ignore[import-not-found]
from uoarm_ros1._master import call_api

from uoarm.testing import patience, slowness
from uoarm.testing._waiting import default_limits

load_profile(40, 1000)


@pytest.fixture(autouse=True)
def _in_time() -> Iterator[None]:
    """Have what is opened, asked and closed last as long as a busy machine may need."""
    with default_limits(patience()):
        yield


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit of calls to the master and to nodes that a test about being late runs into."""
    monkeypatch.setitem(call_api.__kwdefaults__ or {}, "seconds", slowness())


@pytest.fixture(scope="session")
def master(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Master]:
    with running(tmp_path_factory.mktemp("master")) as made:
        yield made


@pytest.fixture(scope="session")
def lasting(master: Master) -> Peer:
    """A node that serves every test, and is there to be discovered before any has asked it."""
    peer = master.peer("lasting")
    peer.do("advertise", topic="/lasting/there", type="std_msgs/Int64")
    return peer
