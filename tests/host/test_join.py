"""A joined host in this process: how it ends."""

from __future__ import annotations

import threading

from tests.host.joined import free_port

from uoarm._host import HostAgent, HostSettings, MachineRegistry
from uoarm._host.machines.machine_connection import MachineConnection
from uoarm.bridge import BridgeType, Registry
from uoarm.model import BridgeSpec, Listening
from uoarm.testing import MemoryBridge, patience


def test_its_bridges_close_at_the_same_time() -> None:
    meeting = threading.Barrier(2)
    met: list[int] = []

    class Slow(MemoryBridge):
        """Closes when the other one closes, too."""

        def _close(self) -> None:
            met.append(meeting.wait(patience()))
            super()._close()

    registry = Registry([])
    registry.add(BridgeType("slow", "for tests", Slow, contract=2))
    place = f"tcp/127.0.0.1:{free_port()}"
    desk = MachineRegistry(Listening(place), ["arm"], lambda *_: None)
    host = HostAgent(place, "arm", identity=None, registry=registry)
    running = threading.Thread(target=host.run)
    running.start()
    connections = [
        MachineConnection(
            desk,
            "arm",
            BridgeSpec(name, "slow", {}),
            HostSettings(),
            on_answer=lambda _: None,
            on_doubt=lambda *_: None,
            on_death=lambda _: None,
        )
        for name in ("one", "two")
    ]
    host.close()
    running.join(patience())
    for connection in connections:
        connection.close(None)
    desk.close()
    assert not running.is_alive()
    assert sorted(met) == [0, 1]
