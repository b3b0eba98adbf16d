"""A joined host in this process: how it ends."""

from __future__ import annotations

import threading

import pytest

from uoarm._host import HostSettings
from uoarm._host.agent import host_agent
from uoarm._host.agent.host_agent import HostAgent
from uoarm._host.machines import MachineConnection, MachineRegistry
from uoarm._host.transport.zenoh_transport import ZenohTransport
from uoarm.bridge import BridgeType, Registry
from uoarm.model import BridgeSpec, Listening
from uoarm.testing import MemoryBridge, free_port, patience


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
    desk = MachineRegistry(Listening(place, silence=patience()), ["arm"], lambda *_: None)
    host = HostAgent(place, "arm", identity=None, registry=registry, silence=patience())
    running = threading.Thread(target=host.run)
    running.start()
    connections = [
        MachineConnection(
            desk,
            "arm",
            BridgeSpec(name, "slow", {}),
            HostSettings(silence=patience(), start=patience()),
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


def test_a_host_whose_link_reports_nothing_to_the_manager_joins_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As one that joined in the moment in which the manager began to listen anew."""
    shown: list[str] = []
    show = ZenohTransport.show_alive

    def show_later(transport: ZenohTransport, key: str) -> None:
        shown.append(key)
        if len(shown) > 1:
            monkeypatch.setattr(host_agent, "_UNASKED_SECONDS", patience())
            show(transport, key)

    monkeypatch.setattr(ZenohTransport, "show_alive", show_later)
    monkeypatch.setattr(host_agent, "_UNASKED_SECONDS", 0.01)
    place = f"tcp/127.0.0.1:{free_port()}"
    joined = threading.Event()
    desk = MachineRegistry(Listening(place, silence=patience()), ["arm"], lambda *_: joined.set())
    host = HostAgent(place, "arm", identity=None, registry=Registry([]), silence=patience())
    running = threading.Thread(target=host.run)
    running.start()
    assert joined.wait(patience())
    assert desk.here("arm", "any bridge")
    host.close()
    running.join(patience())
    desk.close()
    assert not running.is_alive()
    assert len(set(shown)) == 1
