"""Who is there: profiles, states, appearing and leaving; and addresses and options as written."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from endpoints import ANSWERS, Make, Start, checked, endpoint
from tests.inbox import Inbox  # type: ignore[import-not-found]
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_rtm import _discovery, _naming, _orb
from uoarm_rtm._discovery import Directory, DirectoryMonitor
from uoarm_rtm._naming import Name, NamingService, corbaloc
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._orb import Orb
from uoarm_rtm._watch import Check, Ticker
from uoarm_rtm.component import ComponentProfile, RtComponent, Types
from uoarm_rtm.nameserver import NameServer

from uoarm.bridge import Bridge, BridgeType, Registry
from uoarm.errors import BridgeError, BridgeTimeoutError, ConfigurationError, FailureReason
from uoarm.model import BridgeSpec, Health, Role
from uoarm.testing import patience, wait


@pytest.fixture
def names() -> Any:
    """A naming service of this test alone."""
    with NameServer() as server:
        yield server.address


class Listed:
    """A directory of one component, whose name and condition a test sets."""

    def __init__(self) -> None:
        self.name: Name | None = Name("A.rtc", self)
        self.found = "alive"
        self.gone: tuple[str, ...] = ()
        self.looks = 0
        self.answers = threading.Event()  # whether the first naming service does
        self.answers.set()

    def _is_equivalent(self, other: object) -> bool:
        return self is other

    @property
    def services(self) -> tuple[Any, ...]:
        return ("first", "second")

    def names_in(self, service: str, before: Iterable[Name] = ()) -> dict[str, Name]:
        del before
        if service == "first":
            assert self.answers.wait(patience())
        if service in self.gone:
            raise BridgeError(f"{service} is gone")
        return {} if self.name is None or service == "first" else {self.name.path: self.name}

    def condition(self, name: Name) -> str:
        self.looks += 1
        return self.found


class Watching:
    """A monitor of what is listed, and what it reports."""

    def __init__(self, listed: Listed) -> None:
        self.reports: list[tuple[Health, str]] = []
        self._follows: list[Check] = []
        directory: Any = listed
        self.monitor = DirectoryMonitor(directory, self._report, "Own.rtc", self._follows.append)

    def _report(self, health: Health, cause: str, **_: Any) -> None:
        self.reports.append((health, cause))

    def play(self, checks: Sequence[Check]) -> None:
        for check in checks:
            check()
            while self._follows:
                self._follows.pop()()


@pytest.mark.parametrize("leaves", [True, False])
def test_one_that_leaves_between_two_checks_has_not_died(leaves: bool) -> None:
    listed = Listed()
    watching = Watching(listed)
    watching.play(watching.monitor.checks())
    watching.play(watching.monitor.checks())
    round_of_checks = watching.monitor.checks()
    watching.play(round_of_checks[:2])
    listed.found = "dead"
    if leaves:
        listed.name = None
    watching.play(round_of_checks[2:])
    watching.play(watching.monitor.checks())
    end = "left" if leaves else "died: only its name is left"
    assert watching.reports == [(Health.LOST, f"component A.rtc {end}")]


def test_a_naming_service_that_is_gone_says_nothing_of_its_components() -> None:
    listed = Listed()
    watching = Watching(listed)
    watching.play(watching.monitor.checks())
    listed.gone = ("second",)
    watching.play(watching.monitor.checks())
    assert not watching.reports
    listed.gone = ("first", "second")
    watching.play(watching.monitor.checks())
    listed.gone = ("first",)
    watching.play(watching.monitor.checks())
    assert watching.reports == [
        (Health.DEGRADED, "first is gone"),
        (Health.OK, "a naming service answers again"),
    ]
    listed.found = "dead"
    watching.play(watching.monitor.checks())
    assert watching.reports[2:] == [(Health.LOST, "component A.rtc died: only its name is left")]


def test_a_naming_service_that_hangs_holds_up_no_other() -> None:
    listed = Listed()
    listed.answers.clear()
    watching = Watching(listed)
    ticker = Ticker(watching.monitor.checks, 0.01)
    ticker.start()
    try:
        wait(lambda: listed.looks, "A.rtc is not looked at")
        listed.name = None
        wait(lambda: watching.reports == [(Health.LOST, "component A.rtc left")])
    finally:
        listed.answers.set()
        ticker.close(patience())


class Service:
    """A naming service of some names, which counts how often it hung."""

    address = "corbaloc::robot/NameService"

    def __init__(self, *paths: str) -> None:
        self.paths = paths
        self.hangs = False
        self.hung = 0

    def resolve(self, path: str) -> object:
        self._wait()
        return self if path in self.paths else None

    def names(self, before: Iterable[Name] = ()) -> list[Name]:
        del before
        self._wait()
        return [Name(path, self) for path in self.paths]

    def _wait(self) -> None:
        self.hung += self.hangs
        if self.hangs:
            raise BridgeTimeoutError("it hangs")


@pytest.mark.parametrize("path", ["a.host_cxt/Both.rtc", "Both.rtc"])
def test_a_naming_service_that_hung_is_asked_for_what_no_other_knows(
    path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_discovery, "peer_at", lambda _, found, __: found)
    monkeypatch.setattr(Directory, "condition", lambda *_: "alive")
    first, second = Service("a.host_cxt/Both.rtc", "First.rtc"), Service("a.host_cxt/Both.rtc")
    services: Any = (first, second)
    directory: Any = Directory(services, 1.0)
    assert directory.peer(path) is first
    first.hangs = True
    assert directory.peer(path) is second
    once = first.hung
    assert directory.peer(path) is second
    assert first.hung == once, "it took a limit again"
    first.hangs = False
    assert directory.peer("First.rtc") is first
    assert directory.peer(path) is first, "it answers again"


def test_components_are_discovered_with_ports_types_and_state(
    make_bridge: Make, peer: Start, names: str
) -> None:
    bridge = make_bridge(nameserver=names)
    peer("Worker", at=names)
    odd = peer(
        "some.host_cxt/Odd", "IDL:Odd/Mixed:1.0", str(Path(__file__).parent / "types.idl"), at=names
    )
    found = {component.name: component for component in bridge.discover()}
    assert set(found) == {"Worker.rtc", "some.host_cxt/Odd.rtc"}
    worker = found["Worker.rtc"]
    parameters = "gain 0<=x<=150, mode (slow,quick), count, name"
    assert worker.detail == f"Uoarm, inactive, 1 execution context; parameters {parameters}"
    assert worker.rates == {}  # its execution context runs it when something happens
    by_port = {at.address[1]: (at.role, what) for at, what in worker.endpoints}
    assert set(by_port) == {"in", "out", "@lifecycle", "@configuration"}
    role, what = by_port["out"]
    assert role is Role.OUTPUT
    assert what.message is not None
    assert what.message.native_type == "IDL:RTC/TimedLong:1.0"
    assert "data type 'IDL:Odd/Mixed:1.0' is not known" in found["some.host_cxt/Odd.rtc"].detail
    for at, what in worker.endpoints:
        assert bridge.describe(at) == what
    odd.kill()
    found = {component.name: component for component in bridge.discover()}
    assert found["some.host_cxt/Odd.rtc"].detail == "dead"
    assert not found["some.host_cxt/Odd.rtc"].endpoints


@pytest.mark.parametrize("name", ["Kühler.rtc", "腕.host_cxt/カメラ.rtc", "Latin-é.rtc"])
def test_names_outside_ascii_are_readable(
    make_bridge: Make, peer: Start, names: str, name: str
) -> None:
    sent = name if name.startswith("Latin") else name.encode().decode("latin-1")  # as C++ does
    peer(sent, at=names)
    bridge = make_bridge(nameserver=names)
    assert [component.name for component in bridge.discover()] == [name]
    assert bridge.describe(endpoint(Role.OUTPUT, name, "out")).message is not None


def test_coming_leaving_and_dying_are_events(make_bridge: Make, peer: Start, names: str) -> None:
    bridge = make_bridge(nameserver=names)
    events = Inbox(bridge)
    checked(bridge)
    first = peer("First", at=names)
    assert events.event(Health.OK, "component First.rtc appeared").component == "First.rtc"
    second = peer("Second", at=names)
    events.event(Health.OK, "component Second.rtc appeared")
    first.end()
    assert events.event(Health.LOST, "component First.rtc left").component == "First.rtc"
    second.kill()
    events.event(Health.LOST, "component Second.rtc died")
    peer("Second", at=names)
    wait(lambda: str(events.messages).count("component Second.rtc appeared") == 2)


def test_components_in_a_context_that_is_gone_have_not_left(
    make_bridge: Make, peer: Start, names: str, orb: Orb
) -> None:
    import CosNaming

    bridge = make_bridge(nameserver=names)
    events = Inbox(bridge)
    with NameServer() as server:
        far = NamingService(orb, server.address, ANSWERS)._root()
        near = NamingService(orb, names, ANSWERS)._root()
        near.bind_context([CosNaming.NameComponent("far", "cxt")], far)
        first = peer("First", at=server.address)
        checked(bridge, "far.cxt/First.rtc")
    peer("Second", at=names)
    events.event(Health.OK, "component Second.rtc appeared")
    assert not [event for event in events.messages if "left" in event.cause]
    with pytest.raises(BridgeError, match="resolving ") as failed:
        bridge.describe(endpoint(Role.OUTPUT, "far.cxt/First.rtc", "out"))
    assert failed.value.reason is FailureReason.UNAVAILABLE
    first.kill()
    events.event(Health.LOST, "component far.cxt/First.rtc died")


def test_contexts_that_contain_each_other_end(names: str) -> None:
    orb = Orb("127.0.0.1", ANSWERS)
    try:
        service = NamingService(orb, names, ANSWERS)
        service.bind("a.cxt/b.cxt/Deep.rtc", orb.reference(corbaloc(names)))
        root = service._root()
        inner = service.resolve("a.cxt/b.cxt")
        import CosNaming

        inner.rebind_context([CosNaming.NameComponent("again", "cxt")], root)
        assert [name.path for name in service.names()] == ["a.cxt/b.cxt/Deep.rtc"]
    finally:
        orb.close()


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("localhost", "corbaloc:iiop:localhost:2809/NameService"),
        ("10.0.0.7:15005", "corbaloc:iiop:10.0.0.7:15005/NameService"),
        ("corbaloc::localhost:2809/NameService", "corbaloc::localhost:2809/NameService"),
    ],
)
def test_a_naming_service_may_be_written_shortly(written: str, meant: str) -> None:
    assert corbaloc(written) == meant


def test_tls_is_refused_by_name() -> None:
    with pytest.raises(BridgeError, match="GIOP over TLS"):
        Registry().create(
            BridgeSpec("rtm", "rtm", {"nameserver": "corbaloc:ssliop:a:2/NameService"})
        )


@pytest.mark.parametrize("options", [
    {"nameserver": "not a host"}, {"nameserver": []}, {"call_timeout": 0}, {"text": "ebcdic"},
    {"unknown": 1}, {"idl": "module {"},
], ids=str)  # fmt: skip
def test_wrong_options_of_a_bridge_are_refused(options: dict[str, Any]) -> None:
    held = _orb._shared.users
    with pytest.raises((BridgeError, ConfigurationError)):
        Registry().create(BridgeSpec("rtm", "rtm", options))
    assert _orb._shared.users == held


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"flow": "sideways"}, 'option $.flow: expected push or pull, got "sideways"'),
        ({"rate": -1}, "option $.rate: expected more than 0 Hz, got -1"),
        ({"activate": "yes"}, 'option $.activate: expected false, true or keep, got "yes"'),
        ({"properties": {"a": 1}}, "option $.properties.a: expected text, got 1"),
        ({"reset": True}, "reset means nothing without activate"),
        (
            {"properties": {"dataport.serializer.cdr.endian": "big"}},
            "properties must not hold dataport.serializer.cdr.endian: use endian",
        ),
        (
            {"properties": {"dataport.interface_type": "shared_memory"}},
            "interface type 'shared_memory' is not spoken here: only corba_cdr is",
        ),
        ({"qos": "auto"}, 'option $.qos: unknown key "qos" (known keys: flow, '),
        ({"endian": "middle"}, "option $.endian: expected little or big"),
    ],
    ids=str,
)
def test_wrong_options_of_an_endpoint_are_named(options: dict[str, Any], words: str) -> None:
    kind: BridgeType = Registry().types["rtm"]
    assert kind.check_endpoint is not None
    assert kind.check_endpoint(("A.rtc", "out"), {}) == ""
    with pytest.raises(ValueError, match=re.escape(words)):
        RtmEndpointOptions.of(options)


@pytest.mark.parametrize("address", [("self", "out"), ("A.rtc", "@lifecycle"), ("A.rtc", "")])
def test_wrong_addresses_are_named(bridge: Bridge, address: tuple[str, ...]) -> None:
    with pytest.raises(BridgeError, match="input 'default' of thing"):
        bridge.describe(endpoint(Role.INPUT, *address))


class EndlessContext:
    """A context of a naming service that makes new ones as it is asked, and holds nothing else."""

    made = 0

    def __init__(self) -> None:
        EndlessContext.made += 1

    def list(self, most: int) -> tuple[list[Any], None]:
        import CosNaming

        name = CosNaming.NameComponent
        kind = CosNaming.ncontext
        return [CosNaming.Binding([name(str(n), "")], kind) for n in range(min(3, most))], None

    def resolve(self, _: object) -> EndlessContext:
        return EndlessContext()

    def _is_equivalent(self, other: object) -> bool:
        return self is other


def test_contexts_that_are_always_new_come_to_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(NamingService, "_root", lambda _: EndlessContext())
    monkeypatch.setattr(_naming, "narrowed", lambda reference, *_: reference)
    orb = Orb("127.0.0.1", call_seconds=patience())  # without one, no call begins
    try:
        assert NamingService(orb, "127.0.0.1:1", patience()).names() == []
    finally:
        orb.close()
    assert EndlessContext.made < 5_000


@pytest.fixture
def orb() -> Iterator[Orb]:
    """The ORB, for what is served or called beside a bridge."""
    made = Orb("127.0.0.1", ANSWERS)
    yield made
    made.close()


def served_context(orb: Orb) -> str:
    """A naming service that always has more names, and gives none; its address."""
    import CosNaming
    import CosNaming__POA

    class Iterating(CosNaming__POA.BindingIterator):  # type: ignore[misc]
        def next_n(self, most: int) -> tuple[bool, list[Any]]:
            assert most
            return True, []

        def destroy(self) -> None:
            """Do nothing."""

    class Root(CosNaming__POA.NamingContext):  # type: ignore[misc]
        def list(self, most: int) -> tuple[list[Any], Any]:
            assert most
            return [], iterator

    iterator = orb.serve(Iterating())._narrow(CosNaming.BindingIterator)
    return orb.text(orb.serve(Root()))


def test_names_that_never_come_are_not_asked_for_again_and_again(orb: Orb) -> None:
    assert NamingService(orb, served_context(orb), ANSWERS).names() == []


def test_names_that_are_left_out_are_said_once(
    orb: Orb, names: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    service = NamingService(orb, names, ANSWERS)
    for number in range(4):
        service.bind(f"Part{number}.rtc", orb.reference(corbaloc(names)))
    monkeypatch.setattr(_naming, "_MOST_NAMES", 3)
    assert [len(service.names()) for _ in range(2)] == [3, 3]
    assert [record.message for record in caplog.records] == [
        f"naming service {names}: only 3 of its names are seen"
    ]


def test_a_naming_service_that_takes_its_time_for_each_name_has_a_limit(
    orb: Orb, names: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = NamingService(orb, names, ANSWERS)
    service.bind("a.cxt/b.cxt/Deep.rtc", orb.reference(corbaloc(names)))
    monkeypatch.setattr(_naming, "_MOST_SECONDS", 0.0)
    with pytest.raises(BridgeTimeoutError, match="listing its names takes longer than 0 s"):
        service.names()


def test_a_naming_service_that_ends_as_it_is_read_says_nothing_of_its_names(
    orb: Orb, monkeypatch: pytest.MonkeyPatch
) -> None:
    with NameServer() as server:
        service = NamingService(orb, server.address, ANSWERS)
        service.bind("a.cxt/Deep.rtc", orb.reference(corbaloc(server.address)))
        read, contexts = NamingService._bindings, list[Any]()

        def read_before_the_end(asked: NamingService, context: Any, *until: float) -> list[Any]:
            contexts.append(context)
            if len(contexts) == 2:
                server.process.kill()
                server.process.wait()
            found: list[Any] = read(asked, context, *until)
            return found

        monkeypatch.setattr(NamingService, "_bindings", read_before_the_end)
        with pytest.raises(BridgeError, match="the other side is gone"):
            service.names()


def test_the_plugin_imports_no_middleware() -> None:
    code = "import uoarm_rtm, sys; uoarm_rtm.uoarm_bridge_types(); print('omniORB' in sys.modules)"
    done = run_python("-c", code, check=True)
    assert done.stdout == "False\n"


def test_the_doctor_reports_what_is_installed() -> None:
    doctor = Registry().types["rtm"].doctor
    assert doctor is not None
    facts = doctor()
    assert facts["omniORBpy"].startswith("4.")
    assert facts["omniNames"].endswith("omniNames")


def test_outputs_of_a_component_that_runs_periodically_state_its_rate(
    make_bridge: Make, names: str
) -> None:
    orb = Orb("127.0.0.1", call_seconds=patience())
    component = RtComponent(orb, ComponentProfile("Steady"), rate=50.0, seconds=patience())
    try:
        component.add_out_port("out", "RTC::TimedLong", Types())
        component.bind([NamingService(orb, names, seconds=patience())])
        [steady] = make_bridge(nameserver=names).discover()
        assert steady.rates == {"out": 50.0}
    finally:
        component.close()
        orb.close()
