"""The processes of the bench of commands: sinks of four frameworks, a server, a client, a clock.

A sink writes a line for each message: the seconds of the monotonic clock, `go` or `stop`, and of a
`go` the seconds since it left the client, where the message has room for that. What its framework
tells it beside, that nobody sends any more, is a line of its own: `told`, and the word for it.
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

FUNCTIONS = ("ros2", "rtm", "rocos", "mqtt", "far")
OFFLINE = "offline"
PRESENCE = "robot/presence"
TOPIC = "robot/go"
_DEADLINE_SECONDS = 0.3
_HANG_MICROSECONDS = 1_500_000
_TICK_SECONDS = 0.005
_LATE_SECONDS = 0.002


def main() -> None:
    """Be the part that the first argument names."""
    part, *arguments = sys.argv[1:]
    parts: dict[str, Callable[..., None]] = {
        "ros2": ros2, "far": ros2, "rtm": rtm, "rocos": rocos, "mqtt": mqtt,
        "serve": serve, "send": send, "join": join, "tick": tick,
    }  # fmt: skip
    parts[part](*arguments)


def go(name: str) -> dict[str, Any]:
    """Return a command, with the millisecond in which it was made where there is room."""
    stamp = int(1000 * time.monotonic())
    made: dict[str, dict[str, Any]] = {
        "ros2": {"data": stamp},
        "far": {"data": stamp},
        "mqtt": {"stamp": stamp},
        "rtm": {"tm": {"sec": 0, "nsec": 0}, "data": 1},
        "rocos": {"linear": 0.1, "angular": 0.0},
    }
    return made[name]


def note(value: float) -> None:
    """Write down a message; 0 is the stop."""
    now = time.monotonic()
    age = f" {now - value / 1000:.3f}" if value > 1 else ""
    print(f"{now:.6f} {'go' if value else 'stop'}{age}", flush=True)


def told(word: str) -> None:
    """Write down what the framework says."""
    print(f"{time.monotonic():.6f} told {word}", flush=True)


def ros2(topic: str) -> None:
    """Take a topic, as any node does; with a deadline, as a careful one does."""
    import rclpy  # noqa: PLC0415
    from rclpy.duration import Duration  # noqa: PLC0415
    from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: PLC0415
    from rclpy.qos import QoSProfile  # noqa: PLC0415
    from std_msgs.msg import Int64  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node(f"sink{topic.replace('/', '_')}")
    node.create_subscription(
        Int64,
        topic,
        lambda message: note(message.data),
        QoSProfile(depth=10, deadline=Duration(seconds=_DEADLINE_SECONDS)),
        event_callbacks=SubscriptionEventCallbacks(deadline=lambda _: told("deadline")),
    )
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
        note(bool(values["linear"]))
        take(api, values, now)

    class End(TcpEnd):  # type: ignore[misc] # without the plugin's types it is Any
        def cut(self) -> None:
            super().cut()
            told("closed")

    robot.take = noting
    end = End()
    print(f"url {end.where}", flush=True)
    run(ProfileServer(robot, LengthFramer), end, threading.Event())


def mqtt(host: str, port: str) -> None:
    """Take a topic of a broker, and the last will of who publishes on it."""
    import json  # noqa: PLC0415

    from paho.mqtt.client import Client  # noqa: PLC0415
    from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion  # noqa: PLC0415

    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)

    def take(_: Any, __: Any, message: Any) -> None:
        if message.topic == TOPIC:
            note(json.loads(message.payload)["stamp"])
        elif message.payload.decode() == OFFLINE and not message.retain:
            told("last-will")

    def subscribe(*_: Any) -> None:
        client.subscribe([(TOPIC, 0), (PRESENCE, 1)])

    client.on_message = take
    client.on_connect = subscribe
    client.on_disconnect = lambda *_: told("disconnected")
    client.reconnect_delay_set(0.05, 0.2)  # type: ignore[arg-type]  # any number
    client.connect(host, int(port))
    client.loop_forever()


def serve(robot: str, port: str) -> None:
    """Serve a robot; SIGUSR1 holds the interpreter's lock for a while."""
    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.server import Settings, run  # noqa: PLC0415

    usleep = ctypes.PyDLL(None).usleep  # a PyDLL keeps the lock
    signal.signal(signal.SIGUSR1, lambda *_: usleep(_HANG_MICROSECONDS))
    with RobotManager.from_file(robot) as manager:
        run(
            manager,
            Settings(port=int(port)),
            lambda server: print(f"port {server.ports[0]}", flush=True),
        )


def join(*arguments: str) -> None:
    """Be the host of another machine."""
    from uoarm.cli import main as uoarm  # noqa: PLC0415

    uoarm(["host", "--join", *arguments])


def send(url: str, period: str) -> None:
    """Command them all, 20 times a second or so, from when a line comes on stdin."""
    from uoarm.client import connect  # noqa: PLC0415
    from uoarm.errors import CommandRefusedError, UoarmError  # noqa: PLC0415

    async def drive() -> None:
        async with connect(url, resume=False) as robot:

            async def one(name: str) -> None:
                while True:
                    with contextlib.suppress(UoarmError):
                        stream = await robot.request(name, wait=300)
                        while True:
                            with contextlib.suppress(CommandRefusedError):
                                await stream.send(go(name))
                            await asyncio.sleep(float(period))
                    await asyncio.sleep(float(period))  # a host has ended, or the server

            await asyncio.gather(*map(one, FUNCTIONS))

    sys.stdin.readline()
    asyncio.run(drive())


def tick() -> None:
    """Write down how late a thread is woken that does nothing: what the machine adds by itself."""
    due = time.monotonic()
    while True:
        due = max(due + _TICK_SECONDS, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
        late = time.monotonic() - due
        if late > _LATE_SECONDS:
            print(f"{time.monotonic():.6f} late {late:.6f}", flush=True)


if __name__ == "__main__":
    main()
