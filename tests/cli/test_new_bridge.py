"""A generated bridge passes the conformance kit before anybody has touched it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from click.testing import CliRunner

from uoarm.cli import main


def make(name: str, into: Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["new-bridge", name, "--into", str(into)])
    return result.exit_code, result.output


def test_the_generated_bridge_passes_the_kit(tmp_path: Path) -> None:
    code, text = make("my_bus", tmp_path)
    assert code == 0
    assert "pytest" in text
    project = tmp_path / "uoarm-my-bus"
    assert "example" not in (project / "pyproject.toml").read_text().lower()
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        cwd=project,
        env={**os.environ, "PYTHONPATH": str(project / "src")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout


def test_a_bad_name_and_a_folder_that_is_there_are_refused(tmp_path: Path) -> None:
    code, text = make("My-Bus", tmp_path)
    assert code == 2
    assert "small letters" in text
    (tmp_path / "uoarm-bus").mkdir()
    code, text = make("bus", tmp_path)
    assert code == 1
    assert "is there already" in text
    assert not list((tmp_path / "uoarm-bus").iterdir())
