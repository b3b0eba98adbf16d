"""What examples/versions says where it cannot make its environments."""

from __future__ import annotations

from pathlib import Path

from tests.processes import run_python

RUN = Path(__file__).parents[2] / "examples" / "versions" / "run.py"


def test_environments_that_cannot_be_made_are_reported(tmp_path: Path) -> None:
    no_folder = tmp_path / "file"
    no_folder.touch()
    done = run_python(RUN, env={"XDG_DATA_HOME": str(no_folder)})
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert str(no_folder) in done.stderr


def test_help_makes_no_environment(tmp_path: Path) -> None:
    done = run_python(RUN, "--help", env={"XDG_DATA_HOME": str(tmp_path)})
    assert done.returncode == 0
    assert done.stdout.startswith("usage: run.py")
    assert not any(tmp_path.iterdir())
