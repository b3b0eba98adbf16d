"""The warehouse as a user starts it: a box is carried by whichever vehicle is fit, and all ends."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.processes import run_python

from uoarm.testing import patience, wait

WAREHOUSE = Path(__file__).parents[2] / "examples" / "warehouse"


def test_an_order_is_carried_out_and_everything_ends(tmp_path: Path) -> None:
    limits = ["--orders", "1", "--duration", str(3 * patience()), "--run", str(tmp_path)]
    output = tmp_path / "scene.out"
    with output.open("wb") as out:
        command = [sys.executable, str(WAREHOUSE / "warehouse.py"), *limits]
        scene = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
        try:
            wait(lambda: scene.poll() is not None, timeout=5 * patience())
        finally:
            scene.terminate()
            scene.wait(patience())
    text = output.read_text()
    logs = "\n".join(f"{log.name}: {log.read_text()[-500:]}" for log in tmp_path.glob("*.log"))
    assert scene.returncode == 0, f"{text}\n{logs}"
    assert re.search(r"done transport\w+$", text, re.MULTILINE), text
    (weighed,) = map(json.loads, (tmp_path / "weighed.jsonl").read_text().splitlines())
    assert abs(weighed["mass"] - 5) < 0.1
    pids = [int(pid) for pid in re.findall(r" pid (\d+)", text)]
    assert len(pids) > 9
    assert not [pid for pid in pids if lives(pid)]


@pytest.mark.parametrize(
    "options", [("--orders", "0"), ("--duration", "-1"), ("--orders", "1", "--duration", "nan")]
)
def test_an_option_without_a_sense_is_refused_before_anything_is_started(
    options: tuple[str, ...],
) -> None:
    done = run_python(WAREHOUSE / "warehouse.py", *options)
    assert done.returncode == 2
    assert f"error: {' '.join(options[-2:])}: expected" in done.stderr
    assert done.stdout == ""


def lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
