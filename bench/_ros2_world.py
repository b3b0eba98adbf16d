"""A ROS 2 process that others are measured on: sources, an echo, a service.

Sources publish only while they have subscribers. As many further topics as the argument says
have one latched message each. Texts begin with their number and the time at which they left, in
nanoseconds of the monotonic clock.

`python -m bench._ros2_world read SECONDS [small]` only subscribes: what the transport brings before
any server. It prints, as JSON, the pictures a second that came, and with `small` how many of 100
small messages a second beside them, and how old they were, in ms.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from array import array
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import SetBool

from bench.tables import spread

HERTZ = {"hz100": 100, "hz200": 200, "hz1000": 1000, "hz4000": 4000, "flood": 10_000}
PICTURES_HERTZ = 600
WIDTH, HEIGHT = 640, 480
_DEPTH = 1000
_PICTURES_BEHIND = 2
_LOOK_SECONDS = 0.05
_FIRST_SECONDS = 10.0
_SETTLE_SECONDS = 1.0


def main() -> None:
    """Run until the process is ended."""
    rclpy.init()
    node = Node("uoarm_bench_world")
    qos = QoSProfile(depth=_DEPTH)
    padding = "x" * 1000
    for name, hertz in HERTZ.items():

        def text(number: int) -> Any:
            return String(data=f"{number} {time.monotonic_ns()} {padding}")

        _source(node.create_publisher(String, f"/bench/{name}", qos), hertz, text, _DEPTH)
    picture = Image(width=WIDTH, height=HEIGHT, encoding="rgb8", step=3 * WIDTH)
    picture.data = array("B", bytes(3 * WIDTH * HEIGHT))
    pictures = node.create_publisher(Image, "/bench/pictures", QoSProfile(depth=2))
    _source(pictures, PICTURES_HERTZ, lambda _: picture, _PICTURES_BEHIND)
    echo = node.create_publisher(String, "/bench/out", qos)
    node.create_subscription(String, "/bench/in", echo.publish, qos)
    node.create_service(SetBool, "/bench/toggle", _toggle)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for number in range(int(sys.argv[1]) if sys.argv[1:] else 0):
        node.create_publisher(String, f"/bench/t{number}", latched).publish(String(data="first"))
    print("ready", flush=True)
    rclpy.spin(node)


def _toggle(request: Any, response: Any) -> Any:
    response.success = request.data
    return response


def _source(publisher: Any, hertz: int, make: Callable[[int], Any], behind: int) -> None:
    arguments = (publisher, hertz, make, behind)
    threading.Thread(target=_publish, args=arguments, daemon=True).start()


def _publish(publisher: Any, hertz: int, make: Callable[[int], Any], behind: int) -> None:
    """Publish at a rate; what is more than `behind` messages late is left out."""
    number = 0
    while True:
        if not publisher.get_subscription_count():
            time.sleep(_LOOK_SECONDS)
            continue
        start, sent = time.perf_counter(), 0
        while publisher.get_subscription_count():
            due = int((time.perf_counter() - start) * hertz)
            sent = max(sent, due - behind)
            while sent <= due:
                number, sent = number + 1, sent + 1
                publisher.publish(make(number))
            time.sleep(min(0.001, 1 / hertz))


def read(seconds: float, *, small: bool) -> None:
    """Subscribe, count and print."""
    rclpy.init()
    node = rclpy.create_node("uoarm_bench_reader")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    came: list[object] = []
    ages: list[float] = []

    def take(message: String) -> None:
        sent = int(message.data[:64].split(" ")[1])
        ages.append((time.monotonic_ns() - sent) / 1_000_000)

    node.create_subscription(Image, "/bench/pictures", came.append, QoSProfile(depth=10))
    if small:
        node.create_subscription(String, "/bench/hz100", take, QoSProfile(depth=100))

    def spin(duration: float) -> None:
        end = time.perf_counter() + duration
        while time.perf_counter() < end:
            executor.spin_once(timeout_sec=0.1)

    limit = time.perf_counter() + _FIRST_SECONDS
    while not (came and (ages or not small)) and time.perf_counter() < limit:
        spin(0.1)
    spin(_SETTLE_SECONDS)
    came.clear()
    ages.clear()
    spin(seconds)
    reports = {"pictures": len(came) / seconds, "small": len(ages) / seconds}
    print(json.dumps({**reports, "ages": spread(ages, 2) if ages else "none"}), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["read"]:
        read(float(sys.argv[2]), small="small" in sys.argv[3:])
    else:
        main()
