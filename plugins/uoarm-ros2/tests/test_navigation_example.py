"""The navigation example: two planners of which one goes, a vehicle in the place of the base."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest
from peers import own_line
from tests.harness._shared import made_once  # type: ignore[import-not-found]

from uoarm.testing import patience, wait

ROOT = Path(__file__).parents[3]
SOURCE = ROOT / "examples" / "navigation"
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def example(tmp_path: Path) -> Path:
    """The example's folder, as a copy."""
    copied: Path = shutil.copytree(SOURCE, tmp_path / "navigation")
    return copied


@pytest.fixture(scope="session")
def interfaces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the action's type, built and installed as the page says."""
    made: Path = made_once(tmp_path_factory, "interfaces", _build_and_install)
    return made / "target"


def _build_and_install(folder: Path) -> None:
    wheels, target = folder / "wheels", folder / "target"
    build = ["-m", "uoarm", "ros2", "build-interfaces", str(SOURCE / "interfaces")]
    subprocess.run([sys.executable, *build, "--output", str(wheels)], check=True)
    pip = ["-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", str(target)]
    subprocess.run([sys.executable, *pip, *map(str, wheels.glob("*.whl"))], check=True)


@pytest.fixture
def start(example: Path, interfaces: Path) -> Iterator[Start]:
    """Starts programs of the example, and ends them all."""
    started: list[subprocess.Popen[str]] = []

    def begin(program: str, *words: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, str(example / program), *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(interfaces), "PYTHONUNBUFFERED": "1"},
        )
        started.append(process)
        return process

    yield begin
    for process in reversed(started):
        assert process.stdin is not None
        process.stdin.close()  # the application's end; nodes are interrupted
        if "drive_to.py" not in str(process.args):
            process.terminate()
        process.wait(patience())
        assert process.stdout is not None
        process.stdout.close()


@pytest.fixture
def broker(example: Path, tmp_path: Path) -> Iterator[str]:
    """A Mosquitto, whose URL the example's files name."""
    sys.path.insert(0, str(ROOT / "plugins" / "uoarm-mqtt" / "tests"))
    with import_module("brokers").running(tmp_path / "mosquitto") as made:
        robot = example / "fleet.yaml"
        text = robot.read_text(encoding="utf-8")
        assert "mqtt://127.0.0.1:1883" in text
        robot.write_text(text.replace("mqtt://127.0.0.1:1883", made.url), encoding="utf-8")
        yield made.url


def line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return own_line(process.stdout).strip()


def ask(process: subprocess.Popen[str], words: str) -> None:
    assert process.stdin is not None
    process.stdin.write(f"{words}\n")
    process.stdin.flush()


def until_the_end(process: subprocess.Popen[str]) -> list[str]:
    """Return what is printed of a goal, its end last."""
    lines = [line(process)]
    while lines[-1] not in {"succeeded", "canceled", "aborted", "rejected", ""}:
        lines.append(line(process))
    return lines


_UNSEEN = """
import gc, signal, sys, threading
gc.disable()  # before 3.12 CPython may hang in a look at frames (its issue 106883)
sys.path.insert(0, sys.argv[1])
from drive_to import typed_lines

main = threading.get_ident()

def send():
    while sys._current_frames()[main].f_code is not typed_lines.__code__:
        pass
    print("sent", flush=True)
    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)  # ends no wait of the main thread

signal.signal(signal.SIGTERM, signal.default_int_handler)
lines = typed_lines()
print(next(lines), next(lines), flush=True)
threading.Thread(target=send).start()
try:
    next(lines)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


def test_a_signal_that_ends_no_read_is_noticed(example: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _UNSEEN, str(example)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            ask(process, " 3 4 \nwhere")
            assert line(process) == "3 4 where"
            assert line(process) == "sent"
            assert process.wait(patience()) == 0
            assert line(process) == "interrupted"
        finally:
            process.kill()


def test_another_planner_takes_over_and_a_goal_is_cancelled(start: Start) -> None:
    grid, straight = start("planner.py", "grid"), start("planner.py", "straight")
    base = start("base.py")
    assert line(grid) == "planning on /grid/plan"
    assert line(straight) == "planning on /straight/plan"
    assert line(base) == "driving on /navigate_to_pose"
    driver = start("drive_to.py")
    assert line(driver) == "where to?"
    for words in ("3", "3 four", "nan 0"):
        ask(driver, words)
        assert line(driver).startswith("expected two numbers")
    ask(driver, "3 4")
    there = until_the_end(driver)
    assert (there[0], there[1], there[-1]) == ("accepted", "7.0 m to go", "succeeded")

    def where() -> str:
        ask(driver, "where")
        return line(driver)

    wait(lambda: where() == "at 3.0 4.0, 21.0 m from a wall", "tf and the laser come")
    grid.terminate()
    grid.wait(patience())
    ask(driver, "0 0")
    back = until_the_end(driver)
    assert (back[0], back[1], back[-1]) == ("accepted", "5.0 m to go", "succeeded")
    ask(driver, "10000 0")
    assert line(driver) == "accepted"
    assert line(driver) == "10000.0 m to go"
    ask(driver, "cancel")
    assert until_the_end(driver)[-1] == "canceled"
    ask(driver, "10000 0")
    assert line(driver) == "accepted"
    driver.terminate()
    assert driver.wait(patience()) == 0
    driver = start("drive_to.py")  # each `where` waits for another scan
    assert line(driver) == "where to?"
    wait(lambda: len({where(), where(), where()}) == 1, "the base stands")
    ask(driver, "10000 0")
    assert line(driver) == "accepted"
    base.terminate()
    assert base.wait(patience()) == 0


def test_a_vehicle_of_another_standard_takes_over_and_the_base_after_it(
    broker: str, start: Start
) -> None:
    planner, base = start("planner.py", "straight"), start("base.py")
    vehicle = start("vehicle.py", broker)
    assert line(planner) == "planning on /straight/plan"
    assert line(base) == "driving on /navigate_to_pose"
    assert line(vehicle) == "waiting for orders"
    driver = start("drive_to.py")
    assert line(driver) == "where to?"
    ask(driver, "0 2")
    assert until_the_end(driver)[:2] == ["accepted", "2.0 m to go"]
    base.terminate()
    base.wait(patience())
    assert line(driver) == "driven by vehicle"
    ask(driver, "3 4")
    there = until_the_end(driver)
    assert (there[0], there[-1]) == ("accepted", "succeeded")
    assert all(words.endswith(" m to go") for words in there[1:-1])
    ask(driver, "10000 0")
    assert line(driver) == "accepted"
    assert line(driver).endswith(" m to go")
    ask(driver, "cancel")
    assert until_the_end(driver)[-1] == "canceled"
    again = start("base.py")
    assert line(again) == "driving on /navigate_to_pose"
    vehicle.terminate()
    vehicle.wait(patience())
    assert line(driver) == "driven by base"
    ask(driver, "0 1")
    assert until_the_end(driver)[0] == "accepted"
