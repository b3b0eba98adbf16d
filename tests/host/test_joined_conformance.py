"""The python bridge passes the same suite behind a host that joined by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.host.joined import Joined
from tests.host.test_hosted_conformance import TESTS, HostedWorld

from uoarm._host import RemoteBridge
from uoarm._host.machines import MachineRegistry
from uoarm.bridge import Bridge
from uoarm.model import BridgeSpec, Listening
from uoarm.testing import free_port, patience, wait
from uoarm.testing.conformance import BridgeConformance, World


class JoinedWorld(HostedWorld):
    """The same components, on a machine that is reached over loopback without TLS."""

    def __init__(self, folder: Path, desk: MachineRegistry) -> None:
        super().__init__(folder)
        self._desk = desk

    def bridge(self) -> Bridge:
        path = [str(TESTS / "local"), str(TESTS / "host" / "parts")]
        options = {"path": path, "discover": ["parts:Numbers"]}
        host = {"machine": "arm", "silence": patience(), "start": patience()}
        return RemoteBridge(BridgeSpec("python", "python", options, host), self._desk)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MachineRegistry]:
    place = f"tcp/127.0.0.1:{free_port()}"
    listening = Listening(place, silence=patience())
    made = MachineRegistry(listening, ["arm"], lambda *_: None)
    with Joined(tmp_path_factory.mktemp("arm"), place, "--silence", str(patience())):
        wait(lambda: made.here("arm", "python"))
        yield made
    made.close()


@pytest.mark.usefixtures("unhurried")
class TestJoinedPythonBridge(BridgeConformance):
    """The whole suite."""

    kinds = ("Pixels", "Everything")

    @pytest.fixture
    def world(self, tmp_path: Path, desk: MachineRegistry) -> World:
        return JoinedWorld(tmp_path, desk)
