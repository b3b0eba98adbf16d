"""What was recorded is held against the configuration of today."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from tests.record.conftest import COUNT

from uoarm import RobotManager
from uoarm.cli import main
from uoarm.config import loads
from uoarm.model import QueuePolicy
from uoarm.record import check_recording
from uoarm.record._reading import McapReader
from uoarm.testing import MemoryBridge

PARTS = """
from collections.abc import Iterator
from typing import Annotated, TypedDict

from uoarm.local import Range


class Count(TypedDict):
    n: int


class Small(TypedDict):
    amount: Annotated[int, Range(0, 99)]


def numbers() -> Iterator[Count]:
    yield {"n": 1}


def take(message: Count) -> Count:
    return message


def narrow(message: Small) -> Small:
    return message
"""
ROBOT = """
version: 1
bridges: {python: {}}
functions:
  counter: {components: [{name: numbers, bridge: python, output: {endpoint: ["parts:numbers"]}}]}
  same:
    components:
      - {name: taker, bridge: python, input: {from: counter, endpoint: ["parts:take"]},
         output: {endpoint: ["parts:take"]}}
  small:
    components:
      - name: narrower
        bridge: python
        input: {from: counter, endpoint: ["parts:narrow"], map: {amount: n}}
        output: {endpoint: ["parts:narrow"]}
"""
ALONE = ROBOT.partition("  same:")[0]


@pytest.fixture
def tape(bridge: MemoryBridge, make_robot: Any, tmp_path: Path) -> Path:
    clicks = bridge.emitter("clicks", COUNT)
    queue = QueuePolicy(length=1000, policy="block", timeout=600)
    (tmp_path / "parts.py").write_text(PARTS)
    with make_robot().record("counter", path=tmp_path / "run.mcap", queue=queue):
        for n in range(150):
            clicks.emit({"n": n})
    return tmp_path / "run.mcap"


def test_each_input_is_held_against_each_message(tape: Path) -> None:
    with RobotManager(loads(ROBOT, origin=str(tape.with_name("robot.yaml")))) as robot:
        result = check_recording(tape, robot)
    (channel,) = result.channels
    assert (channel.topic, channel.function, channel.messages) == ("/counter", "counter", 150)
    taker, narrower = channel.consumers
    assert (taker.place, taker.passed, taker.failed, taker.reasons) == (
        "taker.default", 150, 0, (),
    )  # fmt: skip
    assert (narrower.passed, narrower.failed) == (100, 50)
    assert narrower.reasons
    assert narrower.first is not None
    assert narrower.first.number == 101
    assert "amount" in narrower.first.cause
    assert not result.is_passed


def checked(tape: Path, robot: str, *more: str) -> tuple[int, str]:
    file = tape.with_name("robot.yaml")
    file.write_text(robot)
    done = CliRunner().invoke(main, ["check", "--recording", str(tape), str(file), *more])
    return done.exit_code, done.output


def test_the_command_says_it_with_its_exit_code(tape: Path) -> None:
    code, text = checked(tape, ROBOT)
    assert code == 1, text
    assert "taker.default: 150 fit, 0 do not" in text
    assert "first: message 101 of 2" in text
    code, text = checked(tape, ROBOT.partition("  small:")[0], "--json")
    assert code == 0, text
    data = json.loads(text)
    assert data["is_passed"] is True
    assert data["channels"][0]["consumers"][0]["passed"] == 150


def test_several_recordings_are_checked(tape: Path) -> None:
    good = tape.with_name("good.mcap")
    good.write_bytes(tape.read_bytes())
    more = ("--recording", str(good), "--json")
    code, text = checked(tape, ROBOT.partition("  small:")[0], *more)
    assert code == 0, text
    assert [Path(item["file"]).name for item in json.loads(text)] == [tape.name, "good.mcap"]
    broken = tape.with_name("broken.mcap")
    broken.write_bytes(tape.read_bytes()[:100])
    for order in ((tape, broken), (broken, tape)):
        code, text = checked(order[0], ALONE, "--recording", str(order[1]))
        assert code == 1, text
        assert "150 fit, 0 do not" in text
        assert "broken.mcap: nothing could be checked" in text


def test_strict_wants_all_channels_checked(
    tape: Path, bridge: MemoryBridge, make_robot: Any
) -> None:
    assert checked(tape, ALONE, "--strict")[0] == 0
    eye = bridge.emitter("eye", COUNT)
    both = tape.with_name("both.mcap")
    with make_robot().record("counter", "camera", path=both):
        eye.emit({"n": 1})
    code, text = checked(both, ALONE, "--json")
    assert (code, json.loads(text)["is_complete"]) == (0, False), text
    assert checked(both, ALONE, "--strict")[0] == 1
    done = CliRunner().invoke(main, ["check", "--strict", str(tape.with_name("robot.yaml"))])
    assert (done.exit_code, "no use for --strict" in done.stderr) == (2, True)


def test_what_feeds_nothing_is_held_against_its_provider(tape: Path) -> None:
    code, text = checked(tape, ALONE)
    assert (code, "numbers.default: 150 fit, 0 do not" in text) == (0, True), text


def test_what_cannot_be_checked_is_no_success(tape: Path) -> None:
    code, text = checked(tape, ALONE.replace("counter", "other"))
    assert code == 1, text
    assert "not checked: the configuration has no such function" in text
    code, text = checked(tape, ALONE.replace("parts:numbers", "gone:numbers"))
    assert (code, "not checked: " in text) == (1, True), text
    code, text = checked(tape.with_name("none.mcap"), ALONE)
    assert (code, "cannot be read: No such file" in text) == (4, True), text


@pytest.mark.parametrize("name", ["pipe.mcap", "pipe"])
def test_a_pipe_is_no_recording_and_is_not_waited_for(tape: Path, name: str) -> None:
    os.mkfifo(tape.with_name(name))
    code, text = checked(tape.with_name(name), ALONE)
    assert (code, f"{name} cannot be read: " in text) == (4, True), text


def test_what_cannot_be_read_is_no_success(tape: Path) -> None:
    part = McapReader(tape)._parts[0]
    octets = bytearray(tape.read_bytes())
    octets[part.at + part.octets // 2] ^= 0xFF
    tape.write_bytes(octets)
    code, text = checked(tape, ALONE)
    assert (code, "messages, 1 cannot be read: the chunk at" in text) == (1, True), text
