"""What judging meaning adds to judging shape: CPU time of one edge, with and without it."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

from bench._schema_cases import image, laser_scan, odometry, pose_stamped
from bench.tables import print_table
from uoarm._adapt import check_edge
from uoarm.model import Meaning, MeaningLevel, MessageStructure

ROUNDS = 200
OFF = Meaning(MeaningLevel.OFF)


def main() -> None:
    """Print the table."""
    rows = []
    for name, made in (
        ("PoseStamped", pose_stamped), ("LaserScan", laser_scan), ("Image", image),
        ("Odometry", odometry),
    ):  # fmt: skip
        for what, other in (
            ("itself", deepcopy(made())),
            ("a wider one", _wider(deepcopy(made()))),
        ):
            rows.append(
                _measure(f"{name} into {what}", _with_units(deepcopy(made())), _with_units(other))
            )
    head = ("edge", "shape, us: median (p99)", "and meaning, us", "times")
    print_table("One edge judged", head, rows)


def _measure(name: str, one: Any, other: Any) -> tuple[str, ...]:
    producer, consumer = MessageStructure(one), MessageStructure(other)
    took: dict[str, list[float]] = {"off": [], "stated": []}
    for _ in range(ROUNDS):
        for level, meaning in (("off", OFF), ("stated", Meaning())):
            start = time.process_time_ns()
            verdict = check_edge(producer, consumer, None, (), meaning)
            took[level].append((time.process_time_ns() - start) / 1000)
            assert verdict.compatible, verdict.reasons
    ratio = statistics.median(took["stated"]) / statistics.median(took["off"])
    return (name, *(_shown(took[level]) for level in took), f"{ratio:.2f}")


def _shown(values: list[float]) -> str:
    return f"{statistics.median(values):.0f} ({sorted(values)[int(len(values) * 0.99)]:.0f})"


def _parts(schema: Any) -> Iterator[dict[str, Any]]:
    if isinstance(schema, dict):
        yield schema
        for one in schema.values():
            yield from _parts(one)
    elif isinstance(schema, list):
        for one in schema:
            yield from _parts(one)


def _with_units(schema: Any) -> Any:
    for one in _parts(schema):
        if one.get("type") == "number":
            one["x-unit"] = "m"
    return schema


def _wider(schema: Any) -> Any:
    for one in _parts(schema):
        one.pop("maximum", None)
        one.pop("maxItems", None)
    return schema


if __name__ == "__main__":
    main()
