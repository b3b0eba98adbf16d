"""Who waits at a terminal for a large file gets a notice; no one else does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from uoarm.testing import patience

FRAME = "version: 1\nbridges: {}\nfunctions: {}\n"


@pytest.mark.parametrize(("octets", "is_announced"), [(2_000_000, True), (2_000, False)])
def test_a_check_that_takes_a_while_says_so_on_a_terminal(
    tmp_path: Path, octets: int, *, is_announced: bool
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(FRAME + "#" * octets, encoding="utf-8")
    ours, terminal = os.openpty()
    try:
        command = [sys.executable, "-m", "uoarm", "check", str(file)]
        done = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=terminal, timeout=patience(), check=False
        )
        os.write(terminal, b"end\n")
        seen = os.read(ours, 4096).decode()
    finally:
        os.close(ours)
        os.close(terminal)
    assert done.returncode == 0
    assert ("2.0 MB: this takes a while" in seen) is is_announced
    assert "no errors" in done.stdout.decode()


def test_a_check_says_nothing_of_its_length_to_a_pipe(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(FRAME + "#" * 2_000_000, encoding="utf-8")
    command = [sys.executable, "-m", "uoarm", "check", str(file)]
    done = subprocess.run(command, capture_output=True, timeout=patience(), check=False)
    assert done.stderr == b""
