"""A joined host in this process: how it ends."""

from __future__ import annotations

import threading
from collections.abc import Mapping

import pytest

from uoarm._host import HostSettings
from uoarm._host.agent import host_agent
from uoarm._host.agent.dispatcher import RequestDispatcher
from uoarm._host.agent.host_agent import HostAgent
from uoarm._host.machines import MachineConnection, MachineRegistry
from uoarm._host.remote_bridge import RemoteBridge
from uoarm._host.transport.liveness import LivenessMonitor
from uoarm._host.transport.transport import Transport
from uoarm._host.transport.zenoh_transport import ZenohTransport
from uoarm.bridge import BridgeType, HealthEvent, Registry
from uoarm.model import BridgeSpec, Health, Listening, Options
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
            on_health=lambda _, reply: reply(None),
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


def test_what_a_bridge_reports_before_its_manager_listens_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Ailing(MemoryBridge):
        """Has something to say at once."""

        def __init__(self, name: str, options: Options) -> None:
            super().__init__(name, options)
            self.report(Health.DEGRADED, "its lens is dirty")

    registry, reported = Registry([]), threading.Event()
    report = RequestDispatcher._report

    def noted(dispatcher: RequestDispatcher, reports: Mapping[str, object]) -> None:
        report(dispatcher, reports)
        reported.set()

    monkeypatch.setattr(RequestDispatcher, "_report", noted)
    registry.add(BridgeType("ailing", "for tests", Ailing, contract=2))
    place = f"tcp/127.0.0.1:{free_port()}"
    desk = MachineRegistry(Listening(place, silence=patience()), ["arm"], lambda *_: None)
    host = HostAgent(place, "arm", identity=None, registry=registry, silence=patience())
    running = threading.Thread(target=host.run)
    running.start()
    greet = LivenessMonitor.greet

    def greeted(monitor: LivenessMonitor, transport: Transport, deadline: float) -> object:
        assert reported.wait(patience())
        return greet(monitor, transport, deadline)

    monkeypatch.setattr(LivenessMonitor, "greet", greeted)
    spec = BridgeSpec("one", "ailing", {}, {"machine": "arm", "silence": patience()})
    bridge = RemoteBridge(spec, desk)
    events: list[HealthEvent] = []
    bridge.watch(events.append)
    assert [(event.health, event.cause) for event in events] == [
        (Health.DEGRADED, "its lens is dirty")
    ]
    bridge.close()
    host.close()
    running.join(patience())
    desk.close()


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
