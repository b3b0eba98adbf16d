"""An application asks for faceRecognition, and gets it from whatever is installed.

Run `python examples/vision/demo.py --help`. Exit codes: 0 everyone was recognised; 1 a person
was not, or pictures were lost; 2 it could not run; 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def main() -> int:
    """Run the demo and return its exit code."""
    parser = argparse.ArgumentParser(description="Ask for faceRecognition and see who is there.")
    parser.add_argument("--light", action="store_true", help="do without dlib, as if not installed")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--output", type=Path, default=ROOT / "demo-output", metavar="FOLDER")
    options = parser.parse_args()
    try:
        from rich.console import Console  # noqa: PLC0415 - what is missing is reported below
        from vision_demo.packages import FootageError  # noqa: PLC0415
        from vision_demo.run import run  # noqa: PLC0415

        from uoarm import UoarmError  # noqa: PLC0415
    except ModuleNotFoundError as error:
        print(f"{error.name} is not installed: pip install '.[vision-lbph,vision-dlib]'")
        return 2
    except KeyboardInterrupt:
        return 130
    cache = Path(os.environ.get("UOARM_CACHE", ROOT / ".cache")) / "vision"
    console = Console(stderr=options.json)
    try:
        result = run(
            HERE / "robot.yaml", cache, options.output, light=options.light, console=console
        )
    except (FootageError, UoarmError, OSError) as error:
        console.print(str(error), style="red", markup=False, highlight=False, soft_wrap=True)
        return 2
    except KeyboardInterrupt:
        console.print("interrupted; everything is closed")
        return 130
    if options.json:
        print(result.as_json(), flush=True)
    return 1 if result.problems else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
