"""The demo's chain without an end, for browsers and other clients of `uoarm serve`.

Run `python examples/vision/live.py --help`. Exit codes: 0 ended by Ctrl-C or SIGTERM; 2 it could
not run.
"""

from __future__ import annotations

import argparse
import os
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from uoarm.model import Message, Robot
    from uoarm.server import Server

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
RATE = 8


def main() -> int:
    """Serve until it is interrupted, and return the exit code."""
    parser = argparse.ArgumentParser(description="Show who is there to browsers.")
    parser.add_argument("--port", type=int, default=9080)
    options = parser.parse_args()
    try:
        from rich.console import Console  # noqa: PLC0415 - what is missing is reported below
        from vision_demo.packages import FootageError  # noqa: PLC0415

        from uoarm import UoarmError  # noqa: PLC0415

        console = Console()
        serve(options.port, console)
    except KeyboardInterrupt:  # also as it imports: what the last clause names is not there then
        print("interrupted")
    except ModuleNotFoundError as error:
        print(f"{error.name} is not installed: `make live` installs what it needs")
        return 2
    except (FootageError, UoarmError, OSError, OverflowError) as error:
        console.print(str(error), style="red", markup=False, highlight=False, soft_wrap=True)
        return 2
    return 0


def serve(port: int, console: Console) -> None:
    """Fetch, enrol, run the chain and serve it until SIGTERM or Ctrl-C.

    Fetching and enrolling take minutes, so that the port is looked at before.

    Sets UOARM_VISION, which the configuration names.

    Raises:
        FootageError: footage cannot be had.
        UoarmError: no plan fits.
        OSError, OverflowError: the port is taken, or is none.
    """
    from vision_demo.ports import listens  # noqa: PLC0415 - beside the other imports
    from vision_demo.run import enrol_persons, fetch  # noqa: PLC0415 - needs the extras

    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.server import ServerOptions, run  # noqa: PLC0415 - needs the extra `server`

    if listens(port):
        text = f"port {port} is in use, perhaps by another make live; take another with"
        raise OSError(f"{text} make live PORT=..., or live.py --port ...")
    footage = fetch(Path(os.environ.get("UOARM_CACHE", ROOT / ".cache")) / "vision", console)
    os.environ["UOARM_VISION"] = str(footage.folder)
    with RobotManager(endless(HERE / "robot.yaml")) as robot:
        enrol_persons(robot.resolve("faceRecognition"), footage, console)
        with robot.request("faceRecognition", on_message=ignore):
            run(robot, ServerOptions(port=port), partial(announce, console))


def announce(console: Console, server: Server) -> None:
    """Say where the pictures are: the dashboard shows them once they are asked for."""
    page = f"http://127.0.0.1:{server.ports[0]}/#/graph/function/faceRecognition/use"
    console.print(f"open {page}", "and press Watch; Ctrl-C ends", sep="\n", soft_wrap=True)


def ignore(message: Message) -> None:
    """Let a picture pass: those who look at it are elsewhere."""
    del message


def endless(file: Path) -> Robot:
    """Return the robot of a configuration whose recordings play again and again, evenly."""
    import yaml  # noqa: PLC0415 - reported above where it is missing

    from uoarm.config import loads  # noqa: PLC0415

    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    for component in data["functions"]["camera"]["components"]:
        component["parameters"] |= {"loop": True, "rate": RATE}
    return loads(yaml.safe_dump(data), origin=str(file))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
