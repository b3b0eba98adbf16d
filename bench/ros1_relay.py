"""One ROS 1 topic to another: through uoarm, natively linked, and through a relay of rospy by hand.

Relays and their client, a node of rospy, are processes of their own, measured beside one another.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from bench._ros_relays import RELAYS, relay
from bench.tables import print_table, row
from bench.turns import module, running, wait_for_port
from uoarm.testing import free_port

ROS_PYTHON = "/usr/bin/python3"  # what Debian installs belongs to it alone
PEER = str(Path(__file__).with_name("_ros1_peer.py"))
ALL = ("a rospy relay by hand", *RELAYS)
KIND = "std_msgs/UInt8MultiArray"


def main() -> int:
    """Print the tables; 0 also when there is no ROS 1 to measure."""
    master = shutil.which("rosmaster")
    try:
        import uoarm_ros1  # noqa: F401, PLC0415
    except ImportError as error:
        print(f"no relay table: {error}", file=sys.stderr)
        return 0
    if master is None:
        print("no relay table: no rosmaster (apt install python3-rosmaster)", file=sys.stderr)
        return 0
    port = free_port()
    uri = f"http://127.0.0.1:{port}"
    environment = {**os.environ, "ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1"}
    with ExitStack() as stack:
        core = (master, "--core", "-p", str(port))
        stack.enter_context(running(core, signal.SIGKILL, stdout=subprocess.DEVNULL))
        wait_for_port(port)
        for number, name in enumerate(ALL):
            topics = (f"/here_{number}", f"/there_{number}")
            ours = module("bench.ros1_relay", name, *topics)
            words = ours if number else (ROS_PYTHON, PEER, "relay", *topics)
            stack.enter_context(running(words, env=environment)).said("(ready)")
        client = [ROS_PYTHON, PEER, "client", str(len(ALL))]
        done = subprocess.run(
            client, stdout=subprocess.PIPE, text=True, env=environment, check=True
        )
    times, rates = [], []
    for line in done.stdout.splitlines():
        found = json.loads(line)
        for name, samples, speeds in zip(ALL, found["times"], found["rates"], strict=True):
            times.append((*row(name, sorted(samples))[:3], found["size"]))
            rates.append((name, f"{median(speeds):,.0f}", found["size"]))
    print_table("ROS 1 relay, round trip (us)", ("relay", "median", "p99", "size"), times)
    print_table("ROS 1 relay, one way", ("relay", "messages/s", "size"), rates)
    return 0


def _relay(name: str, here: str, there: str) -> None:
    options = {"peer": "optional"}
    queue = {"policy": "block", "timeout": 60}
    relay(
        name,
        "ros1",
        ((here, KIND), (there, KIND)),
        (options, {**options, "queue": 10_000}),
        {"queue": queue, "map": {"layout": "layout", "data": "data"}},
    )


if __name__ == "__main__":
    if len(sys.argv) > 1:
        _relay(*sys.argv[1:])
        sys.exit(0)
    sys.exit(main())
