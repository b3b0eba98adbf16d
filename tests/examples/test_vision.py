"""The demonstration of the README, on real footage, with both sets of candidates."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run(tmp_path: Path, *options: str) -> tuple[int, Any]:
    command = [sys.executable, str(ROOT / "examples/vision/demo.py"), "--json"]
    done = subprocess.run(
        [*command, "--output", str(tmp_path), *options],
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
        cwd=ROOT,
    )
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)


@pytest.mark.timeout(300)
def test_everybody_is_recognised_for_who_they_are(tmp_path: Path) -> None:
    code, result = run(tmp_path)
    assert result["plan"] == ["recorded", "dlib_detector", "dlib_recogniser"]
    assert result["seen"]["franck.mp4"] == {"franck": 40}
    assert set(result["seen"]["carphone.mp4"]) == {"unknown"}
    assert result["seen"]["obama-photos"] == {"obama": 2}
    assert result["dropped"] == 0
    assert (tmp_path / "recognised.png").stat().st_size > 10_000
    assert code == 0


@pytest.mark.timeout(300)
def test_priorities_choose_the_lighter_candidates(tmp_path: Path) -> None:
    _, result = run(tmp_path, "--light")
    assert result["plan"] == ["recorded", "haar_detector", "lbph_recogniser"]
    assert sum(result["seen"]["franck.mp4"].values()) > 0
    assert result["dropped"] == 0
