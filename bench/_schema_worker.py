# ruff: noqa: PLC0415 - each checker is imported in its own environment only
"""Answers and times containment questions with one checker; run by the interpreter that has it.

Usage: ``python _schema_worker.py NAME [--once] < questions.jsonl > answers.jsonl``. It needs the
standard library only, beside the checker itself.
"""

from __future__ import annotations

import json
import signal
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Schema = dict[str, object]
Ask = Callable[[Schema, Schema], "bool | str"]

_LIMIT_SECONDS = 5
_ENOUGH_SECONDS = 0.2
_MOST_REPEATS = 200


class LateError(BaseException):
    """Above Exception, so that a checker that catches everything does not swallow it."""


def uoarm() -> Ask:
    from uoarm.schema import check

    def ask(producer: Schema, consumer: Schema) -> bool | str:
        verdict = check(producer, consumer)
        return "undecided" if verdict.undecided is not None else verdict.compatible

    return ask


def jsonsubschema() -> Ask:
    from jsonsubschema import isSubschema  # type: ignore[import-not-found] # in its own environment

    return lambda producer, consumer: bool(isSubschema(producer, consumer))


def ghga() -> Ask:
    from jsonsubschema import is_subschema

    return lambda producer, consumer: bool(is_subschema(producer, consumer))


def jsoncompat() -> Ask:
    from jsoncompat import check_compat  # type: ignore[import-not-found] # in its own environment

    return lambda producer, consumer: bool(
        check_compat(_text(producer), _text(consumer), "deserializer")
    )


def isjsonschemasubset() -> Ask:
    from isjsonschemasubset import (  # type: ignore[import-not-found] # in its own environment
        Value,
        issubset,
    )
    from pydantic import TypeAdapter

    read = TypeAdapter(Value).validate_python
    return lambda producer, consumer: not list(issubset(read(producer), read(consumer)))


CHECKERS = {
    "uoarm": uoarm,
    "jsonsubschema": jsonsubschema,
    "ghga-jsonsubschema": ghga,
    "jsoncompat": jsoncompat,
    "isjsonschemasubset": isjsonschemasubset,
}


def main() -> None:
    ask = CHECKERS[sys.argv[1]]()
    signal.signal(signal.SIGALRM, _too_late)
    for line in sys.stdin:
        with _deep_stack():
            producer, consumer = json.loads(line)
        enough = 0.0 if "--once" in sys.argv else _ENOUGH_SECONDS
        print(json.dumps(_measure(ask, producer, consumer, enough)), flush=True)


@contextmanager
def _deep_stack() -> Iterator[None]:
    """For reading and writing JSON of 500 levels; the checkers run with the usual limit."""
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(20_000)
    try:
        yield
    finally:
        sys.setrecursionlimit(limit)


def _text(value: object) -> str:
    with _deep_stack():
        return json.dumps(value)


def _measure(ask: Ask, producer: Schema, consumer: Schema, enough: float) -> dict[str, object]:
    times: list[float] = []
    signal.alarm(_LIMIT_SECONDS)
    try:
        while not times or (sum(times) < enough and len(times) < _MOST_REPEATS):
            started = time.perf_counter()
            answer = ask(producer, consumer)
            times.append(time.perf_counter() - started)
    except LateError:
        return {"answer": "time-out"}
    except Exception as error:  # noqa: BLE001 - whatever a checker raises is its answer
        return {"answer": f"error: {type(error).__name__}"}
    finally:
        signal.alarm(0)
    return {"answer": answer, "ms": statistics.median(times) * 1e3, "worst": max(times) * 1e3}


def _too_late(*_: object) -> None:
    raise LateError


if __name__ == "__main__":
    main()
