"""A ROS 2 process that rosbridge servers are measured on: sources, an echo, a service.

Sources publish only while they have subscribers. As many further topics as the argument says
have one latched message each. Texts begin with their number and the time at which they left, in
nanoseconds of the monotonic clock.
"""

from __future__ import annotations

import sys
import threading
import time
from array import array
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import SetBool

HERTZ = {"hz100": 100, "hz1000": 1000, "hz4000": 4000, "flood": 10_000}
PICTURES_HERTZ = 600
WIDTH, HEIGHT = 640, 480
_DEPTH = 1000
_PICTURES_BEHIND = 2
_LOOK_SECONDS = 0.05


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


if __name__ == "__main__":
    main()
