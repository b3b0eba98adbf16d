"""Code of Python components read again while the manager runs, when that is asked."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from uoarm import RobotManager
from uoarm.errors import ConfigurationError
from uoarm.testing import patience

ROBOT = """
version: 1
bridges: {py: {plugin: python}, other: {plugin: python, options: {path: [.]}}}
functions:
  times:
    components:
      - {name: times, bridge: py, input: {endpoint: ["kitchen:Times"]},
         output: {endpoint: ["kitchen:Times"]}}
  ask: {components: [{name: ask, bridge: py, service: {endpoint: ["kitchen:ask"]}}]}
"""
KITCHEN = """
from spices import FACTOR

class Times:
    def __call__(self, value: int) -> int:
        return FACTOR * value

def ask(value: int) -> str:
    return f"{FACTOR} times {value}"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "kitchen.py").write_text(KITCHEN)
    (tmp_path / "spices.py").write_text("FACTOR = 2\n")
    return tmp_path


@pytest.fixture
def robot(folder: Path) -> Iterator[RobotManager]:
    with RobotManager.from_file(folder / "robot.yaml") as manager:
        yield manager


def test_the_new_code_takes_over_behind_the_handle_when_that_is_asked(
    robot: RobotManager, folder: Path
) -> None:
    connection = robot.request("times")
    connection.send(5)
    assert connection.get(patience()) == 10
    (folder / "spices.py").write_text("FACTOR = 3\n")  # within the second, and as long
    robot.reload()
    assert list(connection.gaps) == []
    shown = robot.reload(reload_code=True, dry_run=True)
    assert shown.differences == ("~ bridge py: its code", "~ bridge other: its code")
    assert [str(effect) for effect in shown.connections] == ["c1 (times) moves: times  to  times"]
    connection.send(5)
    assert connection.get(patience()) == 10
    robot.reload(reload_code=True)
    connection.send(5)
    assert connection.get(patience()) == 15
    assert robot.call("ask", 7) == "3 times 7"
    [gap] = connection.gaps
    assert gap.cause == "the configuration was changed"
    robot.reload()  # what runs goes on with its code, as does what an earlier revision says
    robot.rollback(0)
    assert len(connection.gaps) == 1
    assert robot.call("ask", 7) == "3 times 7"


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("FACTOR = 3 +\n", r"component 'times'.*invalid syntax"),
        ("raise OSError('no stove')\n", "component 'times'.*no stove"),
        ("MORE = 1\n", "component 'ask'.*FACTOR"),
    ],
)
def test_new_code_with_a_mistake_leaves_the_old_running_and_says_so(
    robot: RobotManager, folder: Path, code: str, text: str
) -> None:
    connection = robot.request("times")
    (folder / "spices.py").write_text(code)
    with pytest.raises(ConfigurationError, match=f"the code that runs goes on(.|\n)*{text}"):
        robot.reload(reload_code=True)
    connection.send(5)
    assert connection.get(patience()) == 10
    assert connection.gaps == ()
    assert robot.revision == 0
    assert robot.call("ask", 7) == "2 times 7"


def test_code_that_is_read_again_and_again_stays_nowhere(robot: RobotManager, folder: Path) -> None:
    robot.request("times")

    def kitchens() -> int:
        return sum(name.endswith(".kitchen") for name in sys.modules)

    robot.reload(reload_code=True)
    before = kitchens()
    for factor in range(3, 6):
        (folder / "spices.py").write_text(f"FACTOR = {factor}\n")
        robot.reload(reload_code=True)
    robot.reload(reload_code=True, dry_run=True)
    robot.close()  # what was replaced is closed by now
    assert kitchens() == before - 1


def test_a_parameter_of_the_new_code_is_taken_once_the_code_was_read(
    robot: RobotManager, folder: Path
) -> None:
    robot.call("ask", 1)
    more = KITCHEN.replace("def ask(value: int)", "def ask(value: int, pinch: int = 1)")
    (folder / "kitchen.py").write_text(more.replace("FACTOR} times", "FACTOR * pinch} times"))
    robot.reload(reload_code=True)
    parameters = "bridge: py, parameters: {pinch: 5}, service"
    (folder / "robot.yaml").write_text(ROBOT.replace("bridge: py, service", parameters))
    robot.reload()
    assert robot.call("ask", 1) == "10 times 1"
