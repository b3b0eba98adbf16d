"""Drives the base to the poses that are typed: `3 4`; `cancel` while it drives; `where`."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import math
import os
import select
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from uoarm import QueuePolicy, RobotManager
from uoarm.errors import UoarmError
from uoarm.model import StatusEvent

HERE = Path(__file__).parent


class Driver:
    """One goal after another, of whatever provides `goTo`."""

    def __init__(self, robot: RobotManager) -> None:
        self._status = robot.request("goTo.status", on_message=self._on_status)
        self._feedback = robot.request("goTo.feedback", on_message=self._on_feedback)
        self._result = robot.request("goTo.result", on_message=self._on_result)
        self._scan = robot.request("scan", queue=QueuePolicy(1))
        self._robot = robot
        robot.listen(self._on_event)
        self._goal = ""
        self._metres = 0

    def take(self, words: str) -> None:
        """Do what was typed."""
        if words == "cancel":
            self.cancel()
        elif words == "where":
            self.where()
        elif words:
            try:
                x, y = map(float, words.split())
            except ValueError:
                x = y = math.nan
            if math.isfinite(x) and math.isfinite(y):
                self.drive(x, y)
            else:
                print("expected two numbers such as `3 4`, `cancel` or `where`", flush=True)

    def drive(self, x: float, y: float) -> None:
        """Send a goal; what becomes of it is printed."""
        position, orientation = {"x": x, "y": y, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        stamp = {"sec": 0, "nanosec": 0}
        pose = {
            "header": {"frame_id": "map", "stamp": stamp},
            "pose": {"position": position, "orientation": orientation},
        }
        self._metres = sys.maxsize
        self._status.send({"pose": pose, "behavior_tree": ""}, "goal")

    def cancel(self) -> None:
        """Cancel the goal that is driven."""
        self._status.send({"goal_id": self._goal}, "cancel")

    def where(self) -> None:
        """Print where the base is on the map, and how far from a wall."""
        found = self._robot.call("frames", {"target_frame": "map", "source_frame": "base_link"})
        at = found["transform"]["translation"]
        wall = min(self._scan.get(timeout=10)["ranges"])
        print(f"at {at['x']:.1f} {at['y']:.1f}, {wall:.1f} m from a wall", flush=True)

    def _on_event(self, event: StatusEvent) -> None:
        """Say which component takes goals after another one was lost."""
        if event.change == "replaced" and event.subject == f"connection {self._status.id}":
            print(f"driven by {self._status.plan.provider.component.name}", flush=True)

    def _on_status(self, message: Any) -> None:
        if message["status"] in {"accepted", "rejected"}:
            self._goal = message["goal_id"]
            print(message["status"], flush=True)

    def _on_feedback(self, message: Any) -> None:
        left = message["feedback"]["distance_remaining"]
        if int(left) < self._metres:
            self._metres = int(left)
            print(f"{left:.1f} m to go", flush=True)

    def _on_result(self, message: Any) -> None:
        print(message["status"], flush=True)


def typed_lines() -> Iterator[str]:
    """Yield what is typed, until the input ends.

    Looks for a signal each second: Python does not end a read that begins just as one comes.
    """
    begun = b""
    while True:
        if select.select([sys.stdin], [], [], 1)[0]:
            octets = os.read(sys.stdin.fileno(), 4096)
            *lines, begun = (begun + (octets or b"\n")).split(b"\n")
            yield from (line.decode(errors="replace").strip() for line in lines)
            if not octets:
                return


def main() -> None:
    """Read goals until the input ends, or until interrupted."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt), RobotManager.from_file(HERE / "robot.yaml") as robot:
        robot.offer()
        driver = Driver(robot)
        print("where to?", flush=True)
        for line in typed_lines():
            try:
                driver.take(line)
            except (UoarmError, TimeoutError) as error:
                print(error, flush=True)


if __name__ == "__main__":
    try:
        main()
    except UoarmError as failure:
        sys.exit(str(failure))
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
