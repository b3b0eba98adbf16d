"""The base of examples/drive: a page drives it while a button is held, and so does a terminal."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.processes import hold_dies_whole, run_python
from tests.server.browser import Browser, find_chromium

from uoarm.testing import patience, wait

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "drive"
DOMAIN = str(64 + os.getpid() % 38)
PORTS = ("--port", "0", "--page-port", "0")
pytestmark = pytest.mark.needs("chromium", "ros2")


def environment(folder: Path) -> dict[str, str]:
    return {
        "ROS_DOMAIN_ID": DOMAIN,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "XDG_STATE_HOME": str(folder),
    }


class Drive:
    """The example as a user starts it."""

    def __init__(self, folder: Path) -> None:
        copy = Path(shutil.copytree(EXAMPLE, folder / "drive"))
        robot = copy / "robot.yaml"
        # A page that is starved for half a second is no fault here.
        lasting = robot.read_text().replace("lifetime: 0.5", f"lifetime: {patience()}")
        robot.write_text(lasting.replace("duration: 1.0", f"duration: {patience()}"))
        self._output = folder / "out"
        with self._output.open("wb") as out:
            self.process = subprocess.Popen(
                [sys.executable, str(copy / "drive.py"), *PORTS],
                stdout=out,
                stderr=subprocess.STDOUT,
                env={**os.environ, **environment(folder)},
            )

    @property
    def output(self) -> str:
        return self._output.read_text()

    def address(self, pattern: str) -> str:
        wait(lambda: re.search(pattern, self.output) is not None or self.process.poll() is not None)
        found = re.search(pattern, self.output)
        assert found is not None, self.output
        return found[1]

    def moves(self) -> list[str]:
        """What the base said that it does, in order."""
        return re.findall(r"standing still|driving at [-.\d]+ m/s", self.output)


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[Drive]:
    drive = Drive(tmp_path)
    yield drive
    drive.process.send_signal(signal.SIGINT)
    assert drive.process.wait(patience()) == 0, drive.output


def test_the_base_drives_while_a_button_is_held(drive: Drive) -> None:
    page = drive.address(r"open (http://\S+)")
    robot = page.partition("?robot=")[2]
    assert run_python("-m", "uoarm", "status", "--url", robot).returncode == 0, "is it served?"
    program = find_chromium()
    assert program is not None
    with Browser(program) as browser:
        browser.show(400, 700)
        browser.go(page)
        browser.until("document.getElementById('place')?.textContent.includes('m/s')")
        middle = (
            "const {x, y, width, height} = document.querySelector('button').getBoundingClientRect()"
        )
        place = browser.js(
            f"(() => {{ {middle}; return {{x: x + width / 2, y: y + height / 2}}; }})()"
        )
        press = {"button": "left", "clickCount": 1, **place}
        browser.command("Input.dispatchMouseEvent", type="mousePressed", **press)
        wait(lambda: drive.moves()[-1] == "driving at 0.30 m/s")
        browser.until("document.getElementById('place').textContent.includes('at 0.30 m/s')")
        terminal = (EXAMPLE / "terminal.py", "--url", robot)
        refused = run_python(*terminal)
        assert refused.returncode == 1
        assert "holds its lease" in refused.stderr
        assert drive.moves() == ["standing still", "driving at 0.30 m/s"]
        browser.command("Input.dispatchMouseEvent", type="mouseReleased", **press)
        wait(lambda: drive.moves() == ["standing still", "driving at 0.30 m/s", "standing still"])
        assert browser.js("document.getElementById('notice').textContent") == ""
    driven = run_python(*terminal, "--seconds", "0.5")
    assert driven.returncode == 0
    wait(lambda: drive.moves()[-2:] == ["driving at 0.20 m/s", "standing still"])


def test_no_part_outlives_it(tmp_path: Path) -> None:
    command = (sys.executable, str(EXAMPLE / "drive.py"), *PORTS)
    hold_dies_whole(*command, after="to drive", env=environment(tmp_path))
