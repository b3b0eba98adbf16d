"""examples/agent: an agent leads a visit, and a second principal approves the arm cuff."""

from __future__ import annotations

from pathlib import Path

from tests.processes import run_python  # type: ignore[import-not-found]

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
