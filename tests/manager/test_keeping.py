"""A change from outside is written to the file when that is asked, and never over another's."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from attrs import evolve
from tests.disk import full_after

from uoarm import RobotManager
from uoarm.bridge import BridgeType, Registry
from uoarm.config import load, loads
from uoarm.errors import BridgeTimeoutError, ConfigurationError, UsageError
from uoarm.model import Options
from uoarm.testing import MemoryBridge

ROBOT = """\
version: 1
bridges: {lab: {plugin: memory}}
functions:
  # the good one
  camera:
    components:
      - {name: best, bridge: lab, output: {endpoint: [best]}}
"""
MORE = "  lamp: {components: [{name: light, bridge: lab, output: {endpoint: [light]}}]}\n"
WITH_LAMP = ROBOT.replace("  # the good one\n", "") + MORE


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT, encoding="utf-8")
    path.chmod(0o640)
    return path


@pytest.fixture
def robot(file: Path) -> Iterator[RobotManager]:
    with RobotManager(load(file), bridges={"lab": MemoryBridge("lab", {})}) as manager:
        yield manager


def test_only_when_it_is_asked_and_with_the_comments_of_the_file(
    robot: RobotManager, file: Path
) -> None:
    robot.apply(loads(WITH_LAMP, str(file)))
    assert file.read_text(encoding="utf-8") == ROBOT
    assert not robot.apply(loads(WITH_LAMP, str(file)), keep=True, dry_run=True).is_kept
    assert file.read_text(encoding="utf-8") == ROBOT

    change = robot.apply(loads(WITH_LAMP, str(file)), keep=True)
    assert (change.is_applied, change.is_kept) == (True, True)
    assert str(change).startswith("revision 2, applied and kept")
    assert file.read_text(encoding="utf-8") == ROBOT + MORE == robot.config.text
    assert file.stat().st_mode & 0o777 == 0o640
    assert list(file.parent.iterdir()) == [file]

    assert robot.rollback(0, keep=True).is_kept
    assert file.read_text(encoding="utf-8") == ROBOT


def test_what_another_program_wrote_is_never_lost(robot: RobotManager, file: Path) -> None:
    theirs = ROBOT.replace("name: best", "name: other")
    file.write_text(theirs, encoding="utf-8")
    with pytest.raises(UsageError, match="was changed since it was read: reload it"):
        robot.apply(loads(WITH_LAMP, str(file)), keep=True)
    assert (file.read_text(encoding="utf-8"), robot.revision) == (theirs, 0)

    robot.reload()
    robot.apply(loads(theirs + MORE, str(file)), keep=True)
    assert file.read_text(encoding="utf-8") == theirs + MORE


def test_what_another_program_writes_while_it_changes_stands(
    robot: RobotManager, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    adopt = robot._revisions.adopt

    def adopt_late(number: int) -> None:
        file.write_text("# theirs\n" + ROBOT, encoding="utf-8")
        adopt(number)

    monkeypatch.setattr(robot._revisions, "adopt", adopt_late)
    with pytest.raises(UsageError, match="the change is in force, but not kept"):
        robot.apply(loads(WITH_LAMP, str(file)), keep=True)
    assert file.read_text(encoding="utf-8").startswith("# theirs")
    assert "lamp" in robot.config.functions
    assert list(file.parent.iterdir()) == [file]


@pytest.fixture
def meanwhile(
    robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Callable[[], object]], None]:
    """Have something done as the configuration changes, before the file is put in its place."""
    adopt = robot._revisions.adopt

    def do(what: Callable[[], object]) -> None:
        monkeypatch.setattr(robot._revisions, "adopt", lambda number: (what(), adopt(number)))

    return do


def test_who_reads_the_file_reads_the_whole_of_one_or_the_other(
    robot: RobotManager, file: Path
) -> None:
    with file.open(encoding="utf-8") as reader:
        half = reader.readline()
        robot.apply(loads(WITH_LAMP, str(file)), keep=True)
        assert half + reader.read() == ROBOT


def test_no_other_program_reads_it_before_it_is_in_its_place(
    robot: RobotManager, file: Path, meanwhile: Callable[[Callable[[], object]], None]
) -> None:
    file.chmod(0o600)
    part = file.with_name(f".{file.name}.{os.getpid()}")
    part.write_text("of a process that was killed", encoding="utf-8")
    part.chmod(0o644)
    modes: list[int] = []
    meanwhile(lambda: modes.extend(path.stat().st_mode & 0o777 for path in file.parent.iterdir()))
    assert robot.apply(loads(WITH_LAMP, str(file)), keep=True).is_kept
    assert modes == [0o600, 0o600]


def test_a_link_stays_a_link_and_a_byte_order_mark_is_no_change(tmp_path: Path) -> None:
    real, link = tmp_path / "real.yaml", tmp_path / "robot.yaml"
    real.write_text(ROBOT, encoding="utf-8-sig")
    link.symlink_to(real)
    with RobotManager(load(link), bridges={"lab": MemoryBridge("lab", {})}) as robot:
        assert robot.apply(loads(WITH_LAMP, str(link)), keep=True).is_kept
    assert link.is_symlink()
    assert real.read_text(encoding="utf-8") == ROBOT + MORE


def test_another_file_that_is_read_is_not_the_one_that_is_written(
    robot: RobotManager, file: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(ROBOT.replace("name: best", "name: other"), encoding="utf-8")
    robot.reload(other)
    assert robot.apply(loads(WITH_LAMP, str(file)), keep=True).is_kept
    assert file.read_text(encoding="utf-8") == ROBOT + MORE


def test_with_a_full_disk_nothing_changes_and_no_new_bridge_is_left(file: Path) -> None:
    made: list[MemoryBridge] = []

    def create(name: str, options: Options) -> MemoryBridge:
        made.append(MemoryBridge(name, options))
        made[-1].emitter("best", {"type": "integer"})
        return made[-1]

    registry = Registry(())
    options = {"properties": {"level": {"type": "integer"}}}
    registry.add(BridgeType("memory", "", create, bridge_options=options, contract=2))
    other = loads(ROBOT.replace("{plugin: memory}", "{plugin: memory, options: {level: 2}}"))
    with RobotManager(load(file, registry.types), registry=registry) as robot:
        robot.request("camera")
        with full_after(10), pytest.raises(ConfigurationError, match="yaml cannot be written: "):
            robot.apply(other, keep=True)
        assert (robot.revision, [memory_bridge.closed for memory_bridge in made]) == (
            0,
            [False, True],
        )
        assert list(file.parent.iterdir()) == [file]
        assert file.read_text(encoding="utf-8") == ROBOT
        assert robot.apply(other, keep=True).is_kept


def test_what_cannot_be_put_in_its_place_is_reported(
    robot: RobotManager, file: Path, meanwhile: Callable[[Callable[[], object]], None]
) -> None:
    meanwhile(file.with_name(f".{file.name}.{os.getpid()}").unlink)
    with pytest.raises(ConfigurationError, match=r"is in force, but .* cannot be written: "):
        robot.apply(loads(WITH_LAMP, str(file)), keep=True)
    assert (robot.revision, file.read_text(encoding="utf-8")) == (1, ROBOT)


def test_a_limit_that_is_over_is_not_said_to_be_the_files(
    robot: RobotManager, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def configure(*_: object) -> None:
        raise BridgeTimeoutError("changing to revision 1 did not finish within 60 s")

    monkeypatch.setattr(robot._driver, "configure", configure)
    with pytest.raises(BridgeTimeoutError, match="did not finish"):
        robot.apply(loads(WITH_LAMP, str(file)), keep=True)
    assert file.read_text(encoding="utf-8") == ROBOT
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize(
    "spoil", [lambda item: evolve(item, text=""), lambda item: evolve(item, functions={})]
)
def test_what_no_text_says_cannot_be_kept(
    robot: RobotManager, file: Path, spoil: Callable[[object], object]
) -> None:
    with pytest.raises(UsageError, match="read from text"):
        robot.apply(spoil(loads(WITH_LAMP, str(file))), keep=True)  # type: ignore[arg-type]
    assert robot.revision == 0


def test_a_configuration_of_no_file_and_one_that_is_gone_say_so(
    robot: RobotManager, file: Path
) -> None:
    with (
        RobotManager(loads(ROBOT), bridges={"lab": MemoryBridge("lab", {})}) as other,
        pytest.raises(UsageError, match="is of no file"),
    ):
        other.apply(loads(WITH_LAMP), keep=True)
    file.unlink()
    with pytest.raises(ConfigurationError, match="cannot be read"):
        robot.apply(loads(WITH_LAMP, str(file)), keep=True)
    assert robot.revision == 0


def test_a_relative_path_is_that_of_the_folder_where_it_was_given(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program may change its folder later; what stands in that one is not meant."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / file.name).write_text("not a configuration", encoding="utf-8")
    monkeypatch.chdir(file.parent)
    lab = MemoryBridge("lab", {})
    with RobotManager(load(file.name), bridges={"lab": lab}, stop_file="stopped") as robot:
        assert robot.config.origin == str(file)
        monkeypatch.chdir(elsewhere)
        file.write_text(WITH_LAMP, encoding="utf-8")
        robot.reload()
        assert list(robot.config.functions) == ["camera", "lamp"]
        robot.apply(loads(ROBOT, str(file)), keep=True)
        assert file.read_text(encoding="utf-8") == ROBOT
        robot.stop_all()
        assert (file.parent / "stopped").exists()
        robot.release()
