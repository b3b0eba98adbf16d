"""How the manager's work grows with its functions: `python -m bench scale`, or with options.

    python -m bench.scale --sizes 10 100 1000 5000 --before FOLDER --rounds 3

Each size runs in a process of its own, with `--before` in turns with another checkout. Its
processor time is what counts, the least of the rounds, so that neighbours matter little. Of N
functions, each with a spare candidate, a tenth is killed, and half have their first one in a bridge
that dies while they are open. All is in memory, so that the time is the manager's own. The exponent
of a step says how it grows from one size to the next: 1 with the functions, 2 with their square.
When the interpreter's garbage collector looks at all that the process has is chance, so that there
are exponents of the time without it, too.
"""

from __future__ import annotations

import itertools
import json
import logging
import math
import time
from collections.abc import Callable

from bench.tables import print_table
from bench.turns import Collections, measured_apart, parser, states

_SIZES = (10, 100, 1000, 5000)
_STEPS = ("check", "start", "request", "status", "kill", "death", "apply", "close")
_LIMIT_SECONDS = 900.0
_BRIDGES = ("even", "odd", "spare")
_HEAD = (
    f"version: 1\nbridges: {{{', '.join(f'{name}: {{plugin: memory}}' for name in _BRIDGES)}}}\n"
)
Spent = dict[str, tuple[float, float]]
"""The seconds of processor time of each step, and those without the collector."""


def main() -> None:
    """Print what each step took at each size, and how it grows."""
    asked = parser(__doc__)
    asked.add_argument("--sizes", type=int, nargs="+", default=_SIZES, help="numbers of functions")
    asked.add_argument("--json", action="store_true", help="print JSON")
    given = asked.parse_args()
    sizes = sorted(set(given.sizes))
    folders = states(given)
    found: dict[str, dict[int, Spent]] = {state: {} for state in folders}
    for _, size, (state, folder) in itertools.product(range(given.rounds), sizes, folders.items()):
        spent = measured_apart(folder, "scale", size)
        before = found[state].get(size, spent)
        found[state][size] = {step: tuple(map(min, before[step], spent[step])) for step in _STEPS}
    if given.json:
        print(json.dumps(found, indent=2))
        return
    pairs = tuple(itertools.pairwise(sizes))
    rows = [
        (
            step,
            state,
            *(f"{1000 * by_size[size][step][0]:,.1f}" for size in sizes),
            *(_exponents(step, by_size, less, more) for less, more in pairs),
        )
        for step in _STEPS
        for state, by_size in found.items()
    ]
    between = (f"{less:,} to {more:,}" for less, more in pairs)
    head = ("ms", "state", *(f"{size:,}" for size in sizes), *between)
    print_table("Steps by the number of functions; exponents, without the collector", head, rows)


def _exponents(step: str, found: dict[int, Spent], less: int, more: int) -> str:
    """Return how a step grows from one size to another, as a power of the size."""
    whole, without = (
        math.log(large / small) / math.log(more / less)
        for small, large in zip(found[less][step], found[more][step], strict=True)
    )
    return f"{whole:.2f}, {without:.2f}"


def measure(size: int) -> None:
    """Print as JSON how many seconds each step takes with so many functions."""
    from uoarm import Connection, RobotManager  # noqa: PLC0415 - of the state that is measured
    from uoarm.config import loads  # noqa: PLC0415
    from uoarm.model import Health  # noqa: PLC0415
    from uoarm.testing import MemoryBridge, wait  # noqa: PLC0415

    collections = Collections(time.thread_time_ns)
    logging.getLogger("uoarm").setLevel(logging.CRITICAL)  # a line for each that dies
    spent: Spent = {}
    bridges = {name: MemoryBridge(name, {}) for name in _BRIDGES}
    for number in range(size):
        bridges[_first(number)].emitter(f"c{number}", {"type": "integer"})
        bridges["spare"].emitter(f"s{number}", {"type": "integer"})
    text = _HEAD + "functions:\n" + "".join(map(_function, range(size)))

    def timed(step: str, action: Callable[[], object]) -> None:
        collected, start = collections.spent, time.process_time()
        action()
        whole = time.process_time() - start
        spent[step] = whole, whole - (collections.spent - collected) / 1e9

    found = []
    timed("check", lambda: found.append(loads(text)))
    managers: list[RobotManager] = []
    timed("start", lambda: managers.append(RobotManager(found[0], bridges=bridges)))
    with managers[0] as manager:
        connections: list[Connection] = []

        def request() -> None:
            connections.extend(manager.request(f"f{number}") for number in range(size))

        def kill() -> None:
            for connection in connections[1::10]:
                connection.kill()

        def die() -> None:
            bridges["even"].report(Health.LOST, "it was killed")
            for connection in connections[::2]:
                wait(lambda: connection.gaps, timeout=_LIMIT_SECONDS)  # noqa: B023 - at once

        timed("request", request)
        timed("status", manager.status)
        timed("kill", kill)
        timed("death", die)
        changed = loads(text.replace(f"endpoint: [c{size - 1}]", f"endpoint: [s{size - 1}]", 1))
        timed("apply", lambda: manager.apply(changed, timeout=_LIMIT_SECONDS))
        timed("close", manager.close)
    print(json.dumps(spent))


def _first(number: int) -> str:
    return "odd" if number % 2 else "even"


def _function(number: int) -> str:
    return (
        f"  f{number}:\n"
        "    components:\n"
        f"      - {{name: c{number}, bridge: {_first(number)}, priority: 1,"
        f" output: {{endpoint: [c{number}]}}}}\n"
        f"      - {{name: s{number}, bridge: spare, output: {{endpoint: [s{number}]}}}}\n"
    )


if __name__ == "__main__":
    main()
