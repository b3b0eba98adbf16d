"""What `import uoarm` costs in time and memory."""

from __future__ import annotations

import statistics
import subprocess
import sys

from bench.tables import print_table

_MEASURE = """
import resource, sys, time
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
start = time.perf_counter()
{action}
spent = time.perf_counter() - start
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(spent * 1000, (after - before) / 1024, len(sys.modules))
"""


def main() -> None:
    """Print the table of imports."""
    rows = []
    for action in (
        "import attrs, cattrs",
        "import uoarm",
        "import uoarm.schema",
        "import uoarm.cli",
    ):
        runs = [_run(action) for _ in range(9)]
        milliseconds, megabytes, modules = (
            statistics.median(column) for column in zip(*runs, strict=True)
        )
        rows.append((f"`{action}`", f"{milliseconds:.0f}", f"{megabytes:.1f}", f"{modules:.0f}"))
    print_table("Imports in a fresh process", ("what", "ms", "MB more", "modules loaded"), rows)


def _run(action: str) -> tuple[float, ...]:
    done = subprocess.run(
        [sys.executable, "-c", _MEASURE.format(action=action)],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    return tuple(float(word) for word in done.stdout.split())


if __name__ == "__main__":
    main()
