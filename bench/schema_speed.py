# ruff: noqa: E501 - a table is read best with one case a line
"""CPU time of the containment checker for robot types, side by side with another checkout.

Usage: ``python bench/schema_speed.py [--against PATH_TO_OTHER_SRC] [--rounds 10] [NAME ...]``. Each
round asks every pair in a fresh process of each checkout, one checkout after the other, so that a
busy machine is as busy for both.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from bench._schema_cases import (
    BOOLEAN,
    FLOAT64,
    STRING,
    Case,
    Schema,
    image,
    integer,
    laser_scan,
    message,
    odometry,
    pose_stamped,
    sequence,
)

_OURS = Path(__file__).parents[1] / "src"
_WARM = 3
_MANY = 30
_ENOUGH_MS = 500.0
_PATIENCE = 600


def point_cloud(data: Schema) -> Schema:
    field = message(name=STRING, offset=integer(32), datatype=integer(8), count=integer(32))
    return message(
        header=pose_stamped()["properties"]["header"],  # type: ignore[index] # it has properties
        height=integer(32),
        width=integer(32),
        fields=sequence(field),
        is_bigendian=BOOLEAN,
        point_step=integer(32),
        row_step=integer(32),
        data=data,
        is_dense=BOOLEAN,
    )


def five_types(count: int, last: Schema) -> Schema:
    types = (FLOAT64, STRING, BOOLEAN, integer(8), integer(32, signed=True))
    return message(**{f"field_{n}": types[n % 5] for n in range(count - 1)}, last=last)


def leaves(last: Schema) -> Schema:
    """59 records of six numbers each: 354 leaves."""
    record = message(**dict.fromkeys("abcdef", FLOAT64))
    return message(**{f"record_{n}": record for n in range(58)}, last=message(a=last, b=FLOAT64, c=FLOAT64, d=FLOAT64, e=FLOAT64, f=FLOAT64))  # fmt: skip


_NULLABLE: Schema = {"type": ["string", "null"]}
_BYTES = sequence(integer(8))
_CASES = (
    Case("", "PoseStamped", pose_stamped(), pose_stamped(), contained=True),
    Case("", "PoseStamped, refused", pose_stamped(_NULLABLE), pose_stamped(), contained=False),
    Case("", "LaserScan", laser_scan(), laser_scan(), contained=True),
    Case("", "LaserScan, 720 into any", laser_scan(sequence(FLOAT64, 720)), laser_scan(), True),
    Case("", "LaserScan, refused", laser_scan(), laser_scan(sequence(FLOAT64, 720)), False),
    Case("", "Image", image(), image(), contained=True),
    Case("", "Image, refused", image(sequence(integer(8, signed=True))), image(), contained=False),
    Case("", "Odometry", odometry(), odometry(), contained=True),
    Case("", "Odometry, into nullable", odometry(), odometry(_NULLABLE), contained=True),
    Case("", "Odometry, refused", odometry(_NULLABLE), odometry(), contained=False),
    Case("", "PointCloud2, bounded into any", point_cloud({**_BYTES, "maxItems": 10**6}), point_cloud(_BYTES), True),
    Case("", "PointCloud2, refused", point_cloud(_BYTES), point_cloud({**_BYTES, "maxItems": 10**6}), False),
    Case("", "354 leaves", leaves(integer(8)), leaves(FLOAT64), contained=True),
    Case("", "354 leaves, refused", leaves(FLOAT64), leaves(integer(8)), contained=False),
    Case("", "2,000 fields", five_types(2_000, integer(8)), five_types(2_000, FLOAT64), True),
    Case("", "2,000 fields, refused", five_types(2_000, FLOAT64), five_types(2_000, integer(8)), False),
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, help="the `src` of another checkout")
    parser.add_argument("--rounds", type=int, default=10, help="processes of each checkout")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("names", nargs="*", help="parts of the names to run; all without")
    options = parser.parse_args()
    chosen = [c for c in _CASES if not options.names or any(n in c.name for n in options.names)]
    if options.worker is not None:
        _work(options.worker, chosen)
        return
    sources = [_OURS, *([options.against] if options.against else [])]
    times: dict[tuple[Path, str], list[float]] = {}
    before = os.getloadavg()[0]
    for round_number in range(options.rounds):
        for source in sources[:: -1 if round_number % 2 else 1]:
            for name, found in _ask(source, options.names).items():
                times.setdefault((source, name), []).extend(found)
    print(f"CPython {platform.python_version()}, load {before:.1f} to {os.getloadavg()[0]:.1f};")
    print("CPU ms of one check, median / 95th percentile\n")
    print(f"| pair | this checkout |{' the other |' * (len(sources) - 1)}")
    print("|---|" + "---|" * len(sources))
    for case in chosen:
        cells = (_cell(times[source, case.name]) for source in sources)
        print(f"| {case.name} | {' | '.join(cells)} |")


def _ask(source: Path, names: list[str]) -> dict[str, list[float]]:
    command = [sys.executable, __file__, "--worker", str(source.resolve()), *names]
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, timeout=_PATIENCE
    )  # fmt: skip
    found: dict[str, list[float]] = json.loads(done.stdout)
    return found


def _work(source: Path, cases: list[Case]) -> None:
    """Time every pair in this process; the schemas are parsed from text, as they come in life."""
    sys.path.insert(0, str(source))
    from uoarm import schema  # noqa: PLC0415 - of the checkout that is asked for

    assert Path(schema.__file__).is_relative_to(source), schema.__file__
    times: dict[str, list[float]] = {}
    for case in cases:
        text = json.dumps([case.producer, case.consumer])
        found: list[float] = []
        while len(found) < _WARM + 2 or (len(found) < _MANY and sum(found) < _ENOUGH_MS):
            producer, consumer = json.loads(text)
            start = time.process_time()
            verdict = schema.check(producer, consumer)
            found.append((time.process_time() - start) * 1e3)
            assert (verdict.undecided, verdict.compatible) == (None, case.contained), case.name
        times[case.name] = found[_WARM:]
    print(json.dumps(times))


def _cell(times: list[float]) -> str:
    return f"{statistics.median(times):.2f} / {statistics.quantiles(times, n=20)[-1]:.2f}"


if __name__ == "__main__":
    main()
