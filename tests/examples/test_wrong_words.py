"""Programs of the examples that are given wrong words, or lack a package, say so in a line."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.processes import run_python

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
RTM = pytest.mark.needs("rtm")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("healthbot/experiments/bare.py", "the following arguments are required: name, count"),
        ("healthbot/experiments/bare.py python x", "expected a number of round trips, got x"),
        ("healthbot/experiments/bare.py call peer", "expected a number of round trips, got peer"),
        ("healthbot/experiments/loops.py", "the following arguments are required: framework"),
        ("healthbot/experiments/loops.py rtm", "the following arguments are required: nameserver"),
        ("healthbot/experiments/every.py --record /dev/null", "--record: /dev/null is no folder"),
        pytest.param(
            "healthbot/experiments/latency.py --record /dev/null/x", "cannot be written", marks=RTM
        ),
        pytest.param(
            "healthbot/experiments/monitoring.py --record /dev/null/x",
            "cannot be written",
            marks=RTM,
        ),
    ],
)
def test_wrong_words_are_refused_before_anything_is_done(words: str, said: str) -> None:
    name, *rest = words.split()
    done = run_python(EXAMPLES / name, *rest)
    assert (done.returncode, "Traceback" in done.stderr) == (2, False), done.stderr
    assert f"error: {said}" in done.stderr or f"{said}: " in done.stderr


@pytest.mark.parametrize(
    "name", ["healthbot/experiments/plots.py", "warehouse/experiments/drawing.py"]
)
def test_plots_without_matplotlib_say_how_it_is_installed(name: str, tmp_path: Path) -> None:
    (tmp_path / "matplotlib.py").write_text("raise ImportError('it is away')\n")
    done = run_python(EXAMPLES / name, "a", "b", env={"PYTHONPATH": str(tmp_path)})
    said = "plots need the extra plots: pip install -e '.[plots]' (it is away)\n"
    assert (done.returncode, done.stderr) == (1, said)
