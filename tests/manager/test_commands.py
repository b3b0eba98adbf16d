"""Inputs that move something, through a manager: proven, counted, and stopped in order."""

from __future__ import annotations

import json

import pytest

from uoarm import RobotManager
from uoarm.bridge import Registry, Sink
from uoarm.bridge._watchdog import Watchdog
from uoarm.config import loads
from uoarm.errors import ResolutionError
from uoarm.model import CommandPhase, CommandStatus, Endpoint, MessageStructure
from uoarm.testing import MemoryBridge, wait

SPEED = {
    "type": "object",
    "properties": {"v": {"type": "number", "x-unit": "m/s"}, "note": {"type": "string"}},
    "required": ["v"],
}
STOP, GO = {"v": 0.0}, {"v": 0.5}


def robot(memory: MemoryBridge, settings: str, expect: str = "") -> RobotManager:
    """Return a manager of a planner, which a test plays where it needs one, and of a base."""
    text = f"""
version: 1
bridges: {{memory: {{plugin: python}}}}
functions:
  plan: {{components: [{{name: planner, bridge: memory, output: {{endpoint: [planner]{expect}}}}}]}}
  drive: {{components: [{{name: base, bridge: memory, input: {{endpoint: [base], {settings}}}}}]}}
"""
    return RobotManager(loads(text), registry=Registry(()), bridges={"memory": memory})


@pytest.fixture
def memory() -> MemoryBridge:
    return MemoryBridge(links=True)


def status(manager: RobotManager) -> CommandStatus:
    (channel,) = (
        channel_status
        for component in manager.status().components
        for channel_status in component.channels
        if channel_status.command
    )
    assert channel.command is not None
    return channel.command


def test_what_an_application_sends_expires_and_is_counted(memory: MemoryBridge) -> None:
    base = memory.taker("base", SPEED)
    settings = "lifetime: 0.1, stop: {message: {v: 0.0}}, limits: {v: {maximum: 1}}"
    with robot(memory, settings) as manager:
        drive = manager.request("drive")
        drive.send(GO)
        wait(lambda: status(manager).phase is CommandPhase.STOPPED)
        assert base.taken.messages == [GO, STOP]
        drive.send({"v": 1.5})
        (route,) = drive.routes()
        assert dict(route.dropped) == {"beyond-limits": 1}
        assert "v is 1.5, more than 1" in route.last_error
        assert dict(status(manager).dropped) == {"beyond-limits": 1}
        (component,) = manager.status().components
        assert component.failed == 0, "who refuses a command has not failed"


def test_the_stop_is_taken_before_the_connection_has_ended(memory: MemoryBridge) -> None:
    base = memory.taker("base", SPEED)
    with robot(memory, "lifetime: 3600, stop: {message: {v: 0.0}}") as manager:
        drive = manager.request("drive")
        drive.send(GO)
        drive.kill()
        assert base.taken.messages == [GO, STOP]


def test_no_native_link_goes_past_the_watchdog(memory: MemoryBridge) -> None:
    planner = memory.emitter("planner", SPEED)
    base = memory.taker("base", SPEED)
    # Declared alike: what has two structures is never linked.
    structure = f"structure: {json.dumps(SPEED)}"
    settings = f"from: plan, {structure}, lifetime: 0.1, stop: {{message: {{v: 0.0}}}}"
    with robot(memory, settings, f", {structure}") as manager:
        manager.request("drive")
        planner.emit(GO)
        wait(lambda: base.taken.messages == [GO, STOP])
        (route,) = manager.status().routes
        assert not route.native


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ("stop: {message: {w: 0.0}}", "the stop message of its input 'default': .*'v' is missing"),
        ("stop: {message: {v: nothing}}", "the stop message of its input 'default': v: "),
        ("limits: {w: {maximum: 1}}", "limits of its input 'default': w: there is no field 'w'"),
        ("limits: {note: {maximum: 1}}", "limits of its input 'default': note is no number"),
    ],
)
def test_what_cannot_stop_or_be_limited_is_no_candidate(
    memory: MemoryBridge, settings: str, text: str
) -> None:
    memory.taker("base", SPEED)
    with robot(memory, settings) as manager, pytest.raises(ResolutionError, match=text):
        manager.request("drive")


@pytest.mark.parametrize(
    ("unit", "more", "text"),
    [
        ({}, "", None),
        ({}, ", meaning: stated", "rests on shape alone: v"),
        ({"x-unit": "m/s"}, "", "strict: both sides state what every number means"),
    ],
)
def test_what_moves_is_fed_only_what_says_what_it_means(
    memory: MemoryBridge, unit: dict[str, str], more: str, text: str | None
) -> None:
    fields = {"v": {"type": "number", **unit}, "note": {"type": "string"}}
    memory.emitter("planner", {**SPEED, "properties": fields})
    memory.taker("base", SPEED)
    settings = f"from: plan, lifetime: 0.1, stop: {{message: {{v: 0.0}}}}{more}"
    with robot(memory, settings) as manager:
        if text is None:
            with pytest.raises(ResolutionError, match="v: not both sides say what it means"):
                manager.resolve("drive")
        else:
            assert text in str(manager.resolve("drive"))


def test_a_lifetime_shorter_than_the_senders_period_is_warned_of_with_both(
    memory: MemoryBridge,
) -> None:
    memory.emitter("planner", SPEED)
    memory.taker("base", SPEED)
    settings = "from: plan, lifetime: 0.1, stop: {message: {v: 0.0}}"
    with robot(memory, settings, ", expect: {rate: 5}") as manager:
        (warning,) = manager.resolve("drive").warnings
        assert "commands live for 0.1 s, and the next one comes after 0.2 s" in warning


class Kept(MemoryBridge):
    """Knows the inputs that were opened."""

    def __init__(self) -> None:
        super().__init__()
        self.sinks: list[Sink] = []

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        self.sinks.append(super()._open_sink(endpoint, structure))
        return self.sinks[-1]


INPUT = "{endpoint: [base], lifetime: 3600, stop: {message: {v: 0.0}}}"
MOVING = f"""
version: 1
bridges: {{memory: {{plugin: python}}}}
functions:
  drive:
    components:
      - {{name: base, bridge: memory, inputs: {{left: {INPUT}, right: {INPUT}, lift: {INPUT}}}}}
  grip: {{components: [{{name: arm, bridge: memory, inputs: {{arm: {INPUT}}}}}]}}
"""


@pytest.mark.parametrize("end", ["connection", "bridge", "manager"])
def test_no_stop_waits_for_another_input(end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is given time for a component that hangs: all have their stop before one is closed."""
    memory, moving = Kept(), list[set[str]]()
    memory.taker("base", SPEED)
    close = Watchdog.close

    def look_and_close(watchdog: Watchdog) -> bool:
        commands = {sink.endpoint.port: sink.command_status() for sink in memory.sinks}
        moving.append({port for port, command in commands.items() if is_moving(command)})
        return close(watchdog)

    monkeypatch.setattr(Watchdog, "close", look_and_close)
    with RobotManager(loads(MOVING), registry=Registry(()), bridges={"memory": memory}) as manager:
        drive, grip = manager.request("drive"), manager.request("grip")
        for port in ("left", "right", "lift"):
            drive.send(GO, port)
        grip.send(GO, "arm")
        wait(lambda: all(is_moving(sink.command_status()) for sink in memory.sinks))
        {"connection": drive.kill, "bridge": memory.close, "manager": manager.close}[end]()
        assert moving[0] == ({"arm"} if end == "connection" else set())


def is_moving(command: CommandStatus | None) -> bool:
    return command is not None and command.phase is CommandPhase.MOVING
