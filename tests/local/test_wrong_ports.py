"""Ports that a component's code cannot be: said by `uoarm check`, and before anything is opened."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from tests.local import talk

from uoarm import RobotManager
from uoarm.cli import main
from uoarm.config import loads
from uoarm.errors import ResolutionError
from uoarm.local import structure
from uoarm.model import Role
from uoarm.testing import patience

HERE = __name__
ROBOT = f"""\
version: 1
bridges: {{python: {{}}}}
functions:
  source:
    components:
      - {{name: numbers, bridge: python, output: {{endpoint: ["{HERE}:numbers"]}}}}
  wanted:
    components:
      - name: wrong
        bridge: python
"""
TRUE = "structure: true"


def numbers() -> Iterable[int]:
    return [1, 2]


def double(message: int) -> int:
    return 2 * message


@structure(input=True, output=True)
def ticks() -> Any:
    yield 0


def listed() -> list[int]:
    return [1, 2]


async def answered() -> int:
    return 1


async def several(message: int) -> AsyncIterator[int]:
    yield message


class Step:
    def __call__(self, message: int) -> int:
        return message

    def scaled(self, message: int, factor: int) -> int:
        return message * factor

    def reset(self) -> None:
        pass

    @staticmethod
    def still(message: int) -> int:
        return message

    @classmethod
    def whole(cls, message: int) -> int:
        return message

    @property
    def gain(self) -> int:
        return 1


class Still:
    @staticmethod
    def __call__(message: int) -> int:
        return message


class Source:
    def __iter__(self) -> Iterator[int]:
        yield 0


def lines(*ports: str) -> str:
    return ROBOT + "".join(f"        {port}\n" for port in ports)


def output(name: str, more: str = "") -> str:
    return f'output: {{endpoint: ["{HERE}:{name}"], {more}}}'


def taken(name: str, port: str = "", more: str = TRUE) -> str:
    written = f'{{from: source, endpoint: ["{HERE}:{name}"], {more}}}'
    return f"inputs: {{{port}: {written}}}" if port else f"input: {written}"


def service(name: str) -> str:
    return f'service: {{endpoint: ["{HERE}:{name}"], request: true, reply: true}}'


WRONG = [
    ([output("double")], "output", "the component has no input there: give it an `input`"),
    ([output("double", TRUE)], "output", "the component has no input there"),
    ([output("Step")], "output", "the component has no input there"),
    ([taken("Step"), output("double")], "output", "the component has no input there"),
    ([taken("ticks"), output("ticks")], "input", "ticks takes no message"),
    ([taken("Source"), output("Source")], "input", "no method '__call__' for the port 'default'"),
    ([taken("Step", "speed"), output("Step")], "inputs.speed", "no method 'speed' for the port"),
    ([taken("Step", "reset"), output("Step")], "inputs.reset", "takes no message"),
    ([taken("Step", "scaled"), output("Step")], "inputs.scaled", "nothing fills 'factor'"),
    (
        [taken("Step", "still"), output("Step")],
        "inputs.still",
        "still is of type staticmethod: a port",
    ),
    (
        [taken("Step", "whole"), output("Step")],
        "inputs.whole",
        "whole is of type classmethod: a port",
    ),
    (
        [taken("Step", "gain"), output("Step")],
        "inputs.gain",
        "gain is of type property: a port needs",
    ),
    ([service("Still")], "service", "__call__ is of type staticmethod: a port needs a method"),
    ([service("ticks")], "service", "ticks takes no message"),
    ([service("several")], "service", "it yields messages, and a service returns one reply"),
    ([output("answered", TRUE)], "output", "it takes no message and yields none"),
    ([output("listed")], "output", "it takes no message and returns list, not an Iterator"),
]


@pytest.mark.parametrize(("ports", "place", "expected"), WRONG)
def test_check_says_once_what_the_code_cannot_be(
    ports: list[str], place: str, expected: str, tmp_path: Path
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(lines(*ports), encoding="utf-8")
    done = CliRunner().invoke(main, ["check", str(file)])
    assert done.exit_code == 3, done.output
    assert f"functions.wanted.components[0].{place}.endpoint: " in done.output
    assert expected in done.output
    assert done.output.count("error: ") == 1, done.output


@pytest.mark.parametrize(("ports", "place", "expected"), WRONG)
def test_a_plan_has_no_port_that_the_code_cannot_be(
    ports: list[str], place: str, expected: str
) -> None:
    del place
    with (
        RobotManager(loads(lines(*ports))) as robot,
        pytest.raises(ResolutionError, match=expected),
    ):
        robot.resolve("wanted")


def test_a_source_may_return_what_is_iterated_over() -> None:
    with RobotManager(loads(lines(output("numbers")))) as robot, robot.request("wanted") as found:
        assert found.get(patience()) == 1


def test_a_generator_is_shown_as_no_service() -> None:
    with talk.bridge(discover=[f"{HERE}:several"]) as made:
        (shown,) = made.discover(timeout=patience())
    assert [end.role for end, _ in shown.endpoints] == [Role.INPUT, Role.OUTPUT]
