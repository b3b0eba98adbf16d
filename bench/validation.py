"""What the check of one message costs: ours, jsonschema, jsonschema-rs and fastjsonschema.

The libraries are asked beside ours in turns. They judge plain JSON only: where a message has octets
or an array of numpy, they are given lists instead, and what making those costs stands apart.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bench._schema_cases import TWIST, image, laser_scan, odometry, sequence, zero_message
from bench.tables import print_table, row
from bench.turns import load
from uoarm._dataplane import make_check
from uoarm.bridge._full_validator import validator_of
from uoarm.model import Message, MessageStructure, Schema, ValidationMode

_ROUNDS = 200
_SECONDS = 3.0
_FLOAT32 = {
    "type": "number",
    "x-nonfinite": True,
    "minimum": -3.4028234663852886e38,
    "maximum": 3.4028234663852886e38,
}


def main() -> None:
    """Print what one check costs in microseconds, and what is right."""
    rows = []
    for name, (schema, message) in _cases().items():
        rows += _case(name, schema, message)
    title = f"Check of one message (us; {load()}, up to {_ROUNDS} rounds in turns)"
    print_table(title, ("message", "validator", "median", "p99", "says"), rows)


def _case(name: str, schema: Schema, message: Message) -> list[tuple[str, ...]]:
    plain = _plain(message)
    asked: dict[str, tuple[Callable[[Any], object], Any]] = {}
    check = make_check(MessageStructure(schema), ValidationMode.ALWAYS, "here")
    assert check is not None
    whole = validator_of(schema)
    asked["ours"] = check, message
    asked["ours, the whole validator"] = lambda value: next(whole.iter_errors(value), None), message
    for library, make in _LIBRARIES.items():
        try:
            asked[library] = make(importlib.import_module(library), schema), plain
        except ImportError:
            continue
    if plain is not message:
        asked["(lists of the buffers)"] = _plain, message
    samples: dict[str, list[float]] = {text: [] for text in asked}
    answers = {key: _answer(call, given) for key, (call, given) in asked.items()}
    for _ in range(_ROUNDS):
        for key, (call, given) in asked.items():
            if sum(samples[key]) > _SECONDS * 1e6:
                continue
            begun = time.perf_counter_ns()
            _answer(call, given)
            samples[key].append((time.perf_counter_ns() - begun) / 1000)
    return [(name, *row(by, took, answers[by])) for by, took in samples.items()]


def _answer(call: Callable[[Any], object], given: Any) -> str:
    try:
        call(given)
    except Exception as error:  # noqa: BLE001 - each library has its own
        return f"no: {str(error)[:60]}"
    return "yes"


def _draft_2020(library: Any, schema: Schema) -> Any:
    return library.Draft202012Validator(schema).validate


_LIBRARIES: dict[str, Callable[[Any, Schema], Any]] = {
    "jsonschema": _draft_2020,
    "jsonschema_rs": _draft_2020,
    "fastjsonschema": lambda library, schema: library.compile(schema),
}


def _cases() -> dict[str, tuple[Schema, Message]]:
    scan, numbers = laser_scan(sequence(_FLOAT32)), [1.5] * 1080
    picture = {"width": 160, "height": 120, "data": bytes(160 * 120 * 3)}
    return {
        "Twist": (TWIST, zero_message(TWIST)),
        "Odometry": (odometry(), zero_message(odometry())),
        "Image 160x120": (image(), zero_message(image(), picture)),
        **{
            f"LaserScan, {name}": (scan, zero_message(scan, {"ranges": ranges}))
            for name, ranges in (
                ("list", numbers),
                ("infinity", [1.5, math.inf] * 540),
                ("numpy", np.array(numbers, np.float32)),
            )
        },
    }


def _plain(value: Any) -> Any:
    """Return a message without buffers; the same object where there is none."""
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        made = {name: _plain(item) for name, item in value.items()}
        return made if any(made[name] is not item for name, item in value.items()) else value
    return value


if __name__ == "__main__":
    main()
