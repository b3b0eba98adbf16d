"""The example runs as its page says, on other ports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from rigs import running
from uoarm_rocos.simulate import Oximeter, Scenario, TcpEnd

from uoarm.config import inspect
from uoarm.testing import patience

EXAMPLE = Path(__file__).parents[3] / "examples" / "vitals"


def plotted(file: Path, seconds: float) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXAMPLE / "plot.py"), "--file", str(file)]
    return subprocess.run(
        [*command, "--seconds", str(seconds)],
        check=False,
        capture_output=True,
        text=True,
        timeout=patience(),
    )


def test_the_pulse_is_drawn_with_its_numbers(tmp_path: Path) -> None:
    with running(Oximeter("contec", scenario=Scenario(found=0.0)), TcpEnd()) as url:
        file = tmp_path / "robot.yaml"
        given = (EXAMPLE / "robot.yaml").read_text()
        file.write_text(given.replace("127.0.0.1:7200", url.removeprefix("tcp://")))
        done = plotted(file, 2.0)
    assert done.returncode == 0, done.stderr
    assert "pulse 7" in done.stdout
    assert "SpO2 97 %   good" in done.stdout
    assert "\u2588" in done.stdout


def test_without_a_device_the_reason_is_said(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text((EXAMPLE / "robot.yaml").read_text().replace(':7200"', ':1", wait: 0.2'))
    done = plotted(file, 2.0)
    assert done.returncode == 1
    assert "clip is not there after 0.2 s" in done.stderr


def test_the_configuration_has_no_mistake() -> None:
    report = inspect(EXAMPLE / "robot.yaml")
    assert not report.problems
