"""The page's example runs as printed, with Debian's own master and rospy."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from peers import Master

from uoarm.testing import patience, wait

PAGE = Path(__file__).parents[3] / "docs" / "ros1.md"


def test_the_example_runs_as_printed(master: Master, tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    _, peers, robot, commands, printed, *_ = (
        found[1] for found in re.finditer(r"```\w+\n(.*?)```", text, re.DOTALL)
    )
    (tmp_path / "robot.yaml").write_text(robot.replace("127.0.0.1", master.host))
    _, _, node = peers.partition("&\n")  # the test has a master of its own
    shell = subprocess.Popen(
        ["bash", "-c", node], cwd=tmp_path, env=master.environment, start_new_session=True
    )
    try:
        said: list[str] = []

        def answered() -> bool:
            done = [_run(line, tmp_path) for line in commands.splitlines()]
            said[:] = [run.stdout + run.stderr for run in done]
            return not any(run.returncode for run in done)

        wait(answered, "the node of the page did not come up", patience())
        assert "".join(said) == printed
    finally:
        os.killpg(shell.pid, 9)
        shell.wait()


def _run(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *shlex.split(line)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=patience(),
        check=False,
        env={**os.environ, "HOME": str(folder)},
    )
