"""Foreign code may raise anything: what is no `Exception` is a failure of who raised it, too."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.manager import quitting

from uoarm import AsyncRobotManager, BridgeError, RobotManager
from uoarm.config import loads
from uoarm.model import ComponentStatus, Health, StatusEvent
from uoarm.testing import Collector, patience, wait

ROBOT = """
version: 1
failover: {{failing: {{messages: 3, seconds: 0}}}}
bridges:
  near: {{plugin: python, options: {{path: [{folder}]}}}}
  used: {{plugin: python, options: {{path: [{folder}]}}{host}}}
functions:
  ticks:
    components: [{{name: ticks, bridge: near, output: {{endpoint: ["quitting:ticks"]}}}}]
"""
FUNCTIONS = {
    "stepped": """
  stepped_{kind}:
    components:
      - name: quits_{kind}
        bridge: used
        priority: 2
        parameters: {{{parameters}}}
        input: {{from: ticks, endpoint: ["quitting:{part}"]}}
        output: {{endpoint: ["quitting:{part}"]}}
      - name: stays_{kind}
        bridge: near
        input: {{from: ticks, endpoint: ["quitting:same"]}}
        output: {{endpoint: ["quitting:same"]}}
""",
    "sourced": """
  sourced_{kind}:
    components:
      - name: quits_{kind}
        bridge: used
        priority: 2
        parameters: {{{parameters}}}
        output: {{endpoint: ["quitting:{part}"]}}
      - {{name: stays_{kind}, bridge: near, output: {{endpoint: ["quitting:ticks"]}}}}
""",
    "answered": """
  answered_{kind}:
    components:
      - name: quits_{kind}
        bridge: used
        priority: 2
        parameters: {{{parameters}}}
        service: {{endpoint: ["quitting:{part}"]}}
      - {{name: stays_{kind}, bridge: near, service: {{endpoint: ["quitting:same"]}}}}
""",
}
KINDS = {
    "exit": "SystemExit: 3",
    "cancelled": "CancelledError: it quits",
    "generator": "GeneratorExit: it quits",
    "interrupt": "KeyboardInterrupt: it quits",
    "own": "Own: it quits",
}
every_kind = pytest.mark.parametrize("kind", KINDS)
HOSTED = ", host: {}"
NO_KIND = ("none",)
"""Of what does not quit."""


def everywhere(*parts: str) -> pytest.MarkDecorator:
    """Run with each of these components and each kind in this process, and with the first one and
    all kinds in a host."""
    places = [
        pytest.param(part, "", (kind,), id=f"{part}-here-{kind}")
        for part in parts
        for kind in KINDS
    ]
    hosted = pytest.param(parts[0], HOSTED, tuple(KINDS), id=f"{parts[0]}-hosted")
    return pytest.mark.parametrize(("part", "host", "kinds"), [*places, hosted])


def robot_of(
    function: str, part: str, kinds: tuple[str, ...], host: str, **more: object
) -> RobotManager:
    """Return a robot that has the function once for each kind."""
    text = ROBOT.format(folder=Path(__file__).parent, host=host)
    for kind in kinds:
        given = {"kind": kind, **more} if kind in KINDS else more
        parameters = ", ".join(f"{name}: {value}" for name, value in given.items())
        text += FUNCTIONS[function].format(kind=kind, part=part, parameters=parameters)
    return RobotManager(loads(text))


def component(robot: RobotManager, name: str) -> ComponentStatus | None:
    return next((status for status in robot.status().components if status.name == name), None)


def lost(kind: str) -> Callable[[StatusEvent], bool]:
    """Whether an event is the loss of what quits, for its own reason."""
    what = f"component quits_{kind}", "lost"
    return lambda item: (item.subject, item.change) == what and KINDS[kind] in item.cause


@everywhere("step", "async_step", "steps")
def test_a_step_that_quits_has_failed_and_the_next_candidate_takes_over(
    part: str, kinds: tuple[str, ...], host: str
) -> None:
    with robot_of("stepped", part, kinds, host) as robot:
        events = Collector()
        robot.listen(events.deliver)
        for kind in kinds:
            with robot.request(f"stepped_{kind}") as connection:
                connection.get(patience())
                wait(lambda: bool(connection.gaps))
                assert KINDS[kind] in connection.gaps[0].cause
                events.wait_for(lost(kind))


@everywhere("source", "async_source")
def test_a_source_that_quits_is_lost_and_the_next_candidate_takes_over(
    part: str, kinds: tuple[str, ...], host: str, tmp_path: Path
) -> None:
    when = tmp_path / "now"
    with robot_of("sourced", part, kinds, host, when=when) as robot:
        for kind in kinds:
            with robot.request(f"sourced_{kind}") as connection:
                when.touch()
                wait(lambda: bool(connection.gaps))
                assert f"its source raised {KINDS[kind]}" in connection.gaps[0].cause
                assert connection.get(patience()) is not None
            when.unlink()


@everywhere("step", "async_step")
def test_a_service_that_quits_answers_its_caller_with_an_error_and_is_lost(
    part: str, kinds: tuple[str, ...], host: str
) -> None:
    with robot_of("answered", part, kinds, host) as robot:
        for kind in kinds:
            for number in range(3):
                with pytest.raises(BridgeError) as caught:
                    robot.call(f"answered_{kind}", number, timeout=patience())
                assert KINDS[kind] in str(caught.value)
            found = component(robot, f"quits_{kind}")
            assert found is not None
            assert (found.health, found.failed) == (Health.LOST, 3)
            assert KINDS[kind] in found.last_error
            assert robot.call(f"answered_{kind}", 7, timeout=patience()) == 7


@every_kind
def test_a_service_that_quits_answers_a_caller_in_an_event_loop(kind: str) -> None:
    async def call(robot: AsyncRobotManager) -> None:
        with pytest.raises(BridgeError) as caught:
            await robot.call(f"answered_{kind}", 1, timeout=patience())
        assert KINDS[kind] in str(caught.value)
        await robot.close()

    asyncio.run(call(AsyncRobotManager(robot_of("answered", "step", (kind,), ""))))


@everywhere("Built")
def test_a_class_that_quits_when_it_is_made_cannot_be_opened_and_is_done_without(
    part: str, kinds: tuple[str, ...], host: str
) -> None:
    with robot_of("stepped", part, kinds, host) as robot:
        for kind in kinds:
            with robot.request(f"stepped_{kind}") as connection:
                assert connection.get(patience()) is not None
                assert connection.status().components[-1] == f"stays_{kind}"
                (gap,) = connection.gaps
                assert KINDS[kind] in gap.cause


@everywhere("Closed")
def test_a_class_that_quits_when_it_is_closed_is_closed(
    part: str, kinds: tuple[str, ...], host: str
) -> None:
    with robot_of("stepped", part, kinds, host) as robot:
        for kind in kinds:
            with robot.request(f"stepped_{kind}") as connection:
                connection.get(patience())
            wait(lambda: component(robot, f"quits_{kind}") is None)  # noqa: B023 - in this round
            with robot.request(f"stepped_{kind}") as connection:
                connection.get(patience())


@everywhere("parent")
def test_a_task_that_a_component_left_behind_ends_nothing_when_it_quits(
    part: str, kinds: tuple[str, ...], host: str
) -> None:
    with robot_of("answered", part, kinds, host) as robot:
        for kind in kinds:
            for number in range(5):
                assert robot.call(f"answered_{kind}", number, timeout=patience()) == number


@every_kind
def test_a_callback_that_quits_is_named_and_gets_the_next_message(kind: str) -> None:
    given: list[int] = []

    def take(message: int) -> None:
        given.append(message)
        quitting.quit_with(kind)

    with (
        robot_of("answered", "same", NO_KIND, "") as robot,
        robot.request("ticks", on_message=take) as connection,
    ):
        wait(lambda: len(given) > 2)
        wait(lambda: dict(connection.routes()[0].dropped).get("failed", 0) > 2)
        assert f"take raised {KINDS[kind]}" in connection.routes()[0].last_error


class Quits:
    """What quits whatever it is asked: called, or for its name."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def __call__(self, *_: object) -> Any:
        quitting.quit_with(self.kind)

    __repr__ = __getattr__ = __call__


@every_kind
def test_a_listener_that_quits_is_called_again_and_others_are_too(
    kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    events = Collector()
    with robot_of("answered", "same", NO_KIND, "") as robot:
        robot.listen(Quits(kind))
        robot.listen(events.deliver)
        for _ in range(2):
            robot.request("ticks").kill()
        events.wait_for(lambda item: (item.subject, item.change) == ("connection c2", "closed"))
        assert "listener Quits failed at event" in caplog.text


@every_kind
def test_a_callback_without_a_name_is_named_by_its_class(kind: str) -> None:
    with (
        robot_of("answered", "same", NO_KIND, "") as robot,
        robot.request("ticks", on_message=Quits(kind)) as connection,
    ):
        wait(lambda: bool(connection.routes()[0].last_error))
        assert f"Quits raised {KINDS[kind]}" in connection.routes()[0].last_error


@pytest.mark.parametrize("host", ["", HOSTED], ids=["here", "hosted"])
@pytest.mark.parametrize(("function", "part"), [("stepped", "wrong"), ("sourced", "wrongs")])
def test_what_gives_nothing_but_what_is_wrong_is_lost_and_the_next_candidate_takes_over(
    function: str, part: str, host: str
) -> None:
    with (
        robot_of(function, part, NO_KIND, host) as robot,
        robot.request(f"{function}_none") as connection,
    ):
        connection.get(patience())
        wait(lambda: bool(connection.gaps))
        assert "gives again and again what does not match its structure" in connection.gaps[0].cause


@pytest.mark.parametrize("host", ["", HOSTED], ids=["here", "hosted"])
def test_a_service_whose_every_reply_is_wrong_is_lost_and_the_next_one_is_called(
    host: str,
) -> None:
    with robot_of("answered", "wrong", NO_KIND, host) as robot:
        for number in range(3):
            with pytest.raises(BridgeError, match="expected"):
                robot.call("answered_none", number, timeout=patience())
        found = component(robot, "quits_none")
        assert found is not None
        assert found.health is Health.LOST
        assert robot.call("answered_none", 7, timeout=patience()) == 7
