"""Mutation testing with mutmut: of the containment checker, adapters, meaning or the engine.

Which changes of the code do the tests notice?

Usage: ``python -m bench.mutation [schema | adapt | meaning | control] [--sample 300] [--seed 0]
[--module NAME ...] [--children 2]``. Works on a copy below the cache folder: nothing here changes.
Prints a table of killed and surviving mutants by module, and the survivors; without ``--sample``
all are run.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

from attrs import frozen

from bench.tables import print_table
from bench.turns import ROOT

_SETTINGS = """
[tool.mutmut]
source_paths = [{source}]
only_mutate = {modules}
also_copy = ["src", "README.md", "LICENSE", "conftest.py"]
pytest_add_cli_args_test_selection = {tests}
pytest_add_cli_args = ["-p", "no:cacheprovider", "-k", {selected}]
"""


@frozen
class Subject:
    """What is changed, and the tests that should notice.

    Attributes:
        source: a folder.
        tests: patterns of paths.
        selected: pytest's `-k`.
        modules: patterns of the files that are changed.
    """

    source: str
    tests: tuple[str, ...]
    selected: str
    modules: tuple[str, ...] = ()


SUBJECTS = {
    "schema": Subject(
        "src/uoarm/schema",
        (
            "tests/schema/test_hard_pairs.py",
            "tests/schema/test_random_pairs.py",
            "tests/schema/test_engine_*.py",
        ),
        "not sizes and not hostile",
    ),
    "adapt": Subject(
        "src/uoarm/_adapt", ("tests/adapt/test_*.py", "tests/meaning/test_judge.py"), "not hostile"
    ),
    "meaning": Subject("src/uoarm/_meaning", ("tests/meaning/test_*.py",), "not without_pint"),
    "control": Subject(
        "src/uoarm/_control/engine",
        (
            "tests/control/test_transcripts.py",
            "tests/control/test_difference.py",
            "tests/control/test_every_order.py",
            "tests/control/test_waiting.py",
        ),
        "not greater_depth and not TestWalk",
        ("step", "draft", "failover", "leaving", "switchover", "state"),
    ),
}
_OUTCOMES = {
    0: "survived",
    1: "killed",
    3: "killed",
    33: "no tests",
    36: "timed out",
    24: "timed out",
}
_KINDS = ("killed", "timed out", "survived", "no tests", "not run")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("subject", choices=SUBJECTS, nargs="?", default="schema")
    parser.add_argument("--sample", type=int, help="run this many mutants, drawn at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--module", action="append", help="only modules whose name contains this")
    parser.add_argument("--children", type=int, default=2)
    options = parser.parse_args()
    subject = SUBJECTS[options.subject]
    copy = _copy(subject)
    _mutmut(copy, options.children, "none*")  # generates the mutants, then finds nothing to run
    names = [name for name in _outcomes(copy) if _wanted(name, options.module)]
    chosen = names
    if options.sample is not None and options.sample < len(names):
        chosen = random.Random(options.seed).sample(names, options.sample)
    said = _mutmut(copy, options.children, *chosen)
    outcomes = _outcomes(copy)
    if all(outcomes[name] == "not run" for name in chosen):
        sys.exit(f"mutmut ran no mutant:\n{said}")
    _show(len(names), chosen, outcomes)


def _copy(subject: Subject) -> Path:
    cache = Path(os.environ.get("UOARM_TEST_CACHE", ROOT / ".cache"))
    copy = cache / "mutation"
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir(parents=True)
    for folder in ("src", "tests"):
        shutil.copytree(ROOT / folder, copy / folder)
    for name in ("README.md", "LICENSE", "conftest.py"):
        shutil.copy(ROOT / name, copy)
    found = (path for pattern in subject.tests for path in sorted(ROOT.glob(pattern)))
    tests = [str(path.relative_to(ROOT)) for path in found]
    settings = _SETTINGS.format(
        source=json.dumps(subject.source),
        modules=json.dumps([f"{subject.source}/{name}.py" for name in subject.modules or ("*",)]),
        tests=json.dumps(tests),
        selected=json.dumps(subject.selected),
    )
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (copy / "pyproject.toml").write_text(project + settings, encoding="utf-8")
    return copy


def _mutmut(copy: Path, children: int, *names: str) -> str:
    command = [sys.executable, "-m", "mutmut", "run", "--max-children", str(children), *names]
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    if not any(copy.glob("mutants/**/*.meta")):
        sys.exit(f"mutmut made no mutants:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


def _outcomes(copy: Path) -> dict[str, str]:
    """Outcome by mutant; "not run" for those left out."""
    found: dict[str, str] = {}
    for path in sorted(copy.glob("mutants/**/*.meta")):
        codes = json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]
        for name, code in codes.items():
            found[name] = "not run" if code is None else _OUTCOMES.get(code, "killed")
    return found


def _wanted(name: str, modules: list[str] | None) -> bool:
    return modules is None or any(module in name for module in modules)


def _show(total: int, chosen: list[str], outcomes: dict[str, str]) -> None:
    table: dict[str, Counter[str]] = {}
    for name in chosen:
        module = name.rpartition(".")[0]
        table.setdefault(module, Counter())[outcomes[name]] += 1
    counts = {**dict(sorted(table.items())), "all": sum(table.values(), Counter())}
    rows = [(name, *_cells(found)) for name, found in counts.items()]
    print_table(f"{len(chosen)} of {total} mutants", ("module", *_KINDS, "score"), rows)
    print("\nSurvivors:")
    print("\n".join(name for name in sorted(chosen) if outcomes[name] in {"survived", "no tests"}))


def _cells(counts: Counter[str]) -> tuple[str, ...]:
    caught = counts["killed"] + counts["timed out"]
    run = counts.total() - counts["not run"]
    return (*(str(counts[kind]) for kind in _KINDS), f"{caught / run if run else 0:.1%}")


if __name__ == "__main__":
    main()
