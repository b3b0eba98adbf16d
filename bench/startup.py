"""What a start costs: the import, the commands, the way to the first message; whole processes.

`python -m bench.startup --before FOLDER --rounds 15` measures this state and the one of another
checkout in turns, so that both see the same neighbours. Every figure is the time from the start of
a process: to its end, or to its first message. Beside it stands what the process, and those that
it waited for, have computed, which neighbours disturb less. The first round, which writes Python's
cache of compiled modules, is not counted.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from bench.request import BRIDGE, GOAL, ROBOT
from bench.tables import print_table

HERE = Path(__file__).parents[1]
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path, help="a checkout of another state")
    parser.add_argument("--rounds", type=int, default=9)
    given = parser.parse_args()
    states = {"now": HERE, **({"before": given.before.resolve()} if given.before else {})}
    found: dict[tuple[str, str], list[Sample]] = {}
    loads = []
    with tempfile.TemporaryDirectory() as folder:
        measured = _measured(Path(folder))
        environments = {
            state: _environment(checkout, Path(folder, state)) for state, checkout in states.items()
        }
        for number in range(given.rounds + 1):
            for what, take in measured.items():
                for state, environment in environments.items():
                    sample = take(environment)
                    if number:
                        found.setdefault((what, state), []).append(sample)
            loads.append(os.getloadavg()[0])
        modules = {state: _run(["-c", MODULES], env) for state, env in environments.items()}
    rows = []
    for (what, state), samples in found.items():
        spent, computed = zip(*samples, strict=True)
        figures = min(spent), statistics.median(spent), min(computed), statistics.median(computed)
        rows.append((what, state, *(f"{figure:.0f}" for figure in figures)))
    head = ("what", "state", "best", "median", "CPU best", "CPU median")
    print_table("From the start of a process, in ms", head, rows)
    for state, count in modules.items():
        print(f"`import uoarm`, {state}: {count.strip()} modules loaded")
    print(f"load {min(loads):.1f} to {max(loads):.1f}")


def _environment(checkout: Path, cache: Path) -> Environment:
    """Return the environment of a process with a checkout's uoarm, and a cache of its own."""
    path = os.pathsep.join((str(checkout / "src"), str(HERE / "bench")))
    variables = {"PYTHONPATH": path, "PYTHONPYCACHEPREFIX": str(cache)}
    return {**os.environ, **variables, "PYTHONDONTWRITEBYTECODE": ""}


def _measured(folder: Path) -> Mapping[str, Callable[[Environment], Sample]]:
    """Return what is measured by name; each takes the environment of a checkout."""
    small = folder / "small.yaml"
    small.write_text(SMALL, encoding="utf-8")
    chains = []
    for name, host in (("ours", "false"), ("hosted", "true")):
        file = folder / f"{name}.yaml"
        file.write_text(ROBOT.format(BRIDGE.format(HERE / "bench", host)), encoding="utf-8")
        chains.append(FIRST_MESSAGE.format(file=file))
    ours, hosted = chains
    return {
        "an interpreter alone": lambda env: _whole(["-c", "pass"], env),
        "`import attrs, cattrs`": lambda env: _whole(["-c", "import attrs, cattrs"], env),
        "`import uoarm`": lambda env: _whole(["-c", "import uoarm"], env),
        "`from uoarm import RobotManager`": lambda env: _whole(
            ["-c", "from uoarm import RobotManager"], env
        ),
        "`import uoarm._host.__main__`, a bridge host": lambda env: _whole(
            ["-c", "import uoarm._host.__main__"], env
        ),
        "`uoarm --help`": lambda env: _whole(["-m", "uoarm", "--help"], env),
        "`uoarm check`, a file of 10 lines": lambda env: _whole(
            ["-m", "uoarm", "check", str(small)], env
        ),
        "first message of a chain of three": lambda env: _to_first_message(ours, env),
        "the same, each component in a host": lambda env: _to_first_message(hosted, env),
    }


def _whole(arguments: list[str], environment: Environment) -> Sample:
    start, before = time.perf_counter(), _computed()
    _run(arguments, environment)
    return (time.perf_counter() - start) * 1000, (_computed() - before) * 1000


def _computed() -> float:
    """Return the seconds that processes have computed which have ended, and theirs."""
    times = os.times()
    return times.children_user + times.children_system


def _run(arguments: list[str], environment: Environment) -> str:
    return subprocess.run(
        [sys.executable, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=_LIMIT_SECONDS,
    ).stdout


def _to_first_message(code: str, environment: Environment) -> Sample:
    start, before = time.perf_counter(), _computed()
    with subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        if not process.stdout.readline():
            raise RuntimeError("the chain gave no message")
        spent = (time.perf_counter() - start) * 1000
        process.communicate(timeout=_LIMIT_SECONDS)
    return spent, (_computed() - before) * 1000


if __name__ == "__main__":
    main()
