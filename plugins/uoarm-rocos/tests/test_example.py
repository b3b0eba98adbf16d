"""The example runs as its page says, on other ports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rigs import running
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_rocos.simulate import Oximeter, Scenario, TcpEnd

from uoarm.config import inspect

EXAMPLE = Path(__file__).parents[3] / "examples" / "vitals"


def plotted(file: Path, seconds: float) -> Any:
    return run_python(EXAMPLE / "plot.py", "--file", file, "--seconds", str(seconds))


def configured(url: str, file: Path) -> Path:
    given = (EXAMPLE / "robot.yaml").read_text()
    file.write_text(given.replace("127.0.0.1:7200", url.removeprefix("tcp://")))
    return file


def test_the_pulse_is_drawn_with_its_numbers(tmp_path: Path) -> None:
    with running(Oximeter("contec", scenario=Scenario(found=0.0)), TcpEnd()) as url:
        done = plotted(configured(url, tmp_path / "robot.yaml"), 2.0)
    assert done.returncode == 0, done.stderr
    assert "pulse 7" in done.stdout
    assert "SpO2 97 %   good" in done.stdout
    assert "\u2588" in done.stdout


class Unplugged(TcpEnd):
    """A line over which nothing comes any more after a hundred frames."""

    left = 100

    def write(self, data: bytes) -> None:
        self.left -= 1
        if self.left > 0:
            super().write(data)


def test_a_device_that_stays_unplugged_is_reported(tmp_path: Path) -> None:
    with running(Oximeter("contec", scenario=Scenario(found=0.0)), Unplugged()) as url:
        done = plotted(configured(url, tmp_path / "robot.yaml"), 60.0)
    assert done.returncode == 1
    assert "no message within 5 s" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_without_a_device_the_reason_is_said(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text((EXAMPLE / "robot.yaml").read_text().replace(':7200"', ':1", wait: 0.2'))
    done = plotted(file, 2.0)
    assert done.returncode == 1
    assert "clip is not there after 0.2 s" in done.stderr


def test_the_configuration_has_no_mistake() -> None:
    report = inspect(EXAMPLE / "robot.yaml")
    assert not report.problems
