"""Draws the pulse wave of whatever provides `pulseOximetry`, live, in the terminal."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import os
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from uoarm import Connection, RobotManager
from uoarm.errors import UoarmError

ROWS, COLUMNS = 8, 72
EIGHTHS = " \u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588"
REDRAW_SECONDS = 0.1


def main() -> int:
    """Plot until Ctrl-C, or for so many seconds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--file", default=str(Path(__file__).with_name("robot.yaml")))
    given = parser.parse_args()
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        with RobotManager.from_file(given.file) as robot, robot.request("pulseOximetry") as flow:
            plot(flow, time.monotonic() + given.seconds)
    except (UoarmError, TimeoutError) as error:
        print(f"no pulse: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        pass
    return 0


def plot(flow: Connection, end: float) -> None:
    """Draw every message; the screen is renewed ten times a second."""
    wave: deque[float] = deque([0.0] * COLUMNS, maxlen=COLUMNS)
    message: dict[str, Any] = {}
    drawn = 0.0
    with Live(console=Console(), auto_refresh=False) as live:
        while (now := time.monotonic()) < end:
            message = flow.get(timeout=5.0)
            wave.append(message.get("waveform", 0.0))
            if now - drawn > REDRAW_SECONDS:
                drawn = now
                live.update(picture(wave, message), refresh=True)
        live.update(picture(wave, message), refresh=True)


def picture(wave: deque[float], message: dict[str, Any]) -> Text:
    """Return the last seconds as bars of eighths of a character, and the numbers below."""
    levels = [round(min(1.0, max(0.0, height)) * ROWS * 8) for height in wave]
    lines = [
        "".join(EIGHTHS[min(8, max(0, level - row * 8))] for level in levels)
        for row in reversed(range(ROWS))
    ]
    pulse, spo2 = message.get("pulse", "--"), message.get("spo2", "--")
    heart = "\u2665" if message.get("beat") else " "
    quality = message.get("quality", "nothing yet")
    numbers = f"{heart} pulse {pulse} /min   SpO2 {spo2} %   {quality}"
    return Text("\n".join([*lines, numbers]), no_wrap=True, overflow="crop")


if __name__ == "__main__":
    try:
        sys.exit(main())
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
