"""Run every benchmark of this folder, one after another, each in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
OTHER = {
    "__init__",
    "__main__",
    "attack",
    "chain_components",
    "mutation",
    "soak",
    "tables",
    "turns",
}


def main() -> int:
    """Print every table; return 0 when all ran."""
    wanted = sys.argv[1:]
    names = sorted(
        path.stem
        for path in HERE.glob("*.py")
        if path.stem not in OTHER and not path.stem.startswith("_")
    )
    if unknown := sorted(set(wanted) - set(names)):
        print(f"no benchmark is named {', '.join(unknown)}: {', '.join(names)}", file=sys.stderr)
        return 2
    failed = 0
    for name in names:
        if wanted and name not in wanted:
            continue
        print(f"... {name}", file=sys.stderr, flush=True)
        done = subprocess.run(
            [sys.executable, "-m", f"bench.{name}"], cwd=HERE.parent, check=False, timeout=1800
        )
        failed += done.returncode != 0
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
