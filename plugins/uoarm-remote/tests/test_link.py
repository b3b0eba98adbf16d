"""The link to another manager: what breaks it, what it lets through, and what it refuses."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import trustme
from attrs import evolve
from parts import stage
from robots import ROBOT, ServedRobot, here
from uoarm_remote import _link

from uoarm import QueuePolicy, RobotManager
from uoarm.bridge import Bridge, Registry
from uoarm.client import RemoteRobot
from uoarm.config import loads
from uoarm.errors import BridgeError, ConfigurationError, MessageError, ResolutionError
from uoarm.model import BridgeSpec, Endpoint, MessageStructure, Role
from uoarm.server import ServerOptions, hash_token, make_token, serve_in_thread
from uoarm.server.session import _native
from uoarm.testing import Background, Collector, MemoryBridge, Proxy, patience, wait

Desk = Callable[..., RobotManager]
TOKEN, OTHER = make_token(), make_token()
ACCESS = f"""
version: 1
roles:
  fleet: {{see: all, request: all, send: all, call: all, kill: all, stop: all, release: all}}
  other: {{see: [double], call: [double]}}
tokens:
  - {{name: desk, role: fleet, sha256: {hash_token(TOKEN)}}}
  - {{name: screen, role: other, sha256: {hash_token(OTHER)}}}
"""
DESK = """
version: 1
bridges: {{robot3: {{plugin: remote, options: {{url: "{url}", grace: {grace}{options}}}}}}}
functions:
  counter: {{components: [{{name: far_counter, bridge: robot3, output: {{endpoint: [counter]}}}}]}}
  drive: {{components: [{{name: far_base, bridge: robot3, input: {{endpoint: [drive]}}}}]}}
  double: {{components: [{{name: far_double, bridge: robot3, service: {{endpoint: [double]}}}}]}}
  length: {{components: [{{name: far_length, bridge: robot3, service: {{endpoint: [length]}}}}]}}
  hidden: {{components: [{{name: far_hidden, bridge: robot3, service: {{endpoint: [silent]}}}}]}}
"""


@pytest.fixture
def desk() -> Iterator[Desk]:
    with ExitStack() as stack:

        def make(url: str, options: str = "", grace: float | None = None) -> RobotManager:
            text = DESK.format(url=url, options=options, grace=grace or patience())
            return stack.enter_context(RobotManager(loads(text, origin=here("desk.yaml"))))

        yield make


@pytest.fixture
def proxy(robot: ServedRobot) -> Iterator[Proxy]:
    with Proxy(robot.port) as made:
        yield made


def facts_of(manager: RobotManager) -> dict[str, object]:
    return dict(manager.status().bridges[0].facts)


def can_call(manager: RobotManager) -> bool:
    with suppress(BridgeError, ResolutionError):
        return bool(manager.call("double", {"value": 2}) == {"value": 4})
    return False


def through(proxy: Proxy) -> str:
    return f"ws://127.0.0.1:{proxy.port}/"


def test_streams_commands_and_services_pass(robot: ServedRobot, desk: Desk) -> None:
    manager = desk(robot.url)
    with manager.request("counter") as counter:
        first = counter.get(patience())["value"]
        assert counter.get(patience())["value"] > first
    with manager.request("drive") as drive:
        drive.send({"speed": 0.5})
        wait(lambda: 0.5 in stage.taken, "the command did not arrive")
    assert manager.call("double", {"value": 21}) == {"value": 42}


def test_the_address_may_have_a_path_as_below_a_proxy(robot: ServedRobot, desk: Desk) -> None:
    manager = desk(f"{robot.url}uoarm")
    assert manager.call("double", {"value": 21}) == {"value": 42}


def test_a_message_that_is_longer_than_the_other_takes_ends_nothing_else(
    robot: ServedRobot, desk: Desk
) -> None:
    manager = desk(robot.url)
    with manager.request("counter") as counter:
        with pytest.raises(MessageError, match="the server takes 16,777,216 at most"):
            manager.call("length", "x" * 17_000_000)
        assert manager.call("length", "x" * 100_000) == {"value": 100_000}
        for _ in range(3):
            counter.get(patience())
        assert not counter.gaps
    assert facts_of(manager)["breaks"] == 0


def test_an_authority_that_was_renewed_is_trusted_from_the_next_connection_on(
    robot: ServedRobot, desk: Desk, tmp_path: Path
) -> None:
    certificate, trusted = tmp_path / "own.pem", tmp_path / "ca.pem"

    def renew() -> None:
        authority = trustme.CA()
        authority.cert_pem.write_to_path(trusted)
        issued = authority.issue_cert("127.0.0.1")
        issued.private_key_and_cert_chain_pem.write_to_path(certificate)

    renew()
    options = ServerOptions(port=0, certificate=certificate)
    with serve_in_thread(robot.manager, options) as server:
        port = server.ports[0]
        manager = desk(f"wss://127.0.0.1:{port}/", f", tls: {{ca: '{trusted}'}}")
        assert manager.call("double", {"value": 1}) == {"value": 2}
    renew()
    with serve_in_thread(robot.manager, evolve(options, port=port)):
        wait(lambda: can_call(manager), "the link is not made anew")


def test_a_link_that_ends_in_no_known_way_is_made_anew(
    robot: ServedRobot, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended, failures = RemoteRobot.ended, [AttributeError("call_soon")]

    async def failing_once(client: RemoteRobot) -> str:
        if failures:
            raise failures.pop()
        return await ended(client)

    monkeypatch.setattr(RemoteRobot, "ended", failing_once)
    manager = desk(robot.url)
    with suppress(BridgeError, ResolutionError):  # as it fails: nothing or the answer
        manager.call("double", {"value": 1})
    wait(lambda: not failures, "it did not fail")
    wait(lambda: can_call(manager), "the link is not made anew")


def test_a_kill_here_ends_there_what_only_this_used(robot: ServedRobot, desk: Desk) -> None:
    manager = desk(robot.url)
    with manager.request("counter") as counter:
        counter.get(patience())
        assert [entry.function for entry in robot.manager.status().connections] == ["counter"]
    wait(lambda: not robot.manager.status().connections, "the connection there is still open")


def test_what_is_closed_while_the_link_is_down_ends_there_once_it_is_up(
    robot: ServedRobot, proxy: Proxy, desk: Desk
) -> None:
    manager = desk(through(proxy))
    with manager.request("drive"), manager.request("counter") as counter:
        counter.get(patience())
        proxy.cut(admit=False)
        wait(lambda: facts_of(manager)["breaks"] == 1, "the break was not noticed")
        counter.kill()
        proxy.admit()
        wait(
            lambda: [entry.function for entry in robot.manager.status().connections] == ["drive"],
            "what was closed meanwhile is still open there",
        )


def test_what_was_closed_as_the_link_dropped_ends_there_and_opens_again(
    robot: ServedRobot, proxy: Proxy, desk: Desk
) -> None:
    manager = desk(through(proxy))
    with manager.request("drive"):
        with manager.request("counter") as counter:
            counter.get(patience())
            proxy.hold(to_server=True)
        proxy.cut()
        wait(lambda: facts_of(manager)["breaks"] == 1, "the break was not noticed")
        wait(lambda: answers(manager), "the link is not up again")
        with manager.request("counter") as counter:
            counter.get(patience())
    wait(lambda: not robot.manager.status().connections, "a connection there is still open")


def answers(manager: RobotManager) -> bool:
    try:
        return bool(manager.call("double", {"value": 1}))
    except (BridgeError, ResolutionError):
        return False


def test_what_moves_stops_there_when_the_link_is_cut(
    robot: ServedRobot, proxy: Proxy, desk: Desk
) -> None:
    manager = desk(through(proxy))
    with manager.request("drive") as drive:
        drive.send({"speed": 0.5})
        wait(lambda: stage.taken == [0.5], "the command did not arrive")
        proxy.cut(admit=False)
        wait(lambda: stage.taken[-1] == 0.0, "it was not stopped within its lifetime")


def test_a_command_that_was_not_answered_never_arrives(
    robot: ServedRobot, proxy: Proxy, desk: Desk
) -> None:
    manager = desk(through(proxy))
    with manager.request("drive") as drive:
        drive.send({"speed": 0.5})
        wait(lambda: stage.taken == [0.5], "the command did not arrive")
        proxy.hold(to_server=True)
        drive.send({"speed": 1.0})  # is taken by the queue here, and waits for its answer
        wait(
            lambda: facts_of(manager)["breaks"] == 1,
            "the link was not broken for the command that is too old",
        )
        with pytest.raises(AssertionError):  # never: it died with its connection
            wait(lambda: 1.0 in stage.taken, "", timeout=1.0)

        def drives_again() -> bool:
            drive.send({"speed": 0.25})
            return 0.25 in stage.taken

        wait(drives_again, "commands do not pass again")
        assert 1.0 not in stage.taken


def test_what_another_robot_gives_at_the_same_address_is_proven_again(desk: Desk) -> None:
    robot = ServedRobot()
    other = ROBOT
    for name, part in (("counter", "texts"), ("double", "twice"), ("drive", "drive")):
        other = other.replace(f'"parts:{name}"', f'"otherparts:{part}"')
    other = other.replace(", lifetime: 2.0, stop: {message: {speed: 0.0}}", "")
    try:
        manager = desk(robot.url)
        came: list[Any] = []
        with (
            manager.request("counter", on_message=came.append) as counter,
            manager.request("drive") as drive,
        ):
            wait(lambda: came, "nothing came")
            assert manager.call("double", {"value": 1}) == {"value": 2}
            robot.close()
            robot = ServedRobot(other, port=robot.port)
            for connection in (counter, drive):
                wait(lambda: connection.state.value == "failed", "it was not proven again")  # noqa: B023
                assert "has begun anew: its structure is another: the message: the field" in (
                    connection.cause
                )
        assert not [message for message in came if "text" in message]
        wait(lambda: doubles(manager), "what is called is not proven again")
    finally:
        robot.close()


def test_a_service_that_is_another_there_by_now_is_described_again(desk: Desk) -> None:
    robot = ServedRobot()
    try:
        manager = desk(robot.url)
        assert manager.call("double", {"value": 1}) == {"value": 2}
        other = ROBOT.replace('"parts:double"', '"otherparts:twice"')
        robot.manager.apply(loads(other, origin=here()))
        with pytest.raises(MessageError, match="the field 'text' is missing"):
            manager.call("double", {"value": 1})
        wait(lambda: doubles(manager), "it is not described again")
    finally:
        robot.close()


def doubles(manager: RobotManager) -> bool:
    try:
        return bool(manager.call("double", {"text": "a"}) == {"text": "aa"})
    except (BridgeError, MessageError, ResolutionError):
        return False


def test_what_is_lost_in_a_cut_is_counted(robot: ServedRobot, proxy: Proxy, desk: Desk) -> None:
    manager = desk(through(proxy))
    with manager.request("counter", queue=QueuePolicy(100_000)) as counter:
        numbers = [counter.get(patience())["value"]]
        proxy.cut()
        while len(numbers) < 2 or numbers[-1] == numbers[-2] + 1:
            numbers.append(counter.get(patience())["value"])
            if len(numbers) > 50:
                break
        [component] = manager.status().components
        facts = dict(component.channels[0].facts)
        missing = numbers[-1] - numbers[0] + 1 - len(numbers)
        assert int(str(facts["lost_on_link"])) >= missing
        assert facts["gaps"] == 0  # the same session, so that it is known what was lost


def test_a_dead_link_is_reported_with_the_manager_and_the_cause(
    robot: ServedRobot, proxy: Proxy, desk: Desk
) -> None:
    manager = desk(through(proxy), grace=0.2)
    with manager.request("counter") as counter:
        counter.get(patience())
        proxy.cut(admit=False)
        wait(lambda: counter.state.value in {"failed", "closed"}, "the loss was not noticed")
        assert "disconnected: counter of the manager at" in counter.cause


def test_the_status_says_that_the_manager_is_gone_where_nothing_is_open(
    robot: ServedRobot, proxy: Proxy, desk: Desk
) -> None:
    manager = desk(through(proxy))
    manager.call("double", {"value": 1})

    def bridge() -> tuple[str, str]:
        status = next(entry for entry in manager.status().bridges if entry.name == "robot3")
        return status.health.value, status.cause

    assert bridge() == ("ok", "")
    proxy.cut(admit=False)
    wait(lambda: bridge()[0] == "degraded", "the break was not reported")
    assert bridge()[1].startswith("the manager at ws://127.0.0.1:")
    proxy.admit()
    wait(lambda: bridge()[0] == "ok", "the end of the break was not reported")


def test_a_call_to_a_manager_that_is_gone_ends_with_its_grace(proxy: Proxy, desk: Desk) -> None:
    manager = desk(through(proxy), grace=0.2)
    calling = Background(partial(manager.call, "hidden", {"value": 1}))
    wait(stage.silent.is_set, "the call did not arrive")
    proxy.cut(admit=False)
    with pytest.raises(BridgeError, match="the link broke before the answer"):
        calling.result()


def test_a_call_that_is_cancelled_here_waits_no_longer(robot: ServedRobot) -> None:
    silent = Endpoint("far", "silent", Role.SERVICE, ("silent",))
    bridge = Registry().create(BridgeSpec("far", "remote", {"url": robot.url}))
    with closing(bridge):
        calling = Background(lambda: bridge.call(silent, {"value": 1}, number=7))
        wait(stage.silent.is_set, "the call did not arrive")
        bridge.cancel_call(7)
        with pytest.raises(BridgeError, match="Call silent was cancelled"):
            calling.result()


def test_where_something_died_is_said_in_one_sentence(robot: ServedRobot, desk: Desk) -> None:
    text = DESK.replace("[counter]", "[first]").format(url=robot.url, options="", grace=60)
    with (
        RobotManager(loads(text, origin=here("desk.yaml"))) as manager,
        manager.request("counter") as connection,
    ):
        assert connection.get(patience()) == {"value": 1}
        stage.ends["first"].set()
        wait(lambda: connection.state.value == "failed", "the death there was not noticed")
        assert "peer: first of the manager at" in connection.cause
        assert "first was unplugged" in connection.cause


def test_a_token_is_read_from_a_file_and_shown(tmp_path: Path, desk: Desk) -> None:
    access, token = tmp_path / "access.yaml", tmp_path / "token"
    access.write_text(ACCESS, encoding="utf-8")
    token.write_text(f"{TOKEN}\n", encoding="utf-8")
    exported = ROBOT.replace('{local: ["*"]}', "{fleet: [counter, double], other: [double]}")
    robot = ServedRobot(exported, access)
    try:
        manager = desk(robot.url, f', token_file: "{token}"')
        assert manager.call("double", {"value": 2}) == {"value": 4}
        with pytest.raises(ResolutionError, match="export") as caught:
            manager.call("hidden", {"value": 2})
        assert TOKEN not in str(caught.value)
        wrong = tmp_path / "wrong"
        wrong.write_text(make_token(), encoding="utf-8")
        refused = desk(robot.url, f', token_file: "{wrong}"')
        with pytest.raises(
            ResolutionError, match=r"does not take the token.* \(HTTP 401: this server needs a"
        ):
            refused.call("double", {"value": 2})
        absent = desk(robot.url, f', token_file: "{tmp_path / "none"}"')
        with pytest.raises(ResolutionError, match=r"token file .* cannot be read"):
            absent.call("double", {"value": 2})
    finally:
        robot.close()


def test_what_is_not_exported_and_what_is_not_there_look_alike(tmp_path: Path) -> None:
    access, token = tmp_path / "access.yaml", tmp_path / "token"
    access.write_text(ACCESS, encoding="utf-8")
    token.write_text(OTHER, encoding="utf-8")
    robot = ServedRobot(ROBOT.replace('{local: ["*"]}', "{other: [double]}"), access)
    texts = set()
    try:
        for name in ("counter", "counte", "nowhere"):
            text = DESK.replace("[counter]", f"[{name}]").format(
                url=robot.url, grace=5, options=f', token_file: "{token}", discover: true'
            )
            with RobotManager(loads(text, origin=here("desk.yaml"))) as manager:
                with pytest.raises(ResolutionError) as caught:
                    manager.request("counter")
                texts.add(str(caught.value).split("export")[1].replace(name, "X"))
                [found] = [item for item in manager.discover() if item.bridge == "robot3"]
                assert [component.name for component in found.components] == ["double"]
    finally:
        robot.close()
    (said,) = texts
    assert "did you mean" not in said


def test_what_cannot_be_had_there_is_listed_without_ports(tmp_path: Path) -> None:
    """Whatever their number: they are asked for some at a time."""
    lines = [
        f"  more{number}: {{components: [{{name: more{number}, bridge: python, "
        f'output: {{endpoint: ["parts:{name}"]}}}}]}}\n'
        for number, name in enumerate(["counter"] * 19 + ["nothing"])
    ]
    robot = ServedRobot(ROBOT + "".join(lines))
    bridge = Registry().create(
        BridgeSpec("far", "remote", {"url": robot.url, "discover": True, "timeout": patience()})
    )
    try:
        found = {item.name: item for item in bridge.discover()}
        assert len(found) == len(robot.manager.config.functions)
        assert not found["more19"].endpoints
        assert [endpoint.address for endpoint, _ in found["more7"].endpoints] == [("more7",)]
    finally:
        bridge.close()
        robot.close()


def test_a_manager_that_lists_nothing_is_seen_only_where_it_is_reached() -> None:
    robot = ServedRobot(ROBOT)
    options = {"url": robot.url, "timeout": patience()}
    near, away = (Registry().create(BridgeSpec("far", "remote", options)) for _ in range(2))
    try:
        assert near.discover() == ()
        robot.close()
        with pytest.raises(BridgeError, match="not reached: nothing listens there"):
            away.discover()
    finally:
        near.close()
        away.close()
        robot.close()


def test_a_manager_that_imports_itself_is_refused(desk: Desk) -> None:
    robot = ServedRobot(ROBOT)
    text = ROBOT.replace(
        "bridges: {python: {}}",
        f'bridges: {{python: {{}}, self: {{plugin: remote, options: {{url: "{robot.url}"}}}}}}',
    )
    text += "  again: {components: [{name: again, bridge: self, service: {endpoint: [double]}}]}\n"
    try:
        robot.manager.apply(loads(text, origin=here()))
        with pytest.raises(ResolutionError, match="a loop through managers"):
            robot.manager.call("again", {"value": 1})
    finally:
        robot.close()


def test_a_way_round_is_refused_and_shown() -> None:
    """A asks B, which asks A: by their identities, whatever their addresses."""
    first = ServedRobot(ROBOT)
    imports = """
version: 1
bridges: {{far: {{plugin: remote, options: {{url: "{url}"}}}}}}
export: {{local: ["*"]}}
functions:
  {own}:
    components: [{{name: {own}_far, bridge: far, service: {{endpoint: [{other}]}}}}]
"""
    second = ServedRobot(imports.format(url=first.url, own="there", other="back"))
    try:
        text = imports.format(url=second.url, own="back", other="there")
        first.manager.apply(loads(text, origin=here()), force=True)
        with pytest.raises(ResolutionError, match="a loop through managers"):
            first.manager.call("back", {"value": 1})
    finally:
        second.close()
        first.close()


def test_a_chain_of_three_managers(robot: ServedRobot) -> None:
    between = """
version: 1
bridges: {{far: {{plugin: remote, options: {{url: "{url}"}}}}}}
export: {{local: ["*"]}}
failover: {{enabled: false}}
functions:
  first: {{components: [{{name: first_{name}, bridge: far, output: {{endpoint: [first]}}}}]}}
  drive: {{components: [{{name: drive_{name}, bridge: far, input: {{endpoint: [drive]}}}}]}}
  double: {{components: [{{name: double_{name}, bridge: far, service: {{endpoint: [double]}}}}]}}
"""
    middle = ServedRobot(between.format(url=robot.url, name="middle"))
    last = ServedRobot(between.format(url=middle.url, name="last"))
    try:
        assert last.manager.call("double", {"value": 8}) == {"value": 16}
        plan = str(last.manager.resolve("first"))
        assert f"{middle.manager.identity}, then {robot.manager.identity}" in plan
        with last.manager.request("drive") as drive:
            drive.send({"speed": 0.75})
            wait(lambda: 0.75 in stage.taken, "the command did not come through")
            wait(lambda: stage.taken[-1] == 0.0, "it was not stopped at the end of its lifetime")
        with last.manager.request("first") as connection:
            assert connection.get(patience()) == {"value": 1}
            stage.ends["first"].set()
            wait(lambda: connection.state.value == "failed", "the death was not noticed")
            for url in (middle.url, robot.url):
                assert url in connection.cause
            assert "first was unplugged" in connection.cause
    finally:
        last.close()
        middle.close()


def test_what_is_refused_there_once_it_was_taken_is_counted_there(desk: Desk) -> None:
    """The answer comes when a command waits there: a page says what that is worth."""
    limits = "lifetime: 2.0, limits: {speed: {maximum: 1}}"
    robot = ServedRobot(ROBOT.replace("lifetime: 2.0", limits))
    try:
        manager = desk(robot.url)
        with manager.request("drive") as drive:
            drive.send({"speed": 5.0})
            assert drive.flush(patience())
            assert [route.dropped for route in manager.status().routes] == [()]
            there = robot.manager.status
            wait(lambda: there().routes[0].dropped == (("beyond-limits", 1),), "it was not refused")
    finally:
        robot.close()


def test_an_emergency_stop_there_is_a_refusal_here(robot: ServedRobot, desk: Desk) -> None:
    manager = desk(robot.url)
    with manager.request("drive") as drive:
        drive.send({"speed": 0.5})
        wait(lambda: stage.taken == [0.5], "the command did not arrive")
        robot.manager.stop_all()
        drive.send({"speed": 0.75})
        drive.flush(patience())
        status = manager.status()
        assert dict(status.routes[0].dropped) == {"held": 1}
        assert status.components[0].health.value == "ok"
        assert status.bridges[0].process is None  # the other one may be on any machine
        assert 0.75 not in stage.taken
        robot.manager.release()


def test_an_emergency_stop_here_stops_there_what_others_move(tmp_path: Path, desk: Desk) -> None:
    access, token = tmp_path / "access.yaml", tmp_path / "token"
    access.write_text(ACCESS, encoding="utf-8")
    token.write_text(TOKEN, encoding="utf-8")
    robot = ServedRobot(ROBOT.replace('{local: ["*"]}', "{fleet: [double, drive]}"), access)
    try:
        manager = desk(robot.url, f', token_file: "{token}"')
        manager.call("double", {"value": 1})
        with robot.manager.request("drive") as own:  # of another application, there
            own.send({"speed": 0.5})
            wait(lambda: stage.taken == [0.5], "the command did not arrive")
            report = manager.stop_all()
            assert stage.taken[-1] == 0.0
            assert [(item.component, item.stopped) for item in report.inputs] == [
                ("robot3/base", True)
            ]
            assert robot.manager.status().held is not None
            manager.release()
            assert robot.manager.status().held is None
            robot.stop()
            wait(lambda: int(str(facts_of(manager)["breaks"])) == 1, "the break was not noticed")
            report = manager.stop_all()
            (missed,) = report.inputs
            assert not report.stopped
            assert missed.component == "robot3"
            assert "it is not reached" in missed.cause
    finally:
        robot.close()


def test_who_has_no_right_to_stop_there_stops_only_here(tmp_path: Path, desk: Desk) -> None:
    access, token = tmp_path / "access.yaml", tmp_path / "token"
    access.write_text(ACCESS, encoding="utf-8")
    token.write_text(OTHER, encoding="utf-8")
    robot = ServedRobot(ROBOT.replace('{local: ["*"]}', "{other: [double]}"), access)
    try:
        manager = desk(robot.url, f', token_file: "{token}"')
        manager.call("double", {"value": 1})
        report = manager.stop_all()
        assert report.stopped
        assert not report.inputs
        assert not robot.manager.is_stopped
    finally:
        robot.close()


MEMORY = """
version: 1
bridges: {memory: {plugin: python}}
export: {local: ["*"]}
functions: {map: {components: [{name: map, bridge: memory, output: {endpoint: [map]}}]}}
"""
FAR_MAP = Endpoint("far", "map", Role.OUTPUT, ("map",))


@pytest.fixture
def memory() -> MemoryBridge:
    return MemoryBridge()


@pytest.fixture
def far(memory: MemoryBridge) -> Iterator[Callable[[], Bridge]]:
    """Make bridges to a manager whose `map` is an emitter of the memory bridge."""
    with ExitStack() as stack:

        def make() -> Bridge:
            manager = RobotManager(loads(MEMORY), registry=Registry(()), bridges={"memory": memory})
            options = ServerOptions(port=0)
            server = stack.enter_context(serve_in_thread(stack.enter_context(manager), options))
            url = f"ws://127.0.0.1:{server.ports[0]}/"
            bridge = Registry().create(BridgeSpec("far", "remote", {"url": url}))
            stack.callback(bridge.close)
            return bridge

        yield make


def test_what_stands_there_is_given_to_each_that_joins_here(
    memory: MemoryBridge, far: Callable[[], Bridge]
) -> None:
    latched = memory.emitter("map", {}, latched=True)
    latched.emit("old")
    bridge, structure = far(), MessageStructure(schema=True)
    first, second = Collector(), Collector()
    with closing(bridge.open_source(FAR_MAP, structure, first.deliver)) as source:
        assert source.latched
        assert first.wait(1) == ["old"]
        latched.emit("new")
        assert first.wait(2) == ["old", "new"]
        with closing(bridge.open_source(FAR_MAP, structure, second.deliver)):
            second.wait_for(lambda message: message == "new")
            latched.emit("newer")
            second.wait_for(lambda message: message == "newer")
        assert first.wait(3) == ["old", "new", "newer"]


def test_what_waits_for_a_consumer_is_bounded_in_octets(
    memory: MemoryBridge, far: Callable[[], Bridge]
) -> None:
    emitter, collector = memory.emitter("map", {}), Collector()
    bridge = far()
    endpoint = evolve(FAR_MAP, options={"backlog_bytes": 1000})
    with closing(
        bridge.open_source(endpoint, MessageStructure(schema=True), collector.deliver)
    ) as source:
        with collector.held():
            emitter.emit(0)
            collector.wait_begun(1)
            for number in range(1, 10):
                emitter.emit(f"{number}" * 1000)
            wait(lambda: source.facts()["lost_on_link"] == 8, "they were not dropped")
        assert collector.wait(2) == [0, "9" * 1000]


def test_the_status_shows_the_other_manager_and_its_clock(robot: ServedRobot, desk: Desk) -> None:
    manager = desk(robot.url)
    assert manager.call("double", {"value": 1}) == {"value": 2}
    facts = facts_of(manager)
    assert facts["manager"] == robot.manager.identity
    assert abs(float(str(facts["clock_ahead"]))) < patience()
    json.dumps(dict(facts))


class SetClock:
    """The module `time` in which the time of day can be set."""

    def __init__(self) -> None:
        self.ahead = 0.0

    def __getattr__(self, name: str) -> object:
        return getattr(time, name)

    def time(self) -> float:
        return time.time() + self.ahead


def test_a_clock_that_is_set_on_either_side_is_measured_again(
    robot: ServedRobot, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = SetClock(), SetClock()
    monkeypatch.setattr(_link, "time", ours)
    monkeypatch.setattr(_native, "time", theirs)
    manager = desk(robot.url)
    assert manager.call("double", {"value": 1}) == {"value": 2}

    def ahead() -> int:
        return round(float(str(facts_of(manager)["clock_ahead"])) / 10_000)

    assert ahead() == 0
    ours.ahead = 20_000.0
    assert ahead() == -2
    monkeypatch.setattr(_link, "_CLOCK_SECONDS", 0.0)
    theirs.ahead = 50_000.0
    wait(lambda: ahead() == 3, "their clock is measured again")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ('url: "http://robot3/"', "wss"),
        ('url: "ws://robot3/", fingerprint: "00"', "fingerprint"),
        ('url: "ws://robot3:9080/", tls: {ca: x.pem}', "wss://"),
        ('ulr: "ws://robot3/"', "did you mean"),
    ],
)
def test_options_are_checked_without_a_connection(options: str, said: str) -> None:
    bridge = f"{{plugin: remote, options: {{{options}}}}}"
    text = f"version: 1\nbridges: {{far: {bridge}}}\nfunctions: {{}}\n"
    with pytest.raises(ConfigurationError, match=said):
        loads(text, types=Registry().types)


def test_closing_leaves_no_thread(robot: ServedRobot, desk: Desk) -> None:
    with desk(robot.url) as manager, manager.request("counter") as counter:
        counter.get(patience())
    wait(
        lambda: not [item for item in threading.enumerate() if "uoarm-remote" in item.name],
        "a thread is left over",
    )


def test_a_peer_that_is_not_there_is_named(desk: Desk) -> None:
    with ExitStack() as stack:
        robot = ServedRobot()
        stack.callback(robot.close)
        robot.stop()
        with pytest.raises(ResolutionError, match=r"the manager at ws://127.0.0.1:\d+/: it is not"):
            desk(robot.url).request("counter")
