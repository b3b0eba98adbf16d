"""The soak, for some seconds: each fault once, and all that it holds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from uoarm.testing import patience

ROOT = Path(__file__).parents[2]
FAULTS = ("kill", "stop", "pause", "hang", "refuse", "slow")


def test_a_soak_of_some_seconds_holds() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "bench.soak", "--minutes", "0.05"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=4 * patience(),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for fault in FAULTS:
        assert f"{fault} 1" in done.stdout
