"""Drive from a terminal: `python terminal.py --speed 0.2 --seconds 2`; Ctrl-C stops."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import asyncio
import sys

from websockets.exceptions import InvalidHandshake

from uoarm.client import connect
from uoarm.errors import UoarmError


async def drive(url: str, speed: float, turn: float, seconds: float) -> None:
    """Hold one command for some seconds."""
    none = {"x": 0.0, "y": 0.0, "z": 0.0}
    command = {"linear": {**none, "x": speed}, "angular": {**none, "z": turn}}
    # A base that has stopped because its server was lost is not driven again by itself.
    async with connect(url, resume=False, reconnect=0) as robot:
        base = await robot.request("drive", wait=30)
        async with base.hold(command):
            await asyncio.sleep(seconds)


def main() -> None:
    """Read the arguments and drive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9080/")
    parser.add_argument("--speed", type=float, default=0.2, help="metres a second")
    parser.add_argument("--turn", type=float, default=0.0, help="radians a second")
    parser.add_argument("--seconds", type=float, default=2.0)
    options = parser.parse_args()
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        asyncio.run(drive(options.url, options.speed, options.turn, options.seconds))
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
    except (OSError, InvalidHandshake, UoarmError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
