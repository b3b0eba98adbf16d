"""Other machines, and where they join, in a configuration that changes while the manager runs."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from uoarm import RobotManager
from uoarm._host import Identity
from uoarm._host.agent.host_agent import HostAgent
from uoarm._support.certificates import Authority
from uoarm.bridge import BridgeType, Registry
from uoarm.config import loads
from uoarm.errors import ConfigurationError
from uoarm.model import ConnectionState, Effect, Health, Options, Robot
from uoarm.testing import Emitter, MemoryBridge, free_port, patience, wait

NUMBER = {"type": "integer"}


class There:
    """What emits on the machines, which are threads of this process, joined over real links."""

    def __init__(self, folder: Path) -> None:
        self.emitters: dict[str, list[Emitter]] = {}
        self.registry = Registry([])
        self.registry.add(BridgeType("lab", "for tests", self._make, contract=2))
        self.certificates = folder / "certificates"
        self.joined = ExitStack()

    def join(self, place: str, machine: str) -> None:
        """Have a machine join until the test ends."""
        secured = place.startswith("tls/")
        identity = Identity.find(self.certificates, machine) if secured else None
        silence = patience()
        agent = HostAgent(
            place, machine, identity=identity, registry=self.registry, silence=silence
        )
        running = threading.Thread(target=agent.run)
        running.start()
        self.joined.callback(running.join, patience())
        self.joined.callback(agent.close)

    def _make(self, name: str, options: Options) -> MemoryBridge:
        bridge = MemoryBridge(name, options)
        self.emitters.setdefault(name, []).append(bridge.emitter("light", NUMBER))
        return bridge


@pytest.fixture
def there(tmp_path: Path) -> Iterator[There]:
    made = There(tmp_path)
    with made.joined:
        yield made


def _robot(place: str, *bridges: str, more: str = "") -> Robot:
    """Return a robot with a function for each `BRIDGE@MACHINE`, or bridge in this process."""
    pairs = [bridge.partition("@") for bridge in bridges]
    listen = f"hosts: {{listen: {place}, {more} silence: {patience()}}}" if place else ""
    lines = ["version: 1", "failover: {wait: 0}", listen, "bridges:"]
    for name, _, machine in pairs:
        host = f", host: {{machine: {machine}, start: {patience()}}}" if machine else ""
        lines.append(f"  {name}: {{plugin: lab{host}}}")
    lines.append("functions:")
    for name, _, _ in pairs:
        lines.append(f"  {name}: {{components: [{{name: the_{name}, bridge: {name}, ")
        lines.append("    output: {endpoint: [light]}}]}")
    return loads("\n".join(lines))


def test_the_first_machine_joins_a_second_one_and_then_none_has_a_bridge(there: There) -> None:
    place = f"tcp/127.0.0.1:{free_port()}"
    with RobotManager(_robot("", "near"), registry=there.registry) as manager:
        near = manager.request("near")
        there.join(place, "arm")
        there.join(place, "leg")
        change = manager.apply(_robot(place, "near", "far@arm"))
        assert change.differences[0] == f"+ hosts {place}"
        far = manager.request("far", timeout=patience())
        manager.apply(_robot(place, "near", "far@arm", "foot@leg"))
        foot = manager.request("foot", timeout=patience())
        for name, connection in {"near": near, "far": far, "foot": foot}.items():
            there.emitters[name][-1].emit(3)
            assert connection.get(timeout=patience()) == 3
            assert connection.gaps == ()
        assert [machine.name for machine in manager.status().machines] == ["arm", "leg"]
        manager.apply(_robot("", "near"), force=True)
        wait(lambda: far.state is ConnectionState.FAILED)
        assert manager.status().machines == ()
        assert near.gaps == ()
        with socket.socket() as free:  # no process listens there, once what used it has closed
            free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            wait(lambda: _bound(free, place))


def _bound(one: socket.socket, place: str) -> bool:
    try:
        one.bind(("127.0.0.1", int(place.rpartition(":")[2])))
    except OSError:
        return False
    return True


def test_another_address_is_listened_at_beside_the_one_in_use(there: There) -> None:
    old, new = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    there.join(old, "arm")
    with RobotManager(_robot(old, "far@arm"), registry=there.registry) as manager:
        far = manager.request("far", timeout=patience())
        after = _robot(new, "far@arm", "foot@leg")
        with (
            socket.create_server(("127.0.0.1", int(new.rpartition(":")[2]))),
            pytest.raises(ConfigurationError, match="cannot join as `hosts` of the new"),
        ):
            manager.apply(after)
        assert manager.revision == 0
        assert manager.apply(after, dry_run=True).connections == ()
        manager.apply(after)
        there.join(new, "leg")
        foot = manager.request("foot", timeout=patience())
        for name, connection in {"far": far, "foot": foot}.items():
            there.emitters[name][-1].emit(7)
            assert connection.get(timeout=patience()) == 7
            assert connection.gaps == ()


def test_a_refused_machine_is_named_the_one_that_it_would_cut(there: There) -> None:
    place = f"tls/127.0.0.1:{free_port()}"
    authority = Authority.of(there.certificates)
    authority.certify_manager(["127.0.0.1"], 1)
    for machine in ("arm", "leg"):
        authority.certify_machine(machine, 1)
    there.join(place, "arm")
    secured = f"certificates: {there.certificates},"
    with RobotManager(
        _robot(place, "far@arm", "near", more=secured), registry=there.registry
    ) as manager:
        far, near = manager.request("far", timeout=patience()), manager.request("near")
        known = _robot(place, "far@arm", "near", "foot@leg", more=secured)
        assert manager.apply(known).connections == ()  # it had its certificate in time
        there.join(place, "leg")
        manager.request("foot", timeout=patience()).kill()

        authority.certify_machine("late", 1)
        later = _robot(place, "far@arm", "near", "hand@late", more=secured)
        with pytest.raises(ConfigurationError, match=r"\(far\) ends: other machines must join ane"):
            manager.apply(later)
        waits = loads(later.text.replace("wait: 0", f"wait: {patience()}"))
        [effect] = manager.apply(waits, dry_run=True).connections
        assert (effect.effect, effect.after) == (Effect.MOVES, ("the_far",))
        assert list(far.gaps) == []
        manager.apply(waits)
        there.join(place, "late")
        hand = manager.request("hand", timeout=patience())
        wait(lambda: far.gaps)
        assert "listens anew" in far.gaps[0].cause
        for name, connection in {"far": far, "near": near, "hand": hand}.items():
            there.emitters[name][-1].emit(9)
            assert connection.get(timeout=patience()) == 9
        assert near.gaps == ()
        wait(lambda: all(bridge.health is Health.OK for bridge in manager.status().bridges))
