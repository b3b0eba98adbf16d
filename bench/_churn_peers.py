"""Components of three frameworks that know nothing of uoarm, each in a process of its own."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from attrs import define, field, frozen

__all__ = ["Peer", "Peers", "peers_of"]

_PERIOD = 0.1
_END_SECONDS = 10.0


@frozen
class Peer:
    """A program that can be started and killed.

    Attributes:
        framework: whose component it is.
        shown: its name as discovery shows it.
        command: that starts it.
    """

    framework: str
    shown: str
    command: tuple[str, ...]


@define
class Peers:
    """Starts and kills peers at random; the seed and the answers give the order.

    Args:
        peers: all of them.
        environment: variables of their processes.
        log: takes what they print.
    """

    peers: tuple[Peer, ...]
    environment: Mapping[str, str]
    log: Path
    starts: int = field(default=0, init=False)
    kills: int = field(default=0, init=False)
    _running: dict[str, subprocess.Popen[bytes]] = field(factory=dict, init=False)

    def toggle(self, choose: random.Random) -> str:
        """Start one that does not run, or kill one that does; say which."""
        one = choose.choice(self.peers)
        process = self._running.pop(one.shown, None)
        if process is None:
            self.start(one)
            return f"+ {one.framework} {one.shown}"
        kind = choose.choice([signal.SIGKILL, signal.SIGINT])
        process.send_signal(kind)
        _reap(process)
        self.kills += 1
        return f"- {one.framework} {one.shown} by {kind.name}"

    def start(self, one: Peer) -> None:
        """Start one."""
        with self.log.open("ab") as out:
            self._running[one.shown] = subprocess.Popen(
                one.command, stdout=out, stderr=out, env=dict(self.environment)
            )
        self.starts += 1

    def close(self) -> None:
        """Kill those that run."""
        for one in self._running.values():
            one.kill()
            _reap(one)


def peers_of(nameserver: str, ports: tuple[int, ...]) -> tuple[Peer, ...]:
    """Return three nodes of ROS 2, three RT-Components and a simulated robot for each port."""
    python = (sys.executable, "-m", "bench._churn_peers")
    simulate = (str(Path(sys.executable).with_name("uoarm-rocos")), "simulate", "robot", "--tcp")
    return (
        *(Peer("ROS 2", f"/talker{n}", (*python, "ros2", f"talker{n}")) for n in range(3)),
        *(
            Peer("OpenRTM", f"Counter{n}.rtc", (*python, "rtm", f"Counter{n}", nameserver))
            for n in range(3)
        ),
        *(Peer("serial", f"robot{n}", (*simulate, str(port))) for n, port in enumerate(ports)),
    )


def _reap(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(_END_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _talk(name: str) -> None:
    import rclpy  # noqa: PLC0415 - in the process of a peer alone
    from std_msgs.msg import Int64  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node(name)
    publisher = node.create_publisher(Int64, f"/{name}/count", 10)
    count = 0
    while rclpy.ok():
        publisher.publish(Int64(data=count))
        count += 1
        time.sleep(_PERIOD)


def _count(name: str, nameserver: str) -> None:
    from uoarm_rtm.component import (  # noqa: PLC0415 - in the process of a peer alone
        NamingService,
        Orb,
        RtComponent,
        Sheet,
        Types,
    )

    orb = Orb("127.0.0.1", call_seconds=2.0)
    component = RtComponent(orb, Sheet(name, type_name="Counter"))
    out = component.add_out_port("count", "RTC::TimedLong", Types())
    component.bind([NamingService(orb, nameserver, seconds=2.0)])
    count = 0
    while not component.wait_for_exit(_PERIOD):
        out.write({"tm": {"sec": 0, "nsec": 0}, "data": count})
        count += 1


if __name__ == "__main__":
    if sys.argv[1] == "ros2":
        _talk(sys.argv[2])
    else:
        _count(sys.argv[2], sys.argv[3])
