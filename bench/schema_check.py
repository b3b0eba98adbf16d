"""Containment checkers side by side: time per pair and verdict, ours and others from PyPI.

Usage: ``python -m bench.schema_check [--json] [--ours] [--hand-written]``. Each rival is installed
into an environment of its own below the cache folder (``UOARM_TEST_CACHE``, else ``.cache``).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import venv
from collections.abc import Sequence
from pathlib import Path

from tests.schema import _hard_arrays, _hard_logic, _hard_objects, _hard_scalars, _hard_sizes

from bench._schema_cases import CASES, Case
from bench.tables import print_table
from bench.turns import ROOT

RIVALS = {
    "jsonsubschema": "jsonsubschema==0.0.8",
    "ghga-jsonsubschema": "ghga-jsonsubschema==0.2.1",
    "jsoncompat": "jsoncompat>=0.3.1",
    "isjsonschemasubset": "isjsonschemasubset==0.0.2",
}
_ALL_SECONDS = 1_500
Answers = list[dict[str, object]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="the figures as JSON")
    parser.add_argument("--ours", action="store_true", help="without the rivals")
    parser.add_argument(
        "--hand-written", action="store_true", help="the pairs of the tests, asked once each"
    )
    options = parser.parse_args()
    cases = hand_written() if options.hand_written else CASES
    once = options.hand_written
    results = {"uoarm": _run("uoarm", Path(sys.executable), cases, once=once)}
    absent: dict[str, str] = {}
    for name in () if options.ours else RIVALS:
        try:
            results[name] = _run(name, _environment(name, RIVALS[name]), cases, once=once)
        except (subprocess.SubprocessError, OSError) as error:
            absent[name] = str(getattr(error, "stderr", None) or error)[-300:]
    if options.json:
        named = [
            {"group": case.group, "name": case.name, "truth": case.contained} for case in cases
        ]
        print(json.dumps({"cases": named, "results": results, "absent": absent}))
        return
    _show(results, cases)
    for name, cause in absent.items():
        print(f"\nNot measured: {name} could not be installed or run: {cause}")


def hand_written() -> Sequence[Case]:
    """The pairs of known truth that the tests are held to."""
    tables = (_hard_scalars, _hard_arrays, _hard_objects, _hard_logic, _hard_sizes)
    return [
        Case(table.__name__.rpartition("_")[2], pair.name, *pair[1:4])
        for table in tables
        for pair in table.PAIRS
        if all(isinstance(side, dict) for side in pair[1:3])
    ]


def _environment(name: str, requirement: str) -> Path:
    cache = Path(os.environ.get("UOARM_TEST_CACHE", ROOT / ".cache"))
    home = cache / "rivals" / name
    python = home / "bin" / "python"
    if (home / "installed").is_file():
        return python
    if uv := shutil.which("uv"):
        _call([uv, "venv", "--quiet", "--clear", "--python", sys.executable, str(home)])
        _call([uv, "pip", "install", "--quiet", "--python", str(python), requirement])
    else:
        venv.create(home, with_pip=True, clear=True)
        _call([str(python), "-m", "pip", "install", "--quiet", requirement])
    (home / "installed").touch()
    return python


def _call(command: list[str]) -> None:
    subprocess.run(command, check=True, capture_output=True, text=True, timeout=_ALL_SECONDS)


def _run(name: str, python: Path, cases: Sequence[Case], *, once: bool) -> Answers:
    """One answer for each case; a checker that dies loses the case at which it died."""
    sys.setrecursionlimit(20_000)  # for writing JSON of 500 levels
    answers: Answers = []
    worker = str(Path(__file__).with_name("_schema_worker.py"))
    while len(answers) < len(cases):
        rest = cases[len(answers) :]
        questions = "".join(json.dumps([case.producer, case.consumer]) + "\n" for case in rest)
        done = subprocess.run(
            [str(python), worker, name, *(["--once"] if once else [])],
            input=questions, capture_output=True, text=True, timeout=_ALL_SECONDS, check=False,
        )  # fmt: skip
        answers += [json.loads(line) for line in done.stdout.splitlines()]
        if len(answers) == len(cases) - len(rest) and "Import" in done.stderr:
            raise subprocess.SubprocessError(done.stderr)
        if len(answers) < len(cases):
            answers.append({"answer": f"died: {done.returncode}"})
    return answers


def _show(results: dict[str, Answers], cases: Sequence[Case]) -> None:
    print(f"CPython {platform.python_version()}, {platform.machine()}; median ms of each pair")
    print("(wrong answers bold; u: undecided or refused to answer).")
    truths = {False: "no", True: "yes"}
    pairs = [
        (
            *(case.group, case.name, truths[case.contained]),
            *(_cell(case, answers[place]) for answers in results.values()),
        )
        for place, case in enumerate(cases)
    ]
    print_table("Pairs", ("group", "pair", "truth", *results), pairs)
    head = ("checker", "right", "wrong yes", "wrong no", "undecided, error, time-out", "median ms")
    sums = [_sum(name, answers, cases) for name, answers in results.items()]
    print_table("Checkers", head, sums)


def _cell(case: Case, answer: dict[str, object]) -> str:
    said = answer["answer"]
    if not isinstance(said, bool):
        return f"u ({said})"
    text = "yes" if said else "no"
    shown = text if said == case.contained else f"**{text}**"
    return f"{shown} {answer['ms']:.3f}"


def _sum(name: str, answers: Answers, cases: Sequence[Case]) -> tuple[str, ...]:
    pairs = list(zip(cases, (answer["answer"] for answer in answers), strict=True))
    right = sum(said is case.contained for case, said in pairs)
    wrong_yes = sum(said is True and not case.contained for case, said in pairs)
    wrong_no = sum(said is False and case.contained for case, said in pairs)
    times = [float(str(answer["ms"])) for answer in answers if "ms" in answer]
    median = f"{statistics.median(times):.3f}" if times else "-"
    left = len(pairs) - right - wrong_yes - wrong_no
    return name, f"{right}", f"{wrong_yes}", f"{wrong_no}", f"{left}", median


if __name__ == "__main__":
    main()
