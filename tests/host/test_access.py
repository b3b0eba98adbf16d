"""Who may join a manager from another machine, and that each touches what is its own only."""

from __future__ import annotations

import itertools
import shutil
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from tests.host.joined import Joined

from uoarm._host import Identity
from uoarm._host.agent.host_agent import HostAgent
from uoarm._host.machines import MachineRegistry
from uoarm._host.transport import keys
from uoarm._host.transport.codec import pack
from uoarm._host.transport.zenoh_transport import ZenohTransport
from uoarm._support.certificates import Authority
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Listening
from uoarm.testing import free_port, patience, wait

_numbers = itertools.count(1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Certificates of a manager and of two machines."""
    made = tmp_path / "certificates"
    authority = Authority.of(made)
    authority.certify_manager(["127.0.0.1"], 1)
    authority.certify_machine("arm", 1)
    authority.certify_machine("leg", 1)
    return made


@pytest.fixture
def place() -> str:
    return f"tls/127.0.0.1:{free_port()}"


@pytest.fixture
def came() -> list[tuple[str, str | None]]:
    return []


@pytest.fixture
def registry(
    folder: Path, place: str, came: list[tuple[str, str | None]]
) -> Iterator[MachineRegistry]:
    made = MachineRegistry(
        Listening(place, str(folder), patience()), ["arm", "leg"], lambda *news: came.append(news)
    )
    yield made
    made.close()


def _join(place: str, identity: Identity, timeout: float | None = None) -> ZenohTransport:
    limit = patience() if timeout is None else timeout
    return ZenohTransport(place, listen=False, timeout=limit, more=identity.settings(listen=False))


def _settle(registry: MachineRegistry, link: ZenohTransport, machine: str) -> None:
    """Wait until what was declared before under a machine's own name has reached the registry."""
    bridge = f"settled{next(_numbers)}"
    link.show_alive(f"{keys.MACHINES}/{keys.here(machine, bridge, 'x')}")
    wait(lambda: registry.here(machine, bridge))


def test_a_machine_with_its_certificate_is_seen(
    registry: MachineRegistry, folder: Path, place: str, came: list[tuple[str, str | None]]
) -> None:
    link = _join(place, Identity.find(folder, "arm"))
    _settle(registry, link, "arm")
    ((machine, bridge),) = came
    assert machine == "arm"
    assert bridge is not None
    link.close()
    wait(lambda: not registry.here("arm", bridge))
    assert came == [("arm", bridge)] * 2


def test_a_certificate_of_another_authority_is_refused(
    registry: MachineRegistry, folder: Path, place: str, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    Authority.of(other).certify_machine("arm", 1)
    shutil.copy(folder / "ca.pem", other / "ca.pem")  # it believes the manager; not so reversed
    with pytest.raises(BridgeError, match="opening the link"):
        _join(place, Identity.find(other, "arm"), 1.0)


def test_who_shows_no_certificate_is_refused(
    registry: MachineRegistry, folder: Path, place: str
) -> None:
    trusts = {"transport/link/tls": {"root_ca_certificate": str(folder / "ca.pem")}}
    with pytest.raises(BridgeError, match="opening the link"):
        ZenohTransport(place, listen=False, timeout=1.0, more=trusts)


def test_behind_a_router_of_zenoh_only_the_machine_of_its_certificate_gets_through(
    registry: MachineRegistry, folder: Path, place: str
) -> None:
    """The manager sees the certificate of who connects to it, and of no one behind that."""
    inner = f"tcp/127.0.0.1:{free_port()}"
    shown = Identity.find(folder, "arm").settings(listen=False)
    more = {**shown, "mode": "router", "connect/endpoints": [place]}
    router = ZenohTransport(inner, listen=True, timeout=patience(), more=more)
    arm, leg = (ZenohTransport(inner, listen=False, timeout=patience()) for _ in range(2))
    try:
        leg.show_alive(f"{keys.MACHINES}/{keys.here('leg', 'wheels', 'x')}")
        _settle(registry, arm, "arm")
        assert not registry.here("leg", "wheels")
        own = _join(place, Identity.find(folder, "leg"))
        _settle(registry, own, "leg")  # what came before through the router would be there by now
        assert not registry.here("leg", "wheels")
        own.close()
    finally:
        for link in (arm, leg, router):
            link.close()


def test_a_machine_that_pretends_to_be_another_gets_nothing_through(
    registry: MachineRegistry, folder: Path, place: str
) -> None:
    arm = _join(place, Identity.find(folder, "arm"))
    leg = _join(place, Identity.find(folder, "leg"))
    as_arm = leg.part(f"{keys.MACHINES}/arm")
    received: list[bytes] = []
    as_arm.listen("talk/**", received.append)
    leg.listen("uoarm/**", received.append)
    leg.listen("**", received.append)
    as_arm.answer("attach/thief", lambda _, reply: reply("stolen"))
    as_arm.show_alive("here/-/thief")
    got: list[bytes] = []
    registry.part("arm").listen("talk/**", got.append)
    arm.part(f"{keys.MACHINES}/arm").answer("attach/owner", lambda _, reply: reply(None))
    _settle(registry, leg, "leg")
    _settle(registry, arm, "arm")

    assert not registry.here("arm", "any")
    with pytest.raises(BridgeError, match="there is no answer"):
        registry.attach("arm", "thief", None, patience())
    with pytest.raises(BridgeError) as refused:
        as_arm.ask("attach/owner", None, timeout=patience())
    assert refused.value.reason in {FailureReason.UNAVAILABLE, FailureReason.TIMEOUT}

    as_arm.publish("talk/far/1", b"", b"from the thief", must_arrive=True)
    registry.part("arm").publish("talk/far/2", b"", b"for the arm", must_arrive=True)
    arm.part(f"{keys.MACHINES}/arm").publish("talk/far/3", b"", b"mine", must_arrive=True)
    wait(lambda: b"mine" in got)
    marked = threading.Event()
    leg.part(f"{keys.MACHINES}/leg").listen("talk/mark", lambda _: marked.set())
    _settle(registry, leg, "leg")
    registry.part("leg").publish("talk/mark", b"", b"mark", must_arrive=True)
    assert marked.wait(patience())  # whatever was on its way to the thief is there by now
    assert set(received) == {b"mark", b"from the thief"}  # of what it sent, only its own echo
    assert b"from the thief" not in got
    arm.close()
    leg.close()


def test_a_host_with_the_certificate_of_another_machine_is_not_asked_and_says_so(
    registry: MachineRegistry,
    folder: Path,
    place: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr("uoarm._host.agent.host_agent._UNASKED_SECONDS", 0.2)
    host = HostAgent(place, "arm", identity=Identity.find(folder, "leg"))
    running = threading.Thread(target=host.run)
    running.start()
    wait(lambda: "does not ask" in caplog.text)
    assert registry.find("arm", "far", 0.0) is None
    host.close()
    running.join(patience())
    assert not running.is_alive()


def test_a_machine_cannot_stand_in_for_the_manager(folder: Path, place: str) -> None:
    arm = Identity.find(folder, "arm")
    false = ZenohTransport(place, listen=True, more=arm.settings(listen=True))
    with pytest.raises(BridgeError, match="opening the link"):
        _join(place, Identity.find(folder, "leg"), 1.0)
    false.close()


def test_a_manager_is_believed_at_its_own_addresses_only(
    registry: MachineRegistry, folder: Path, place: str
) -> None:
    with pytest.raises(BridgeError, match="opening the link"):
        _join(place.replace("127.0.0.1", "localhost"), Identity.find(folder, "arm"), 1.0)


def test_a_host_with_a_strange_certificate_says_what_is_in_the_way(
    registry: MachineRegistry, folder: Path, place: str, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    Authority.of(other).certify_machine("arm", 1)
    with Joined(tmp_path, place, certificates=other) as host:
        wait(lambda: "waiting for the manager at" in host.log)
        assert not registry.here("arm", "any")


def test_a_key_that_others_may_read_is_not_used(folder: Path) -> None:
    (folder / "arm.key").chmod(0o640)
    with pytest.raises(BridgeError, match=r"others may read the private key .*chmod 600"):
        Identity.find(folder, "arm")


def test_a_missing_certificate_is_named(folder: Path) -> None:
    with pytest.raises(BridgeError, match=r"there is no .*long/ca\.pem"):
        Identity.find(folder / ("long" * 100), "arm")
    with pytest.raises(BridgeError, match=r"there is no .*/tail\.pem"):
        Identity.find(folder, "tail")


@pytest.mark.parametrize(
    "answer",
    [
        pack(5),
        pack([]),
        pack((False, 1, 2)),
        pack(("yes", 1)),
        pack((True, 5)),
        pack((False, 2**4000)),
        pack((False, -1)),
        pack((False, "noon")),
        b"",
        b"\xff" * 64,
    ],
)
def test_a_machine_that_answers_rubbish_is_an_error_and_its_clock_is_not_believed(
    registry: MachineRegistry, folder: Path, place: str, answer: bytes
) -> None:
    link = _join(place, Identity.find(folder, "arm"))
    raw = link._session.declare_queryable(
        f"{keys.MACHINES}/{keys.clock('arm', 'x')}",
        lambda query: query.reply(str(query.key_expr), answer),
    )
    _settle(registry, link, "arm")
    with suppress(UoarmError):
        registry.measure_clock("arm", "x", 10.0)
    assert not registry.offset("arm").known
    assert registry._asking.is_alive()
    raw.undeclare()  # type: ignore[no-untyped-call]
    link.close()
