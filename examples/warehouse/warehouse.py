"""The whole warehouse: starts every part, shows what runs where, and ends them all.

Run `python examples/warehouse/warehouse.py --help`. Exit codes: 0 interrupted, or all orders of
--orders are done; 1 the robot died, or orders were not done in time; 2 a part could not be started.

The vehicles are simulated. Nothing here is a safety function.
"""

from __future__ import annotations

import argparse
import asyncio
import errno
import os
import signal
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "healthbot"), str(HERE.parent / "vision")]


def main() -> int:
    """Run the scene and return the exit code."""
    parser = argparse.ArgumentParser(description="Start the whole warehouse.")
    parser.add_argument("--robot", type=Path, default=HERE / "robot.yaml", help="another robot")
    parser.add_argument("--run", type=Path, metavar="FOLDER", help="keep logs and journals there")
    parser.add_argument(
        "--orders", type=int, metavar="N", help="place N orders; end once all are done"
    )
    parser.add_argument(
        "--duration", type=float, metavar="SECONDS", help="end after so long; with --orders: 1 then"
    )
    options = parser.parse_args()
    if options.orders is not None and options.orders < 1:
        parser.error(f"--orders {options.orders}: expected 1 or more")
    if options.duration is not None and not options.duration > 0:
        parser.error(f"--duration {options.duration:g}: expected seconds, more than 0")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return _run(options)
    except KeyboardInterrupt:
        print("Everything is ended.")
        return 0


def _run(options: argparse.Namespace) -> int:
    try:
        from warehouse_scene.parts import make_places, missing, parts_of  # noqa: PLC0415
    except ModuleNotFoundError as error:
        print(f"{error.name} is not installed: see examples/warehouse/README.md", file=sys.stderr)
        return 2
    lacking = missing()
    if lacking:
        print(*lacking, sep="\n", file=sys.stderr)
        return 2
    from healthbot_scene.crew import (  # noqa: PLC0415 - now it is there
        Crew,
        PartError,
        print_running,
        watch,
    )

    try:
        with tempfile.TemporaryDirectory(prefix="warehouse-") as temporary:
            places = make_places(options.run or Path(temporary))
            parts = parts_of(places, places.write_robot(options.robot))
            with Crew(places.run, places.environment()) as crew:
                crew.start_all(parts, print_running)
                print(f"To see the floor open {places.page_url}")
                print(f"To see into the robot open {places.robot_url.replace('ws', 'http', 1)}")
                print("Everything is ready; Ctrl-C ends it.", flush=True)
                if options.orders is not None:
                    from warehouse_scene.placing import place_and_wait  # noqa: PLC0415

                    limit = options.duration or float("inf")
                    work = place_and_wait(places.robot_url, options.orders, limit, _say)
                    return 0 if asyncio.run(work) else 1
                return watch(crew, options.duration)
    except BrokenPipeError:  # what it prints is read no more, as by `head`
        os._exit(1)
    except (PartError, OSError) as error:
        print(error, file=sys.stderr)
        if getattr(error, "errno", 0) == errno.ENOSPC:  # what waits would fail once more
            os._exit(2)
        return 2


def _say(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main())
