"""A simulated vehicle of VDA 5050 on an MQTT broker; it stands at the origin of the map."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import math
import os
import sys
import threading

from uoarm_vda5050.vehicle import Drive, Vehicle

from uoarm.errors import UoarmError

_METRES_PER_SECOND = 5.0
_STEP_SECONDS = 0.05


def main() -> None:
    """Drive where orders lead until interrupted."""
    url = sys.argv[1] if len(sys.argv) > 1 else "mqtt://127.0.0.1:1883"
    is_over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: is_over.set())
    x = y = 0.0
    with Vehicle(url, "uoa", "agv1") as vehicle:
        print("waiting for orders", flush=True)
        while not is_over.wait(_STEP_SECONDS):
            task = vehicle.task
            if isinstance(task, Drive) and task.x is not None and task.y is not None:
                left = math.hypot(task.x - x, task.y - y)
                part = min(1.0, _METRES_PER_SECOND * _STEP_SECONDS / left) if left else 1.0
                x, y = x + part * (task.x - x), y + part * (task.y - y)
                if left < task.deviation:
                    vehicle.reached(task)
            vehicle.set(position=(x, y, 0.0, "map"), driving=isinstance(task, Drive))


if __name__ == "__main__":
    try:
        main()
    except UoarmError as failure:
        sys.exit(str(failure))
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
