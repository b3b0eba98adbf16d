"""Inclusion of patterns by our automata and by two public libraries: answer and CPU ms.

Usage: ``python bench/schema_automata.py``, after ``pip install interegular greenery``. The
libraries are given the bare expressions, which mean the same to all three.
"""

from __future__ import annotations

import importlib
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from uoarm.schema import check
from uoarm.schema.regex import compile_pattern, walker_of

_BYTE = "(25[0-5]|2[0-4][0-9]|1?[0-9]?[0-9])"
_PAIRS = {
    "letters in letters and digits": ("[a-z]+", "[a-z0-9]*"),
    "2 to 4 in 1 to 5": ("[a-z]{2,4}", "[a-z]{1,5}"),
    "an address in its hull": (f"({_BYTE}[.]){{3}}{_BYTE}", "[0-9.]{7,15}"),
    "a topic name in its letters": (
        "/?([A-Za-z_][A-Za-z0-9_]*/)*[A-Za-z_][A-Za-z0-9_]*",
        "[A-Za-z0-9_/]+",
    ),
    "1 to 64 in 1 to 65": ("[a-z]{1,64}", "[a-z]{1,65}"),
    "1 to 255 in 1 to 256": ("[a-z]{1,255}", "[a-z]{1,256}"),
    "ninth letter from the end": ("(a|b)*a(a|b){8}", "(a|b)+"),
}
_LIMIT_SECONDS = 20


class LateError(BaseException):
    """Above Exception, so that nothing swallows it."""


def main() -> None:
    signal.signal(signal.SIGALRM, _late)
    engines = {"ours": _ours, "interegular": _interegular, "greenery": _greenery}
    print("| pair | " + " | ".join(engines) + " |\n|---|---|---|---|")
    for name, pair in _PAIRS.items():
        cells = [_measure(engine, *pair) for engine in engines.values()]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def _ours(one: str, other: str) -> object:
    compile_pattern.cache_clear()
    walker_of.cache_clear()
    producer = {"type": "string", "pattern": f"^({one})$"}
    return check(producer, {"pattern": f"^({other})$"}).compatible


def _interegular(one: str, other: str) -> object:
    parse: Any = importlib.import_module("interegular").parse_pattern
    return parse(one).to_fsm().issubset(parse(other).to_fsm())


def _greenery(one: str, other: str) -> object:
    parse: Any = importlib.import_module("greenery").parse
    return parse(one).to_fsm() <= parse(other).to_fsm()


def _measure(engine: Callable[[str, str], object], one: str, other: str) -> str:
    signal.alarm(_LIMIT_SECONDS)
    try:
        engine("a", "a")  # the import is not measured
        started = time.process_time()
        answer = engine(one, other)
        return f"{'yes' if answer else 'no'} {(time.process_time() - started) * 1e3:.1f}"
    except LateError:
        return "time-out"
    except Exception as error:  # noqa: BLE001 - whatever it raises is its answer
        return type(error).__name__
    finally:
        signal.alarm(0)


def _late(*_: object) -> None:
    raise LateError


if __name__ == "__main__":
    main()
