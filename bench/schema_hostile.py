"""Hostile pairs under a budget: seconds and peak memory of each, in a process of its own.

Usage: ``python bench/schema_hostile.py [--seconds 1] [NAME ...]``.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
if "--cpu" in sys.argv:
    time.monotonic = time.process_time  # before the checker takes its clock

from tests.schema._hostile import HOSTILE

from uoarm.schema import Budget, check

_ALLOWED = 1.2
_OCTETS = 256 * 2**20
_PATIENCE = 15.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="the budget of each check")
    parser.add_argument("--cpu", action="store_true", help="let the budget count CPU seconds")
    parser.add_argument("names", nargs="*", help="parts of the names to run; all without")
    options = parser.parse_args()
    print(f"CPython {sys.version.split()[0]}; load {os.getloadavg()[0]:.1f}; CPU seconds\n")
    print("| pair | CPU s | peak MB | answer |")
    print("|---|---|---|---|")
    over = 0
    for name in HOSTILE:
        if options.names and not any(part in name for part in options.names):
            continue
        cpu, octets, answer = _ask(name, options.seconds)
        kept = cpu <= options.seconds * _ALLOWED and octets <= _OCTETS
        over += not kept
        flag = "" if kept else " **over**"
        print(f"| {name} | {cpu:.2f} | {octets / 2**20:.0f} | {answer}{flag} |", flush=True)
    print(f"\n{over} over the budget")


def _ask(name: str, seconds: float) -> tuple[float, int, str]:
    context = get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_answer, args=(name, seconds, theirs))
    process.start()
    theirs.close()
    try:
        if ours.poll(_PATIENCE):
            found: tuple[float, int, str] = ours.recv()
            return found
    except EOFError:
        return 0.0, 0, "died"
    finally:
        process.kill()
        process.join()
    return _PATIENCE, 0, "no answer"


def _answer(name: str, seconds: float, line: Connection) -> None:
    producer, consumer = HOSTILE[name]()
    resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31))
    before = _peak()
    started = time.process_time()
    try:
        answer = _shown(check(producer, consumer, budget=Budget(seconds=seconds)))
    except Exception as error:  # noqa: BLE001 - the bench tells what should not be
        answer = f"{type(error).__name__}: {error}"[:80]
    line.send((time.process_time() - started, _peak() - before, answer))


def _shown(verdict: Any) -> str:
    if verdict.undecided is not None:
        return f"undecided: {verdict.undecided}"[:120]
    return "yes" if verdict.compatible else "no"


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    main()
