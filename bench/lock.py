"""How long a thousand edges take against another lock: none of them changed, and all of them."""

from __future__ import annotations

import time
from copy import deepcopy
from typing import Any

from attrs import evolve

from bench._schema_cases import laser_scan, odometry, pose_stamped
from bench.tables import print_table
from uoarm._lock import Lock, Outcome, compare
from uoarm._lock._record import LockedEdge, LockedFunction, LockedPart, LockedStructure

EDGES = 1_000


def main() -> None:
    """Print the table."""
    before = _lock(0)
    rows = []
    for what, after in (("none", _lock(0)), ("all", _lock(1))):
        start = time.perf_counter()
        found = list(compare(before, after))
        took = time.perf_counter() - start
        assert all(one.outcome is Outcome.FITS for one in found if "->" in one.subject)
        rows.append((what, f"{took:.2f}"))
    print_table(f"{EDGES:,} edges against a lock", ("changed", "seconds"), rows)


def _lock(change: int) -> Lock:
    structures, functions = {}, {}
    for number in range(EDGES):
        made: Any = deepcopy((pose_stamped, laser_scan, odometry)[number % 3]())
        made["properties"][f"field{number}"] = {"type": "number", "minimum": change}
        made["required"] = [*made["required"], f"field{number}"]
        taken = deepcopy(made)
        taken["properties"][f"field{number}"] = {"type": "number"}
        names = f"out{number}", f"in{number}"
        for name, one in zip(names, (made, taken), strict=True):
            structures[name] = LockedStructure("", one)
        parts = (
            LockedPart("a", "a", "python", "python", {"output.default": names[0]}),
            LockedPart("b", "b", "python", "python", {"input.default": names[1]}),
        )
        edge = LockedEdge("a", "default", "b", "default", None, (), "stated", (), ())
        functions[f"f{number}"] = LockedFunction(
            tuple(evolve(part, component=f"{part.component}{number}") for part in parts),
            (evolve(edge, producer=f"a{number}", consumer=f"b{number}"),),
        )
    return Lock(functions, structures)


if __name__ == "__main__":
    main()
