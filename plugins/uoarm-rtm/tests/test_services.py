"""Services in both directions, lifecycle and configuration as calls, links, our own component."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from _uoarm_rtm_stubs import RTC
from attrs import evolve
from endpoints import HANGS_AFTER, Make, Start, checked, endpoint, sink, source, stamped
from jsonschema import Draft202012Validator
from peers import Peer
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm import _bridge, _services
from uoarm_rtm._orb import Orb, corba_errors
from uoarm_rtm._own_component import OwnComponent
from uoarm_rtm._peer import pairs
from uoarm_rtm._port_servant import PortServant
from uoarm_rtm._services import OperationCaller
from uoarm_rtm.component import ComponentProfile, RtComponent, Types
from uoarm_rtm.errors import IdlError

from uoarm import RobotManager
from uoarm.bridge import Bridge, Channel, ServiceStructures
from uoarm.config import loads
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, MessageStructure, Role
from uoarm.testing import Background, patience, wait

IDL = str(Path(__file__).parent / "service.idl")
MOVE = endpoint(Role.SERVICE, "Robot.rtc", "served", "Arm::Mover::move")
PUSH = {"dataport.interface_type": "corba_cdr", "dataport.dataflow_type": "push"}


def is_bound(bridge: Any, path: str) -> bool:
    return any(service.resolve(path) is not None for service in bridge._services)


@pytest.fixture
def robot(peer: Start) -> Peer:
    component = peer("Robot")
    component.provide(IDL, "Mover")
    return component


CALLED = """
version: 1
bridges: {rtm: {plugin: rtm}}
functions:
  move:
    components:
      - {name: arm, bridge: rtm, service: {endpoint: [Robot.rtc, served, "Arm::Mover::move"]}}
"""


def test_the_end_of_a_component_that_is_called_is_shown_until_it_is_there_again(
    make_bridge: Make, robot: Peer, peer: Start
) -> None:
    bridge = make_bridge(idl=IDL)
    checked(bridge, "Robot.rtc")
    with RobotManager(loads(CALLED), bridges={"rtm": bridge}) as manager:
        asked = {"target": {"x": 0.5, "y": 0.0}, "steps": 3}
        manager.call("move", asked, timeout=patience())
        assert manager.status().components == ()
        robot.kill()
        wait(lambda: manager.status().components)
        [arm] = manager.status().components
        assert (arm.name, arm.health) == ("arm", Health.LOST)
        assert arm.cause.startswith("component Robot.rtc died")
        peer("Robot").provide(IDL, "Mover")
        wait(lambda: not manager.status().components)
        manager.call("move", asked, timeout=patience())


def test_a_service_is_described_called_and_checked(make_bridge: Make, robot: Peer) -> None:
    bridge = make_bridge(idl=IDL)
    described = bridge.describe(MOVE)
    request = {"target": {"x": 0.5, "y": 0.0}, "steps": 3}
    assert described.request is not None
    assert described.reply is not None
    reply = bridge.call(MOVE, request)
    assert {**reply, "path": list(reply["path"])} == {"return": 0.5, "steps": 4, "path": [1.0]}
    Draft202012Validator(described.request.schema).validate(request)
    Draft202012Validator(described.reply.schema).validate({**reply, "path": [1.0]})
    with pytest.raises(MessageError, match=r"field 'steps': .* expected an integer"):
        bridge.call(MOVE, {**request, "steps": "3"})
    with pytest.raises(MessageError, match="expected an object with target, steps"):
        bridge.call(MOVE, {"target": {"x": 0.5, "y": 0.0}})


def test_a_declared_exception_comes_back_with_its_members(make_bridge: Make, robot: Peer) -> None:
    bridge = make_bridge(idl=IDL)
    with pytest.raises(IdlError, match="raised OutOfReach") as caught:
        bridge.call(MOVE, {"target": {"x": 2.0, "y": 0.0}, "steps": 0})
    assert caught.value.exception == "IDL:Arm/OutOfReach:1.0"
    assert caught.value.members == {"limit": 1.0, "why": "too far"}


def test_a_whole_interface_is_one_service_with_operations(make_bridge: Make, robot: Peer) -> None:
    bridge = make_bridge(idl=IDL)
    for at in (
        endpoint(Role.SERVICE, "Robot.rtc", "served"),
        endpoint(Role.SERVICE, "Robot.rtc", "served", "Mover"),
    ):
        described = bridge.describe(at)
        message = {"operation": "echo", "arguments": {"words": "grüezi €"}}
        assert described.request is not None
        Draft202012Validator(described.request.schema).validate(message)
        assert bridge.call(at, message) == {"return": "grüezi €"}
        with pytest.raises(BridgeError, match="any has no structure"):
            bridge.call(at, {"operation": "anything", "arguments": {}})
        with pytest.raises(BridgeError, match="has no operation 'jump'; it has move"):
            bridge.call(at, {"operation": "jump", "arguments": {}})


def test_services_are_discovered_with_their_structures(make_bridge: Make, robot: Peer) -> None:
    served = [("Robot.rtc", "served", "Mover")]
    for bridge, known in ((make_bridge(idl=IDL), True), (make_bridge("bare"), False)):
        found = {component.name: component for component in bridge.discover()}["Robot.rtc"]
        services = {at.address: what for at, what in found.endpoints if at.port == "served"}
        assert list(services) == served
        assert (services[served[0]].request is not None) is known
        assert ("interface 'Mover' is not known" in found.detail) is not known


def test_a_slow_or_failing_service_is_an_error_in_time(make_bridge: Make, robot: Peer) -> None:
    bridge = make_bridge(idl=IDL)
    slow = endpoint(Role.SERVICE, "Robot.rtc", "served", "Mover::sleep")
    with pytest.raises(BridgeTimeoutError):
        bridge.call(slow, {"seconds": patience()}, timeout=0.3)
    robot.wake()
    with pytest.raises(BridgeError, match="UNKNOWN"):
        bridge.call(endpoint(Role.SERVICE, "Robot.rtc", "served", "Mover::fail"), {})
    with pytest.raises(BridgeError, match=r"is not known \(the option `idl`"):
        bridge.describe(endpoint(Role.SERVICE, "Robot.rtc", "served", "Unknown"))


def test_a_component_that_is_busy_with_many_calls_does_not_hang(
    make_bridge: Make, robot: Peer
) -> None:
    bridge, events = make_bridge(idl=IDL, watch=0.1, call_timeout=HANGS_AFTER), Inbox()
    bridge.watch(events)
    robot.activate()
    channel = sink(bridge, endpoint(Role.INPUT, "Robot.rtc", "in"))
    sleep = endpoint(Role.SERVICE, "Robot.rtc", "served", "Mover::sleep", timeout=10 * patience())
    request = {"seconds": 10 * patience()}
    calling = [
        Background(lambda: bridge.call(sleep, request, timeout=10 * patience())) for _ in range(20)
    ]
    wait(lambda: robot.sleepers() == 20)  # omniORB has five connections to a server by itself
    channel.send(stamped(1))
    robot.deactivate()
    assert events.event(Health.DEGRADED, "is inactive").channel is channel
    assert [event.health for event in events.messages] == [Health.DEGRADED]
    robot.wake()
    for call in calling:
        call.result()


def test_each_call_has_the_limit_that_it_came_with(
    make_bridge: Make, robot: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge = make_bridge(idl=IDL)
    sleep = endpoint(Role.SERVICE, "Robot.rtc", "served", "Mover::sleep")
    assert bridge.call(sleep, {"seconds": 0.0}) == {}
    reached, go = threading.Event(), threading.Event()

    def first_waits(what: str) -> Any:
        if not reached.is_set():
            reached.set()
            assert go.wait(patience())
        return corba_errors(what)

    monkeypatch.setattr(_services, "corba_errors", first_waits)
    calling = Background(lambda: bridge.call(sleep, {"seconds": 0.5}))
    assert reached.wait(patience())
    with pytest.raises(BridgeTimeoutError):
        bridge.call(sleep, {"seconds": patience()}, timeout=0.1)
    go.set()
    assert calling.result() == {}
    robot.wake()


def test_a_service_that_came_back_is_reached_again(make_bridge: Make, peer: Start) -> None:
    bridge = make_bridge(idl=IDL)
    first = peer("Robot")
    first.provide(IDL, "Mover")
    echo = endpoint(Role.SERVICE, "Robot.rtc", "served", "Mover::echo")
    assert bridge.call(echo, {"words": "a"}) == {"return": "a"}
    first.kill()
    with pytest.raises(BridgeError) as caught:
        bridge.call(echo, {"words": "b"})
    assert caught.value.reason is FailureReason.UNAVAILABLE
    second = peer("Robot")
    second.provide(IDL, "Mover")
    assert bridge.call(echo, {"words": "c"}) == {"return": "c"}


def test_a_call_whose_connection_another_has_ended_makes_one_that_is_ended_too(
    make_bridge: Make, robot: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge, other = make_bridge(idl=IDL), make_bridge("other", idl=IDL)
    served = vars(other)["_directory"].peer("Robot.rtc").port("served").reference
    at = endpoint(Role.SERVICE, "Robot.rtc", "served", "Mover")
    echo = {"operation": "echo", "arguments": {"words": "b"}}
    found, go = threading.Event(), threading.Event()
    call = OperationCaller.call

    def late(caller: OperationCaller, *given: Any) -> Any:
        if not found.is_set():
            found.set()
            assert go.wait(patience())
        return call(caller, *given)

    assert bridge.call(at, echo) == {"return": "b"}
    monkeypatch.setattr(OperationCaller, "call", late)
    calling = Background(lambda: bridge.call(at, echo))
    assert found.wait(patience())
    with pytest.raises(BridgeError, match="UNKNOWN"):
        bridge.call(at, {"operation": "fail", "arguments": {}})
    assert served.get_connector_profiles() == []
    go.set()
    assert calling.result() == {"return": "b"}
    assert len(served.get_connector_profiles()) == 1
    bridge.close(timeout=patience())
    assert served.get_connector_profiles() == []


def test_a_service_port_of_ours_waits_for_other_ports_as_long_as_its_bridge(
    make_bridge: Make,
) -> None:
    bridge: Any = make_bridge(idl=IDL, call_timeout=7.5)
    bridge.serve(endpoint(Role.SERVICE, "self", "helper", "Mover::echo"), lambda message: message)
    (port,) = bridge._own.component.ports
    assert port._seconds == 7.5


def test_an_operation_with_a_wchar_is_refused(make_bridge: Make, tmp_path: Path) -> None:
    idl = tmp_path / "letters.idl"
    declared = "struct Pair { wchar one; wchar two; }; "
    operations = "void put(in Pair given); wchar get(in long place); wstring all(in wstring text);"
    idl.write_text(f"module Letters {{ {declared} interface Ask {{ {operations} }}; }};")
    bridge, caller = make_bridge(idl=str(idl)), make_bridge("other", idl=str(idl))

    def at(component: str, name: str) -> Endpoint:
        return endpoint(Role.SERVICE, component, name, f"Letters::Ask::{name}")

    for name in ("put", "get"):
        with pytest.raises(BridgeError, match=f"{name}: omniORB cannot read a wchar") as refused:
            bridge.serve(at("self", name), lambda message: message)
        assert refused.value.reason is FailureReason.UNSUPPORTED
    bridge.serve(at("self", "all"), lambda message: {"return": message["text"]})
    assert caller.call(at("uoarm_rtm.rtc", "all"), {"text": "h\u00e9\u8155"}) == {
        "return": "h\u00e9\u8155"
    }


def test_a_function_of_ours_serves_a_port_that_requires_it(make_bridge: Make, peer: Start) -> None:
    bridge = make_bridge(idl=IDL)
    component = peer("Needy")
    component.require(IDL, "Mover")
    at = endpoint(Role.SERVICE, "Needy.rtc", "wanted", "Mover::echo")
    channel = bridge.serve(at, lambda message: {"return": message["words"] + "!"})
    assert component.ask("echo", {"words": "hello"}) == {"return": "hello!"}
    channel.close()
    wanted = endpoint(Role.SERVICE, "Needy.rtc", "wanted")
    again = bridge.serve(wanted, lambda message: {"return": message["operation"]})
    assert component.ask("echo", {"words": "hello"}) == {"return": "echo"}
    again.close()


def test_a_step_that_goes_on_after_its_bridge_was_closed_leaves_nothing_behind(
    make_bridge: Make, robot: Peer
) -> None:
    """As a step does that is stalled while the bridge closes; the other one keeps the ORB."""
    bridge: Any = make_bridge(idl=IDL, component="Manager")
    other: Any = make_bridge("other", idl=IDL)
    served = other._directory.peer("Robot.rtc").port("served").reference
    echo = endpoint(Role.SERVICE, "Robot.rtc", "served", "Mover::echo")
    assert bridge.call(echo, {"words": "a"}) == {"return": "a"}
    (caller,) = bridge._callers.values()
    assert len(served.get_connector_profiles()) == 1
    bridge.close(timeout=patience())
    none, words = ServiceStructures(), {"words": "b"}
    said = endpoint(Role.INPUT, "self", "said", "RTC::TimedLong")
    steps: list[Callable[[], Any]] = [
        lambda: caller.call(words, patience(), "the limit"),
        lambda: bridge._call(echo, none, words, patience()),
        lambda: bridge._open_sink(said, MessageStructure({})),
    ]
    reasons = []
    for late in steps:
        try:
            reasons.append(late())
        except BridgeError as error:
            reasons.append(error.reason)
    assert reasons == [FailureReason.CLOSED] * 3
    assert served.get_connector_profiles() == []
    assert not is_bound(other, "Manager.rtc")


def test_a_name_that_was_unbound_while_closing_is_not_taken_for_forgotten(
    make_bridge: Make,
) -> None:
    bridge: Any = make_bridge(component="Manager")
    other: Any = make_bridge("other")
    sink(bridge, endpoint(Role.INPUT, "self", "said", "RTC::TimedLong"))
    own = bridge._own
    assert is_bound(other, "Manager.rtc")
    bridge.close(timeout=patience())
    own.tick()
    assert not is_bound(other, "Manager.rtc")


def test_a_component_of_ours_that_is_made_while_its_bridge_closes_is_removed(
    make_bridge: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge: Any = make_bridge(component="Manager")
    other: Any = make_bridge("other")
    made, go = threading.Event(), threading.Event()

    def slow(*words: Any) -> OwnComponent:
        own = OwnComponent(*words)
        made.set()
        assert go.wait(patience())
        return own

    monkeypatch.setattr(_bridge, "OwnComponent", slow)
    said = endpoint(Role.INPUT, "self", "said", "RTC::TimedLong")
    opening = Background(partial(bridge._open_sink, said, MessageStructure({})))
    try:
        assert made.wait(patience())
        assert is_bound(other, "Manager.rtc")
        # So long does closing wait, for what hangs here until it has closed.
        bridge._options = evolve(bridge._options, call_timeout=0.01)
        bridge.close(timeout=patience())
    finally:
        go.set()
    with pytest.raises(BridgeError) as refused:
        opening.result()
    assert refused.value.reason is FailureReason.CLOSED
    assert not is_bound(other, "Manager.rtc")


def test_lifecycle_as_calls(bridge: Bridge, peer: Start) -> None:
    component = peer("Worker")
    at = endpoint(Role.SERVICE, "Worker.rtc", "@lifecycle")

    def drive(action: str) -> Any:
        return bridge.call(at, {"action": action})["state"]

    assert drive("state") == "inactive"
    assert drive("activate") == "active"
    with pytest.raises(BridgeError, match="PRECONDITION_NOT_MET, being active"):
        drive("activate")
    component.abort()
    assert drive("state") == "error"
    assert drive("reset") == "inactive"
    component.fail("activated")
    with pytest.raises(BridgeError, match="it failed and is in error now"):
        drive("activate")
    assert drive("reset") == "inactive"
    assert component.calls() == [
        "activated", "aborting", "reset", "activated", "aborting", "reset",
    ]  # fmt: skip
    with pytest.raises(MessageError, match="expected one of activate"):
        drive("dance")


def test_an_endpoint_may_limit_its_calls(make_bridge: Make, robot: Peer) -> None:
    at = endpoint(Role.SERVICE, "Robot.rtc", "served", "Arm::Mover::sleep", timeout=0.2)
    with pytest.raises(BridgeTimeoutError, match=r"within 0.2 s, `timeout` of the endpoint"):
        make_bridge(idl=IDL).call(at, {"seconds": patience()})
    robot.wake()


def test_a_call_timeout_limits_operations_whose_endpoint_has_no_limit(
    make_bridge: Make, robot: Peer
) -> None:
    bridge: Any = make_bridge(idl=IDL, call_timeout=60)
    name = "Robot.rtc", "served", "Arm::Mover::sleep"
    at = endpoint(Role.SERVICE, *name, timeout=patience())
    assert bridge.call(at, {"seconds": 0.3}) == {}
    # Only now: it is that of connecting, too, which takes what it takes.
    bridge._options = evolve(bridge._options, call_timeout=0.2)
    assert bridge.call(at, {"seconds": 0.3}) == {}
    with pytest.raises(BridgeTimeoutError, match=r"within 0.2 s, `call_timeout` of the bridge"):
        bridge.call(endpoint(Role.SERVICE, *name), {"seconds": patience()})
    robot.wake()


def test_activated_on_request_and_deactivated_on_kill(bridge: Bridge, peer: Start) -> None:
    component = peer("Worker")
    one = sink(bridge, endpoint(Role.INPUT, "Worker.rtc", "in", activate=True))
    two = source(bridge, endpoint(Role.OUTPUT, "Worker.rtc", "out", activate=True), Inbox())
    one.close()
    assert component.calls() == ["activated"]
    two.close()
    assert component.calls() == ["activated", "deactivated"]
    bridge.call(endpoint(Role.SERVICE, "Worker.rtc", "@lifecycle"), {"action": "activate"})
    sink(bridge, endpoint(Role.INPUT, "Worker.rtc", "in", activate=True)).close()
    assert component.calls() == ["activated", "deactivated", "activated"]


def test_two_components_are_linked_directly(bridge: Bridge, peer: Start) -> None:
    talker, listener = peer("Talker"), peer("Listener")
    events = Inbox(bridge)
    out = endpoint(Role.OUTPUT, "Talker.rtc", "out")
    into = endpoint(Role.INPUT, "Listener.rtc", "in", activate=True)
    channel = bridge.link(out, into)
    assert channel is not None
    talker.count(0, 3)
    assert listener.received() == [{"tm": {"sec": n, "nsec": 0}, "data": n} for n in range(3)]
    channel.close()
    assert (talker.connectors(), listener.connectors()) == ([0, 0], [0, 0])
    again = bridge.link(out, into)
    talker.cut()  # which ends one port after the other: a check may come between them
    assert events.event(Health.LOST, "ended the connection").channel is again
    other = peer("Other", "IDL:RTC/TimedDouble:1.0")
    assert bridge.link(out, endpoint(Role.INPUT, "Other.rtc", "in")) is None
    assert other.connectors() == [0, 0]


def test_we_are_a_component_that_others_connect_to(
    make_bridge: Make, peer: Start, nameserver: str
) -> None:
    bridge = make_bridge(idl=IDL, component="Manager")
    talker = peer("Talker")
    inbox = Inbox()
    at = endpoint(Role.OUTPUT, "self", "received", "RTC::TimedLong")
    channel = source(bridge, at, inbox)
    assert talker.connect(nameserver, "Manager.rtc", "received", PUSH) == "RTC_OK"
    talker.count(0, 3)
    assert inbox.numbers() == [0, 1, 2]
    wrong = {**PUSH, "dataport.data_type": "IDL:RTC/TimedDouble:1.0"}
    assert talker.connect(nameserver, "Manager.rtc", "received", wrong) == "BAD_PARAMETER"
    assert talker.connect(nameserver, "Manager.rtc", "received", {}) == "BAD_PARAMETER"
    assert talker.connectors() == [0, 1]
    with pytest.raises(BridgeError, match="has a port 'received' already"):
        source(bridge, at, inbox)
    channel.close()
    assert talker.connectors() == [0, 0]


@pytest.mark.parametrize("role", [Role.OUTPUT, Role.INPUT, Role.SERVICE])
def test_of_ports_of_one_name_that_open_at_once_one_is_there(
    make_bridge: Make, role: Role, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge: Any = make_bridge(idl=IDL)
    component = bridge._own_component().component
    both, add = threading.Barrier(2), RtComponent.add_port
    ports: list[PortServant] = []

    def add_at_once(self: RtComponent, port: PortServant) -> None:
        ports.append(port)
        both.wait(patience())
        add(self, port)

    def begin() -> Channel:
        if role is Role.SERVICE:
            at = endpoint(role, "self", "ours", "Mover::echo")
            return bridge.serve(at, lambda message: message)  # type: ignore[no-any-return]
        at = endpoint(role, "self", "ours", "RTC::TimedLong")
        return source(bridge, at, Inbox()) if role is Role.OUTPUT else sink(bridge, at)

    monkeypatch.setattr(RtComponent, "add_port", add_at_once)
    opened, refused = [], []
    for opening in [Background(begin) for _ in range(2)]:
        try:
            opened.append(opening.result())
        except BridgeError as error:
            refused.append(str(error))
    assert (len(opened), len(refused)) == (1, 1)
    assert "has a port 'ours' already" in refused[0]
    (there,) = component.ports
    (other,) = (port for port in ports if port is not there)
    assert (there._is_closed, other._is_closed) == (False, True)
    opened[0].close()
    assert component.ports == ()


def test_an_in_port_of_ours_asks_those_who_wait_to_be_asked(
    make_bridge: Make, peer: Start, nameserver: str
) -> None:
    bridge = make_bridge(component="Manager")
    talker = peer("Talker")
    talker.mind_disconnecting()
    inbox = Inbox()
    at = endpoint(Role.OUTPUT, "self", "received", "RTC::TimedLong", rate=200)
    channel = source(bridge, at, inbox)
    pull = {
        **PUSH,
        "dataport.dataflow_type": "pull",
        "dataport.outport.buffer.read.empty_policy": "block",
    }
    assert talker.connect(nameserver, "Manager.rtc", "received", pull) == "RTC_OK"
    talker.count(0, 3)
    inbox.wait_for(3)
    talker.count(2, 3)
    inbox.wait_for(4)
    assert inbox.numbers() == [0, 1, 2, 2]
    wait(lambda: talker.asked() == 1)
    channel.close()
    assert talker.connectors() == [0, 0]
    assert talker.interrupted() == 0


def test_an_in_port_of_ours_that_is_notified_of_the_end_has_stopped_asking_when_it_answers(
    make_bridge: Make, peer: Start, nameserver: str
) -> None:
    bridge: Any = make_bridge(component="Manager")
    talker = peer("Talker")
    talker.mind_disconnecting()
    source(bridge, endpoint(Role.OUTPUT, "self", "received", "RTC::TimedLong", rate=200), Inbox())
    pull = {
        **PUSH,
        "dataport.dataflow_type": "pull",
        "dataport.outport.buffer.read.empty_policy": "block",
    }
    assert talker.connect(nameserver, "Manager.rtc", "received", pull) == "RTC_OK"
    port = bridge._directory.peer("Manager.rtc").port("received").reference
    (profile,) = port.get_connector_profiles()
    wait(lambda: talker.asked() == 1)
    port.notify_disconnect(profile.connector_id)
    assert talker.asked() == 0


def test_what_is_sent_while_an_out_port_of_ours_is_disconnected_leaves_no_end_behind(
    make_bridge: Make, peer: Start
) -> None:
    bridge: Any = make_bridge(component="Manager")
    listener = peer("Listener")
    into = sink(bridge, endpoint(Role.INPUT, "self", "said", "RTC::TimedLong"))
    port = bridge._own.component.ports[0]
    other = bridge._directory.peer("Listener.rtc").port("in").reference
    profile = RTC.ConnectorProfile("tool", "tool", [port.reference, other], pairs(PUSH))
    assert port.connect(profile)[0] == RTC.RTC_OK
    # What `disconnect` does first: the other port is notified next, and may take its time.
    port._quiesce("tool")
    into.send(stamped(1))
    assert port.disconnect("tool") == RTC.RTC_OK
    assert listener.connectors() == [0, 0]


@pytest.fixture
def own() -> Iterator[RtComponent]:
    orb = Orb("127.0.0.1", call_seconds=patience())
    component = RtComponent(orb, ComponentProfile("Own"), rate=1e-3, seconds=patience())
    yield component
    component.close()
    orb.close()


ENDS: dict[str, Callable[[Any], object]] = {
    "disconnected": lambda port: port.notify_disconnect("made"),
    "closed": lambda port: port.close(),
    "without a thread": lambda _: (_ for _ in ()).throw(RuntimeError("can't start new thread")),
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("flow", ["push", "pull"])
def test_a_connection_that_ends_while_it_is_made_leaves_nothing(
    own: RtComponent, monkeypatch: pytest.MonkeyPatch, flow: str, end: str
) -> None:
    out = own.add_out_port("out", "RTC::TimedLong", Types())
    into = own.add_in_port("in", "RTC::TimedLong", Types(), print, rate=1000.0)
    ports: list[Any] = [out, into] if flow == "push" else [into, out]
    subscribe = ports[0]._subscribe

    def late(profile: Any) -> None:
        ENDS[end](ports[0])
        subscribe(profile)

    properties = {**PUSH, "dataport.dataflow_type": flow, "dataport.subscription_type": "new"}
    references = [port.reference for port in ports]
    monkeypatch.setattr(ports[0], "_subscribe", late)
    profile = RTC.ConnectorProfile("made", "made", references, pairs(properties))
    assert ports[0].connect(profile)[0] == RTC.RTC_ERROR
    monkeypatch.undo()
    for port in ports:
        assert port.get_connector_profiles() == []
        assert not port._making
    assert (out._outlets, into._inlets, into._pullers) == ({}, {}, {})
    code, _ = ports[0].connect(RTC.ConnectorProfile("made", "made", references, pairs(properties)))
    assert (code == RTC.RTC_OK) is (end != "closed")


def test_a_context_has_each_rate_at_once_and_none_that_is_none(own: RtComponent) -> None:
    context = own._context
    for rate in (0.0, -1.0, 1e-300, 1e300, float("inf"), float("nan")):
        assert context.set_rate(rate) == RTC.BAD_PARAMETER
    steps: list[None] = []
    object.__setattr__(own.lifecycle._callbacks, "executed", lambda: steps.append(None))
    own.lifecycle.activate()
    assert context.set_rate(1000.0) == RTC.RTC_OK
    wait(lambda: len(steps) > 1)


def test_another_manager_uses_our_ports_as_those_of_any_component(make_bridge: Make) -> None:
    ours, theirs = make_bridge(idl=IDL, component="Manager"), make_bridge("other", idl=IDL)
    said = sink(ours, endpoint(Role.INPUT, "self", "said", "RTC::TimedLong"))
    echo = endpoint(Role.SERVICE, "self", "helper", "Mover::echo")
    ours.serve(echo, lambda message: {"return": message["words"].upper()})
    inbox = Inbox()
    source(theirs, endpoint(Role.OUTPUT, "Manager.rtc", "said"), inbox)
    said.send(stamped(7))
    inbox.wait_for(1)
    at = endpoint(Role.SERVICE, "Manager.rtc", "helper", "Mover::echo")
    assert theirs.call(at, {"words": "hi"}) == {"return": "HI"}
    names = [component.name for component in theirs.discover()]
    assert "Manager.rtc" in names
    ours.close()
    wait(lambda: "Manager.rtc" not in [component.name for component in theirs.discover()])
