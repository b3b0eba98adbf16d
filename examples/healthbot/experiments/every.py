"""Every experiment, one after another: the paper's evaluation as tables, in Markdown.

Exit code: 0 when all of them ran, 1 when one did not, 130 when interrupted.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import subprocess
import sys
from pathlib import Path

_HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(_HERE.parent))

from healthbot_scene.needs import missing  # noqa: E402 - found once the path is set

_NAMES = ("interoperability", "compatibility", "heterogeneous", "monitoring", "latency")
_RECORDED = {"monitoring", "latency"}


def main() -> int:
    """Run them and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", type=Path, metavar="FOLDER", help="write figures for plots")
    options = parser.parse_args()
    if options.record:
        try:
            options.record.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            parser.error(f"--record: {options.record} is no folder: {error.strerror}")
    lacking = missing()
    for need in lacking:
        print(need, file=sys.stderr)
    if any(need.vital for need in lacking):
        return 1
    failed = 0
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        for name in _NAMES:
            print(f"... {name}", file=sys.stderr, flush=True)
            command = [sys.executable, str(_HERE / f"{name}.py")]
            if options.record and name in _RECORDED:
                command += ["--record", str(options.record / f"{name}.json")]
            failed += subprocess.run(command, check=False).returncode != 0
    except KeyboardInterrupt:
        return 130
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
