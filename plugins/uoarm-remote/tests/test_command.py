"""`uoarm fleet`: every manager's status, or why it is not known."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from robots import ServedRobot, fleet

from uoarm.testing import patience


def desk(folder: Path, **urls: str) -> str:
    """Write a configuration that imports from managers; returns its file."""
    bridges = "".join(
        f"  {name}: {{plugin: remote, options: {{url: '{url}', timeout: {patience()}}}}}\n"
        for name, url in urls.items()
    )
    file = folder / "desk.yaml"
    file.write_text(f"version: 1\nbridges:\n  python: {{}}\n{bridges}functions: {{}}\n")
    return str(file)


def test_every_manager_is_shown(
    robot: ServedRobot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with robot.manager.request("counter"):
        assert fleet(desk(tmp_path, first=robot.url, second=robot.url)) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"first  {robot.url}\n  ")
    assert f"\nsecond  {robot.url}\n" in shown
    assert "counter" in shown


def test_one_that_is_not_reached_is_named_beside_the_others(
    robot: ServedRobot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = ServedRobot()
    gone.close()
    assert fleet(desk(tmp_path, first=gone.url, second=robot.url), "--json") == 4
    first, second = json.loads(capsys.readouterr().out)
    assert (first["bridge"], first["url"], first["status"]) == ("first", gone.url, None)
    assert "nothing listens there" in first["cause"]
    assert (first["error_code"], second["error_code"]) == ("UOA-402", "")
    assert second["cause"] == ""
    assert second["status"]["connections"] == []
    assert fleet(desk(tmp_path, first=gone.url)) == 4
    assert "first  ws://127.0.0.1:" in (text := capsys.readouterr().out)
    assert "not reached: nothing listens there" in text


def test_a_configuration_that_is_wrong_or_imports_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fleet(desk(tmp_path, first="http://nowhere/")) == 3
    assert "url" in capsys.readouterr().err
    assert fleet(str(tmp_path / "missing.yaml")) == 3
    capsys.readouterr()
    file = desk(tmp_path)
    assert fleet(file) == 0
    assert capsys.readouterr().out == f"{file} imports from no other manager\n"


def test_the_status_of_all_is_that_of_the_fleet(robot: ServedRobot, tmp_path: Path) -> None:
    shown = subprocess.run(
        [sys.executable, "-m", "uoarm", "status", "--all", desk(tmp_path, first=robot.url)],
        capture_output=True,
        text=True,
        timeout=patience(),
        check=True,
    )
    assert shown.stdout.startswith(f"first  {robot.url}\n  ")


def test_it_is_a_command_of_uoarm() -> None:
    shown = subprocess.run(
        [sys.executable, "-m", "uoarm", "fleet", "--help"],
        capture_output=True,
        text=True,
        timeout=patience(),
        check=True,
    )
    assert "uoarm fleet" in shown.stdout
