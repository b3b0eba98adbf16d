"""examples/agent: an agent leads a visit, and a second principal approves the arm cuff."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from uoarm.testing import patience

VISIT = Path(__file__).parents[3] / "examples" / "agent" / "visit.py"


def test_the_patient_is_measured_and_the_cuff_approved(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(VISIT), "--approve"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=2 * patience(),
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    approved = lines.index("nurse: approved {'pressure': 160.0}")
    assert lines.index("cuff: pumped up to 160 mmHg") > 0
    assert lines.count("cuff: pumped up to 160 mmHg") == 1
    assert approved > lines.index("robot: Good morning. Please put the clip on your finger.")
    assert lines[-1] == "record: pulse 72, SpO2 98, blood pressure 124/81"
