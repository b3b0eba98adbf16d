"""Foreign code may raise anything: what is no `Exception` is a failure of who raised it, too."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.manager import quitting

from uoarm import AsyncRobotManager, BridgeError, ResolutionError, RobotManager
from uoarm.config import loads
from uoarm.model import ComponentStatus, Health
from uoarm.testing import Collector, patience, wait

ROBOT = """
version: 1
failover: {{failing: {{messages: 3, seconds: 0}}}}
bridges:
  near: {{plugin: python, options: {{path: [{folder}]}}}}
  used:
    plugin: python
    options: {{path: [{folder}]}}
{host}
functions:
  ticks:
    components: [{{name: ticks, bridge: near, output: {{endpoint: ["quitting:ticks"]}}}}]
  stepped:
    components:
      - name: quits
        bridge: used
        priority: 2
        parameters: {{kind: {kind}}}
        input: {{from: ticks, endpoint: ["quitting:{part}"]}}
        output: {{endpoint: ["quitting:{part}"]}}
      - name: stays
        bridge: near
        input: {{from: ticks, endpoint: ["quitting:same"]}}
        output: {{endpoint: ["quitting:same"]}}
  sourced:
    components:
      - name: quits
        bridge: used
        priority: 2
        parameters: {{kind: {kind}, when: {when}}}
        output: {{endpoint: ["quitting:{part}"]}}
      - {{name: stays, bridge: near, output: {{endpoint: ["quitting:ticks"]}}}}
  answered:
    components:
      - name: quits
        bridge: used
        priority: 2
        parameters: {{kind: {kind}}}
        service: {{endpoint: ["quitting:{part}"]}}
      - {{name: stays, bridge: near, service: {{endpoint: ["quitting:same"]}}}}
"""
KINDS = {
    "exit": "SystemExit: 3",
    "cancelled": "CancelledError: it quits",
    "generator": "GeneratorExit: it quits",
    "interrupt": "KeyboardInterrupt: it quits",
    "own": "Own: it quits",
}
every_kind = pytest.mark.parametrize("kind", KINDS)
HOSTED = "    host: {}"


def everywhere(*parts: str) -> pytest.MarkDecorator:
    """Run with each of these components in this process, and with the first one in a host, too."""
    places = [pytest.param(part, "", id=f"{part}-here") for part in parts]
    hosted = pytest.param(parts[0], HOSTED, id=f"{parts[0]}-hosted")
    return pytest.mark.parametrize(("part", "host"), [*places, hosted])


def robot_of(function: str, part: str, kind: str, host: str, when: object = "") -> RobotManager:
    folder = Path(__file__).parent
    text = ROBOT.format(folder=folder, host=host, kind=kind, part=part, when=when)
    text = (
        text if kind else "\n".join(line for line in text.splitlines() if "parameters" not in line)
    )
    others = [name for name in ("stepped", "sourced", "answered") if name != function]
    return RobotManager(loads("\n".join(_without(text, others))))


def _without(text: str, functions: list[str]) -> Iterator[str]:
    """Yield the lines of a configuration but for those of some functions."""
    is_left_out = False
    for line in text.splitlines():
        if line.startswith("  ") and not line.startswith("   "):
            is_left_out = line.strip(" :") in functions
        if not is_left_out:
            yield line


def component(robot: RobotManager, name: str) -> ComponentStatus | None:
    return next((status for status in robot.status().components if status.name == name), None)


@everywhere("step", "async_step", "steps")
@every_kind
def test_a_step_that_quits_has_failed_and_the_next_candidate_takes_over(
    part: str, kind: str, host: str
) -> None:
    with robot_of("stepped", part, kind, host) as robot:
        events = Collector()
        robot.listen(events.deliver)
        with robot.request("stepped") as connection:
            connection.get(patience())
            wait(lambda: bool(connection.gaps))
            assert KINDS[kind] in connection.gaps[0].cause
            lost = "component quits", "lost"
            events.wait_for(
                lambda item: (item.subject, item.change) == lost and KINDS[kind] in item.cause
            )


@everywhere("source", "async_source")
@every_kind
def test_a_source_that_quits_is_lost_and_the_next_candidate_takes_over(
    part: str, kind: str, host: str, tmp_path: Path
) -> None:
    when = tmp_path / "now"
    with (
        robot_of("sourced", part, kind, host, when) as robot,
        robot.request("sourced") as connection,
    ):
        when.touch()
        wait(lambda: bool(connection.gaps))
        assert f"its source raised {KINDS[kind]}" in connection.gaps[0].cause
        assert connection.get(patience()) is not None


@everywhere("step", "async_step")
@every_kind
def test_a_service_that_quits_answers_its_caller_with_an_error_and_is_lost(
    part: str, kind: str, host: str
) -> None:
    with robot_of("answered", part, kind, host) as robot:
        for number in range(3):
            with pytest.raises(BridgeError) as caught:
                robot.call("answered", number, timeout=patience())
            assert KINDS[kind] in str(caught.value)
        found = component(robot, "quits")
        assert found is not None
        assert (found.health, found.failed) == (Health.LOST, 3)
        assert KINDS[kind] in found.last_error
        assert robot.call("answered", 7, timeout=patience()) == 7


@every_kind
def test_a_service_that_quits_answers_a_caller_in_an_event_loop(kind: str) -> None:
    async def call(robot: AsyncRobotManager) -> None:
        with pytest.raises(BridgeError) as caught:
            await robot.call("answered", 1, timeout=patience())
        assert KINDS[kind] in str(caught.value)
        await robot.close()

    asyncio.run(call(AsyncRobotManager(robot_of("answered", "step", kind, ""))))


@everywhere("Built")
@every_kind
def test_a_class_that_quits_when_it_is_made_is_one_that_cannot_be_opened(
    part: str, kind: str, host: str
) -> None:
    with robot_of("stepped", part, kind, host) as robot:
        with pytest.raises((BridgeError, ResolutionError)) as caught:
            robot.request("stepped")
        assert KINDS[kind] in str(caught.value)


@everywhere("Closed")
@every_kind
def test_a_class_that_quits_when_it_is_closed_is_closed(part: str, kind: str, host: str) -> None:
    with robot_of("stepped", part, kind, host) as robot:
        with robot.request("stepped") as connection:
            connection.get(patience())
        wait(lambda: component(robot, "quits") is None)
        with robot.request("stepped") as connection:
            connection.get(patience())


@everywhere("parent")
@every_kind
def test_a_task_that_a_component_left_behind_ends_nothing_when_it_quits(
    part: str, kind: str, host: str
) -> None:
    with robot_of("answered", part, kind, host) as robot:
        for number in range(5):
            assert robot.call("answered", number, timeout=patience()) == number


@every_kind
def test_a_callback_that_quits_is_named_and_gets_the_next_message(kind: str) -> None:
    given: list[int] = []

    def take(message: int) -> None:
        given.append(message)
        quitting.quit_with(kind)

    with (
        robot_of("answered", "same", kind, "") as robot,
        robot.request("ticks", on_message=take) as connection,
    ):
        wait(lambda: len(given) > 2)
        wait(lambda: dict(connection.routes()[0].dropped).get("failed", 0) > 2)
        assert f"take raised {KINDS[kind]}" in connection.routes()[0].last_error


@every_kind
def test_a_listener_that_quits_is_called_again_and_others_are_too(kind: str) -> None:
    events = Collector()

    def quit_then(event: object) -> None:
        quitting.quit_with(kind)

    with robot_of("answered", "same", kind, "") as robot:
        robot.listen(quit_then)
        robot.listen(events.deliver)
        for _ in range(2):
            robot.request("ticks").kill()
        events.wait_for(lambda item: (item.subject, item.change) == ("connection c2", "closed"))


@pytest.mark.parametrize("host", ["", HOSTED], ids=["here", "hosted"])
@pytest.mark.parametrize(("function", "part"), [("stepped", "wrong"), ("sourced", "wrongs")])
def test_what_gives_nothing_but_what_is_wrong_is_lost_and_the_next_candidate_takes_over(
    function: str, part: str, host: str
) -> None:
    with robot_of(function, part, "", host) as robot, robot.request(function) as connection:
        connection.get(patience())
        wait(lambda: bool(connection.gaps))
        assert "gives again and again what does not match its structure" in connection.gaps[0].cause


@pytest.mark.parametrize("host", ["", HOSTED], ids=["here", "hosted"])
def test_a_service_whose_every_reply_is_wrong_is_lost_and_the_next_one_is_called(
    host: str,
) -> None:
    with robot_of("answered", "wrong", "", host) as robot:
        for number in range(3):
            with pytest.raises(BridgeError, match="expected"):
                robot.call("answered", number, timeout=patience())
        found = component(robot, "quits")
        assert found is not None
        assert found.health is Health.LOST
        assert robot.call("answered", 7, timeout=patience()) == 7
