"""What a start costs: the import, the commands, the way to the first message; whole processes.

`python -m bench.startup --before FOLDER --rounds 15` measures this state and the one of another
checkout in turns, so that both see the same neighbours. Every figure is the time from the start of
a process: to its end, or to its first message. Beside it stands what the process, and those that
it waited for, have computed, which neighbours disturb less. The first round, which writes Python's
cache of compiled modules, is not counted.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from bench.request import BRIDGE, GOAL, ROBOT
from bench.tables import print_table
from bench.turns import ROOT, environment, load, parser, states

BENCH = ROOT / "bench"
SMALL = """
version: 1
bridges: {python: {}}
functions:
  camera:
    components:
      - name: eye
        bridge: python
        output: {endpoint: ["chain_components:camera"]}
"""
FIRST_MESSAGE = f"""
import uoarm
manager = uoarm.RobotManager.from_file("{{file}}")
connection = manager.request("{GOAL}")
connection.get(timeout=60)
print(flush=True)
manager.close()
"""
MODULES = "import sys, uoarm; print(len(sys.modules))"
_LIMIT_SECONDS = 60
Environment = Mapping[str, str]
Sample = tuple[float, float]


def main() -> None:
    """Print the table, from the samples of all rounds."""
    given = parser(__doc__, rounds=9).parse_args()
    found: dict[tuple[str, str], list[Sample]] = {}
    with tempfile.TemporaryDirectory() as folder:
        measured = _measured(Path(folder))
        environments = {
            state: environment(
                checkout,
                BENCH,
                PYTHONPYCACHEPREFIX=str(Path(folder, state)),
                PYTHONDONTWRITEBYTECODE="",
            )
            for state, checkout in states(given).items()
        }
        for number in range(given.rounds + 1):
            for what, take in measured.items():
                for state, variables in environments.items():
                    sample = take(variables)
                    if number:
                        found.setdefault((what, state), []).append(sample)
        modules = {
            state: _run(["-c", MODULES], variables) for state, variables in environments.items()
        }
    rows = []
    for (what, state), samples in found.items():
        spent, computed = zip(*samples, strict=True)
        figures = min(spent), statistics.median(spent), min(computed), statistics.median(computed)
        rows.append((what, state, *(f"{figure:.0f}" for figure in figures)))
    head = ("what", "state", "best", "median", "CPU best", "CPU median")
    print_table("From the start of a process, in ms", head, rows)
    for state, count in modules.items():
        print(f"`import uoarm`, {state}: {count.strip()} modules loaded")
    print(load())


def _measured(folder: Path) -> Mapping[str, Callable[[Environment], Sample]]:
    """Return what is measured by name; each takes the environment of a checkout."""
    small = folder / "small.yaml"
    small.write_text(SMALL, encoding="utf-8")
    chains = []
    for name, host in (("ours", "false"), ("hosted", "true")):
        file = folder / f"{name}.yaml"
        file.write_text(ROBOT.format(BRIDGE.format(BENCH, host)), encoding="utf-8")
        chains.append(FIRST_MESSAGE.format(file=file))
    whole = {
        "an interpreter alone": ("-c", "pass"),
        "`import attrs, cattrs`": ("-c", "import attrs, cattrs"),
        "`import uoarm`": ("-c", "import uoarm"),
        "`from uoarm import RobotManager`": ("-c", "from uoarm import RobotManager"),
        "`import uoarm._host.__main__`, a bridge host": ("-c", "import uoarm._host.__main__"),
        "`uoarm --help`": ("-m", "uoarm", "--help"),
        "`uoarm check`, a file of 10 lines": ("-m", "uoarm", "check", str(small)),
    }
    names = ("first message of a chain of three", "the same, each component in a host")
    return {name: partial(_whole, words) for name, words in whole.items()} | {
        name: partial(_to_first_message, code) for name, code in zip(names, chains, strict=True)
    }


def _whole(arguments: Sequence[str], variables: Environment) -> Sample:
    start, before = time.perf_counter(), _computed()
    _run(arguments, variables)
    return (time.perf_counter() - start) * 1000, (_computed() - before) * 1000


def _computed() -> float:
    """Return the seconds that processes have computed which have ended, and theirs."""
    times = os.times()
    return times.children_user + times.children_system


def _run(arguments: Sequence[str], variables: Environment) -> str:
    return subprocess.run(
        [sys.executable, *arguments],
        env=variables,
        capture_output=True,
        text=True,
        check=True,
        timeout=_LIMIT_SECONDS,
    ).stdout


def _to_first_message(code: str, variables: Environment) -> Sample:
    start, before = time.perf_counter(), _computed()
    with subprocess.Popen(
        [sys.executable, "-c", code], env=variables, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        if not process.stdout.readline():
            raise RuntimeError("the chain gave no message")
        spent = (time.perf_counter() - start) * 1000
        process.communicate(timeout=_LIMIT_SECONDS)
    return spent, (_computed() - before) * 1000


if __name__ == "__main__":
    main()
