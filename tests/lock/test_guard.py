"""A robot held to its lock: what is described otherwise is reported, or passed over."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.lock.test_lock import COMPONENTS, HOT, ROBOT

from uoarm import RobotManager, errors
from uoarm.cli import main
from uoarm.config import loads

SPARE = """

def spare() -> Iterator[Annotated[Reading, {"x-type": "Reading"}]]:
    yield {"celsius": 21.0, "hot": False}
"""
SECOND = """
      - {name: spare, bridge: python, output: {endpoint: ["%s:spare"]}}
  fireAlarm:"""


def write(folder: Path, mode: str, *, unit: str = "Cel", module: str = "kitchen") -> Path:
    """Write a robot with a spare thermometer, which stands in a module of its own."""
    path = folder / "robot.yaml"
    text = COMPONENTS.format(unit=unit, more=HOT)
    (folder / f"{module}.py").write_text(text, encoding="utf-8")
    (folder / "shed.py").write_text(
        COMPONENTS.format(unit="Cel", more=HOT) + SPARE, encoding="utf-8"
    )
    robot = ROBOT.replace("kitchen", module).replace("\n  fireAlarm:", SECOND % "shed")
    path.write_text(f"{robot}lock: {mode}\n", encoding="utf-8")
    return path


def lock(path: Path) -> None:
    done = CliRunner().invoke(main, ["lock", "-f", str(path)])
    assert done.exit_code == 0, done.output
    name = "arm.conf.lock" if path.name == "arm.conf" else f"{path.stem}.lock"
    assert path.with_name(name).exists()


@pytest.fixture
def changed(tmp_path: Path) -> Path:
    """Return a robot that is held to its lock, whose thermometer speaks Fahrenheit since."""
    lock(write(tmp_path, "enforce"))
    return write(tmp_path, "enforce", unit="[degF]", module="newer")


def test_what_is_as_it_was_locked_is_used_and_nothing_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path, "enforce")
    lock(path)
    with RobotManager.from_file(path) as robot:
        assert robot.request("temperature").plan.provider.component.name == "thermometer"
        assert robot.status().lock == ()
    assert caplog.records == []


def test_enforced_another_structure_is_passed_over_for_a_candidate_that_was_locked(
    changed: Path,
) -> None:
    with RobotManager.from_file(changed) as robot:
        plan = robot.request("temperature").plan
        assert plan.provider.component.name == "spare"
        (report,) = robot.status().lock
        assert (report.component, report.port, report.refused) == (
            "thermometer",
            "output.default",
            True,
        )
        assert "thermometer.output.default has another structure than in the lock" in str(plan)


def test_enforced_a_request_without_another_candidate_is_refused(changed: Path) -> None:
    text = changed.read_text().replace(SECOND % "shed", "\n  fireAlarm:")
    changed.write_text(text, encoding="utf-8")
    with RobotManager.from_file(changed) as robot:
        for name in ("temperature", "fireAlarm"):
            with pytest.raises(errors.ResolutionError, match="another structure than in the lock"):
                robot.request(name)
        assert robot.connections() == ()


def test_a_component_that_the_lock_does_not_have_is_another(changed: Path) -> None:
    text = changed.read_text().replace("name: spare", "name: unknown_spare")
    changed.write_text(text, encoding="utf-8")
    with (
        RobotManager.from_file(changed) as robot,
        pytest.raises(errors.ResolutionError, match=r"unknown_spare.output.default is not in the"),
    ):
        robot.request("temperature")


def test_warned_of_another_structure_is_used_and_reported_once_and_counted(
    changed: Path, caplog: pytest.LogCaptureFixture
) -> None:
    changed.write_text(changed.read_text().replace("enforce", "warn"), encoding="utf-8")
    with RobotManager.from_file(changed) as robot:
        plan = robot.request("temperature").plan
        assert plan.provider.component.name == "thermometer"
        assert "note: thermometer.output.default has another structure than" in str(plan)
        robot.check_availability()  # asks anew
        (report,) = robot.status().lock
        assert not report.refused
        assert report.times > 1
        assert "thermometer" in str(robot.status())
    about = [record for record in caplog.records if "thermometer" in record.getMessage()]
    assert [record.levelno for record in about] == [logging.WARNING]


def test_a_lock_that_was_written_anew_holds_after_a_reload(changed: Path) -> None:
    with RobotManager.from_file(changed) as robot:
        assert robot.resolve("temperature").provider.component.name == "spare"
        lock(changed)  # which its own `lock: enforce` does not keep from it
        robot.reload()
        assert robot.resolve("temperature").provider.component.name == "thermometer"
        changed.write_text(changed.read_text().replace("lock: enforce", ""), encoding="utf-8")
        assert "~ lock" in robot.reload().differences


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, r"says `lock: enforce`, and there is no .*robot.lock: write it with `uoarm lock`"),
        ("{", r"robot.lock: expected a lock, as `uoarm lock` writes it, got what is no JSON"),
        ("{}", r"robot.lock: expected a lock, as `uoarm lock` writes it, got other JSON"),
    ],
)
def test_a_lock_that_cannot_be_read_is_an_error(
    tmp_path: Path, text: str | None, said: str
) -> None:
    path = write(tmp_path, "enforce")
    if text is not None:
        path.with_name("robot.lock").write_text(text)
    with pytest.raises(errors.ConfigurationError, match=said):
        RobotManager.from_file(path)
    done = CliRunner().invoke(main, ["resolve", "temperature", "-f", str(path)])
    assert done.exit_code == 3, done.output


def test_each_robot_of_a_folder_has_a_lock_of_its_own(tmp_path: Path) -> None:
    cart = write(tmp_path, "enforce").rename(tmp_path / "cart.yaml")
    lock(cart)
    arm = write(tmp_path, "enforce", unit="[degF]", module="newer").rename(tmp_path / "arm.conf")
    lock(arm)
    for path in (cart, arm):
        with RobotManager.from_file(path) as robot:
            assert robot.request("temperature").plan.provider.component.name == "thermometer"
            assert robot.status().lock == ()


def test_a_robot_of_no_file_has_no_lock_beside_it() -> None:
    with pytest.raises(errors.ConfigurationError, match="was not read from a file"):
        RobotManager(loads("version: 1\nbridges: {}\nfunctions: {}\nlock: warn\n"))
