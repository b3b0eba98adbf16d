"""The soak, for some seconds: each fault once, and all that it holds."""

from __future__ import annotations

from pathlib import Path

from tests.processes import run_python

ROOT = Path(__file__).parents[2]
FAULTS = ("kill", "stop", "pause", "hang", "refuse", "slow")


def test_a_soak_of_some_seconds_holds() -> None:
    done = run_python("-m", "bench.soak", "--minutes", "0.05", cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    for fault in FAULTS:
        assert f"{fault} 1" in done.stdout
