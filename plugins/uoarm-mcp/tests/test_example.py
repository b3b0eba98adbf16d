"""examples/agent: an agent leads a visit, and a second principal approves the arm cuff."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.processes import hold_ends_unread, run_python  # type: ignore[import-not-found]

from uoarm.testing import patience

VISIT = Path(__file__).parents[3] / "examples" / "agent" / "visit.py"


def test_the_patient_is_measured_and_the_cuff_approved(tmp_path: Path) -> None:
    done = run_python(VISIT, "--approve", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    approved = lines.index("nurse: approved {'pressure': 160.0}")
    assert lines.index("cuff: pumped up to 160 mmHg") > 0
    assert lines.count("cuff: pumped up to 160 mmHg") == 1
    assert approved > lines.index("robot: Good morning. Please put the clip on your finger.")
    assert lines[-1] == "record: pulse 72, SpO2 98, blood pressure 124/81"


def test_a_signal_ends_it_without_a_trace(tmp_path: Path) -> None:
    command, pipe = [sys.executable, str(VISIT)], subprocess.PIPE
    env = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=env) as process:
        assert process.stdout is not None
        assert "export UOARM_TOKEN" in process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=patience())
    assert (process.returncode, said) == (130, "")
    assert not list(tmp_path.iterdir())


def test_it_ends_with_what_reads_it() -> None:
    hold_ends_unread(sys.executable, str(VISIT), "--approve")
