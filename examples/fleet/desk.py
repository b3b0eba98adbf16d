"""A desk gives boxes to whichever vehicle is free: three managers on loopback, one of them killed.

Each vehicle is `uoarm serve` in a process of its own. The desk imports their functions, watches who
is free, and gives a box that a dead vehicle had to another one.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import UoarmError

HERE = Path(__file__).parent
VEHICLES = ("ant", "bee", "cat")
BOXES = 12
METRES = 2.0
_LIMIT_SECONDS = 120.0
_PAUSE_SECONDS = 1.0
_PORTS = (9410, 9411, 9412)


@contextmanager
def vehicle(name: str, port: int) -> Iterator[subprocess.Popen[bytes]]:
    """Serve a vehicle on a port until the end of a block."""
    command = [sys.executable, "-m", "uoarm", "serve", "vehicle.yaml", "--port", str(port)]
    if shutil.which("setpriv") is not None:  # the kernel then ends it when the desk is killed
        command[:0] = ["setpriv", "--pdeathsig", "TERM"]
    environment = {**os.environ, "VEHICLE": name}
    with subprocess.Popen(command, cwd=HERE, env=environment, stdout=subprocess.PIPE) as process:
        try:
            # Not what answers at the port: that may be another server, which has taken it.
            if process.stdout is None or not process.stdout.readline():
                text = f"the vehicle at port {port} has ended"
                raise SystemExit(f"{text}: desk.py PORT PORT PORT takes other ports")
            yield process
        finally:
            process.terminate()


def configuration(ports: dict[str, int]) -> str:
    """Return the desk's: a bridge and two functions for each vehicle."""
    bridges = "".join(
        f"  {name}: {{plugin: remote, options: {{url: 'ws://127.0.0.1:{port}/', grace: 1}}}}\n"
        for name, port in ports.items()
    )
    functions = "".join(
        f"  {name}_{function}:\n    components:\n"
        f"      - {{name: {name}_{function}, bridge: {name}, {kind}: {{endpoint: [{function}]}}}}\n"
        for name in ports
        for function, kind in (("transport", "service"), ("state", "output"))
    )
    return f"version: 1\nbridges:\n{bridges}functions:\n{functions}"


class Desk:
    """Gives boxes to free vehicles, until all have arrived."""

    def __init__(self, robot: RobotManager) -> None:
        self._robot = robot
        self._boxes = deque(f"box {number}" for number in range(1, BOXES + 1))
        self._changed = threading.Condition()
        self.delivered: dict[str, str] = {}
        self._is_over = False
        self.news: queue.SimpleQueue[str] = queue.SimpleQueue()

    def run(self) -> None:
        """Have each vehicle work in a thread of its own; returns when all boxes have arrived."""
        for name in VEHICLES:
            threading.Thread(target=self._work, args=(name,), daemon=True).start()
        try:
            # Printed here: what fails in a thread of a vehicle would end nothing else.
            while not self._has_all():
                print(self.news.get(timeout=_LIMIT_SECONDS), flush=True)
        except queue.Empty:
            raise SystemExit(f"only {len(self.delivered)} of {BOXES} boxes arrived") from None
        finally:
            self._is_over = True  # calls under way are cancelled, and no vehicle is lost

    def wait_for(self, count: int) -> None:
        """Wait until so many boxes have arrived."""
        with self._changed:
            self._changed.wait_for(lambda: len(self.delivered) >= count, _LIMIT_SECONDS)

    def _has_all(self) -> bool:
        with self._changed:
            return len(self.delivered) == BOXES and self.news.empty()

    def _work(self, name: str) -> None:
        is_lost = False
        while True:
            with self._changed:
                # A box that another vehicle has may come back.
                self._changed.wait_for(lambda: self._boxes or len(self.delivered) == BOXES)
                if not self._boxes:
                    return
                box = self._boxes.popleft()
            try:
                done = self._robot.call(
                    f"{name}_transport", {"box": box, "metres": METRES}, timeout=20
                )
            except UoarmError as error:
                if self._is_over:
                    return
                if not is_lost:
                    why = str(error).splitlines()[-1].strip()
                    self.news.put(f"{name} is lost with {box}: {why}")
                is_lost = True
                with self._changed:
                    self._boxes.appendleft(box)  # another one carries it
                    self._changed.notify_all()
                time.sleep(_PAUSE_SECONDS)  # only the link may have been lost
                continue
            is_lost = False
            with self._changed:
                self.delivered[box] = name
                self.news.put(f"{done['vehicle']} has delivered {done['box']}")
                self._changed.notify_all()


def main(*given: int) -> None:
    """Start three vehicles and a desk, kill one vehicle on the way, and deliver everything.

    Args:
        given: ports of the vehicles.
    """
    with ExitStack() as stack:
        ports = dict(zip(VEHICLES, given or _PORTS, strict=True))
        processes = {name: stack.enter_context(vehicle(name, port)) for name, port in ports.items()}
        robot = stack.enter_context(RobotManager(loads(configuration(ports))))
        desk = Desk(robot)

        def kill() -> None:
            desk.wait_for(BOXES // 3)
            desk.news.put("cat is killed")
            processes["cat"].kill()

        threading.Thread(target=kill, daemon=True).start()
        desk.run()
        print(f"all {BOXES} boxes have arrived", flush=True)


if __name__ == "__main__":
    given = sys.argv[1:]
    if len(given) not in {0, len(VEHICLES)} or not all(map(str.isdecimal, given)):
        sys.exit(f"usage: desk.py [PORT PORT PORT], not {' '.join(given)}")
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        main(*map(int, given))
    except KeyboardInterrupt:
        sys.exit(130)
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
