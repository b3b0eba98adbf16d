"""The processes of the bench of commands: sinks of three frameworks, a server, a client.

A sink writes a line for each message: the seconds of the monotonic clock, and `go` or `stop`.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

FUNCTIONS = ("ros2", "rtm", "rocos")
GO: dict[str, Any] = {
    "ros2": {"data": 1},
    "rtm": {"tm": {"sec": 0, "nsec": 0}, "data": 1},
    "rocos": {"linear": 0.1, "angular": 0.0},
}
_HANG_MICROSECONDS = 1_500_000


def main() -> None:
    """Be the part that the first argument names."""
    part, *arguments = sys.argv[1:]
    parts: dict[str, Callable[..., None]] = {
        "ros2": ros2, "rtm": rtm, "rocos": rocos, "serve": serve, "send": send
    }  # fmt: skip
    parts[part](*arguments)


def note(value: float) -> None:
    """Write down a message."""
    print(f"{time.monotonic():.6f} {'go' if value else 'stop'}", flush=True)


def ros2() -> None:
    """Take /go, as any node does."""
    import rclpy  # noqa: PLC0415
    from std_msgs.msg import Int64  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node("sink")
    node.create_subscription(Int64, "/go", lambda message: note(message.data), 10)
    rclpy.spin(node)


def rtm(nameserver: str) -> None:
    """Take `go` of an RT-Component."""
    from uoarm_rtm.component import NamingService, Orb, RtComponent, Sheet, Types  # noqa: PLC0415

    orb = Orb("127.0.0.1", call_seconds=2.0)
    component = RtComponent(orb, Sheet("Sink0", type_name="Sink"))
    component.add_in_port(
        "go", "IDL:RTC/TimedLong:1.0", Types([]), lambda message: note(message["data"])
    )
    component.bind([NamingService(orb, nameserver, seconds=2.0)])
    component.wait_for_exit(86_400.0)


def rocos() -> None:
    """Take the velocity of the simulated robot."""
    from uoarm_rocos._framing import LengthFramer  # noqa: PLC0415
    from uoarm_rocos.simulate import ProfileServer, Robot, TcpEnd, run  # noqa: PLC0415

    robot: Any = Robot()
    take = robot.take

    def noting(api: str, values: dict[str, Any], now: float) -> None:
        note(values["linear"])
        take(api, values, now)

    robot.take = noting
    end = TcpEnd()
    print(f"url {end.where}", flush=True)
    run(ProfileServer(robot, LengthFramer), end, threading.Event())


def serve(robot: str) -> None:
    """Serve a robot; SIGUSR1 holds the interpreter's lock for a while."""
    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.server import Settings, run  # noqa: PLC0415

    usleep = ctypes.PyDLL(None).usleep  # a PyDLL keeps the lock
    signal.signal(signal.SIGUSR1, lambda *_: usleep(_HANG_MICROSECONDS))
    with RobotManager.from_file(robot) as manager:
        run(manager, Settings(port=0), lambda server: print(f"port {server.ports[0]}", flush=True))


def send(url: str, period: str) -> None:
    """Command all three, 20 times a second or so."""
    from uoarm.client import connect  # noqa: PLC0415
    from uoarm.errors import UoarmError  # noqa: PLC0415

    async def drive() -> None:
        async with connect(url, resume=False) as robot:
            inputs = [(await robot.request(name, wait=60), GO[name]) for name in FUNCTIONS]

            async def one(stream: Any, message: Any) -> None:
                while True:
                    with contextlib.suppress(UoarmError):  # while the emergency stop holds it
                        await stream.send(message)
                    await asyncio.sleep(float(period))

            await asyncio.gather(*(one(*each) for each in inputs))

    asyncio.run(drive())


if __name__ == "__main__":
    main()
