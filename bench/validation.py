"""What the check of one message costs: ours, jsonschema, jsonschema-rs and fastjsonschema.

The libraries are asked beside ours in turns. They judge plain JSON only: where a message has octets
or an array of numpy, they are given lists instead, and what making those costs stands apart.
"""

from __future__ import annotations

import importlib
import math
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.tables import at, print_table
from uoarm._dataplane import make_check
from uoarm._dataplane._full_validator import validator_of
from uoarm.model import Message, MessageStructure, Schema, ValidationMode

_ROUNDS = 200
_SECONDS = 3.0
_FLOAT32 = {
    "type": "number",
    "x-nonfinite": True,
    "minimum": -3.4028234663852886e38,
    "maximum": 3.4028234663852886e38,
}
_OCTETS = {"type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}}
_NUMBER = {"type": "number"}


def main() -> None:
    """Print what one check costs in microseconds, and what is right."""
    rows = []
    for name, (schema, message) in _cases().items():
        rows += _case(name, schema, message)
    load = os.getloadavg()[0]
    title = f"Check of one message (us; load {load:.1f}, up to {_ROUNDS} rounds in turns)"
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
            asked[library] = make(schema), plain
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
    return [
        (
            name,
            sample_name,
            f"{at(sorted(took), 0.5):,.1f}",
            f"{at(sorted(took), 0.99):,.1f}",
            answers[sample_name],
        )
        for sample_name, took in samples.items()
    ]


def _answer(call: Callable[[Any], object], given: Any) -> str:
    try:
        call(given)
    except Exception as error:  # noqa: BLE001 - each library has its own
        return f"no: {str(error)[:60]}"
    return "yes"


def _jsonschema(schema: Schema) -> Callable[[Any], object]:
    library: Any = importlib.import_module("jsonschema")
    check: Callable[[Any], object] = library.Draft202012Validator(schema).validate
    return check


def _jsonschema_rs(schema: Schema) -> Callable[[Any], object]:
    library: Any = importlib.import_module("jsonschema_rs")
    check: Callable[[Any], object] = library.Draft202012Validator(schema).validate
    return check


def _fastjsonschema(schema: Schema) -> Callable[[Any], object]:
    library: Any = importlib.import_module("fastjsonschema")
    check: Callable[[Any], object] = library.compile(schema)
    return check


_LIBRARIES = {
    "jsonschema": _jsonschema,
    "jsonschema-rs": _jsonschema_rs,
    "fastjsonschema": _fastjsonschema,
}


def _cases() -> dict[str, tuple[Schema, Message]]:
    vector = _closed(x=_NUMBER, y=_NUMBER, z=_NUMBER)
    turn = _closed(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
    header = _closed(
        stamp=_closed(sec={"type": "integer"}, nanosec={"type": "integer"}),
        frame_id={"type": "string"},
    )
    matrix = {"type": "array", "items": _NUMBER, "minItems": 36, "maxItems": 36}
    pose = _closed(pose=_closed(position=vector, orientation=turn), covariance=matrix)
    twist = _closed(linear=vector, angular=vector)
    odometry = _closed(
        header=header,
        child_frame_id={"type": "string"},
        pose=pose,
        twist=_closed(twist=twist, covariance=matrix),
    )
    ranges = {"type": "array", "items": _FLOAT32}
    scan = _closed(header=header, angle_min=_FLOAT32, ranges=ranges)
    image = _closed(header=header, width={"type": "integer", "minimum": 0}, data=_OCTETS)

    zero = dict.fromkeys("xyz", 0.5)
    stamp = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"}
    moves = {"linear": zero, "angular": zero}
    numbers = [0.5] * 36
    found = {
        "header": stamp,
        "child_frame_id": "base",
        "pose": {
            "pose": {"position": zero, "orientation": {**zero, "w": 1.0}},
            "covariance": numbers,
        },
        "twist": {"twist": moves, "covariance": numbers},
    }
    seen = {"header": stamp, "angle_min": -1.5, "ranges": [1.5] * 1080}
    picture = {"header": stamp, "width": 1920, "data": bytes(1920 * 1080 * 3)}
    return {
        "Twist": (twist, moves),
        "Odometry": (odometry, found),
        "LaserScan, list": (scan, seen),
        "LaserScan, infinity": (scan, {**seen, "ranges": [1.5, math.inf] * 540}),
        "LaserScan, numpy": (scan, {**seen, "ranges": np.full(1080, 1.5, np.float32)}),
        "Image 160x120": (image, {**picture, "data": bytes(160 * 120 * 3)}),
    }


def _closed(**fields: Schema) -> dict[str, object]:
    return {
        "type": "object",
        "properties": fields,
        "required": list(fields),
        "additionalProperties": False,
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
