"""The fixtures for users' tests work as their page shows, and cost a run of pytest nothing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from uoarm.testing import patience

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "testing.md"


def run(folder: Path, program: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Run pytest over a program, with this plugin and no other."""
    (folder / "test_mine.py").write_text(program)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "uoarm._pytest_plugin", *options]
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    return subprocess.run(
        [*command, "-p", "no:cacheprovider", "--rootdir", str(folder), str(folder)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=patience(),
        check=False,
    )


def test_the_page_runs_as_printed(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    program, source = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    done = run(tmp_path, program)
    assert "3 passed" in done.stdout, done.stdout + done.stderr
    test = "\n\ndef test_it():\n    script.put({'value': 1})\n    assert callable(numbers)\n"
    done = run(tmp_path, source + test)
    assert "1 passed" in done.stdout, done.stdout + done.stderr


def test_a_configuration_of_its_own_reaches_the_memory_bridge(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    (yaml,) = re.findall(r"^```yaml\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    done = run(
        tmp_path,
        f"""
YAML = '''{yaml}'''


def test_it(robot, memory_bridge):
    scanner = memory_bridge.emitter("scanner", {{"type": "integer"}}, latched=True)
    scanner.emit(3)
    assert robot(YAML).request("scan").get(60) == 3
    assert memory_bridge.open_channels == 1


def test_services_and_inputs(robot, fake_component):
    number = {{"type": "integer"}}
    fake_component.service("double", number, number, lambda asked: 2 * asked)
    drive = fake_component.input("drive", number)
    manager = robot()
    assert manager.call("double", 4) == 8
    with manager.request("drive") as connection:
        connection.send(5)
        assert drive.taken.wait(1) == [5]


def test_faults_last_as_long_as_the_test(memory_bridge, faults):
    faults.lying(memory_bridge, "_discover", ())
    assert memory_bridge.discover() == ()
    hang = faults.hanging(memory_bridge, "_close")
    hang.release()
""",
    )
    assert "3 passed" in done.stdout, done.stdout + done.stderr


def test_a_run_that_asks_for_no_fixture_imports_nothing(tmp_path: Path) -> None:
    done = run(
        tmp_path,
        "import sys\n\n\ndef test_it():\n    assert 'uoarm.testing' not in sys.modules\n",
    )
    assert "1 passed" in done.stdout, done.stdout + done.stderr


def test_pytest_finds_the_plugin_by_itself() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert '[project.entry-points.pytest11]\nuoarm = "uoarm._pytest_plugin"' in text
