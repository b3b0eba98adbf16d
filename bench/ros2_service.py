"""One ROS 2 service call: through the bridge's contract and with a bare rclpy client."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from contextlib import suppress
from typing import Any

from bench.tables import microseconds, print_table, row

DOMAIN = str(20 + os.getpid() % 80)
NAME, KIND = "/switch", "std_srvs/srv/SetBool"


def main() -> int:
    """Print the table; 0 also when there is no ROS 2 to measure."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    try:
        import rclpy  # noqa: F401, PLC0415
        import uoarm_ros2  # noqa: F401, PLC0415
    except ImportError as error:
        print(f"no service table: {error}", file=sys.stderr)
        return 0
    arguments = [sys.executable, "-m", "bench.ros2_service", "serve"]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE) as process:
        rows = [
            row("a bare rclpy client", _by_hand()),
            row("uoarm bridge", _by_uoarm()),
        ]
        process.communicate(timeout=20)
    print_table("ROS 2 service call (us)", ("client", "median", "p99", ""), rows)
    return 0


def _by_hand() -> list[float]:
    import rclpy  # noqa: PLC0415
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from std_srvs.srv import SetBool  # noqa: PLC0415

    rclpy.init(args=[])
    node = Node("client")
    # A spinning thread and a blocking call, as ours: spin_until_future_complete took 11 ms here.
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spinning = threading.Thread(target=_spin, args=(executor,))
    spinning.start()
    client = node.create_client(SetBool, NAME)
    assert client.wait_for_service(20.0)
    request = SetBool.Request(data=True)

    def call() -> None:
        assert client.call(request, 5.0).success

    samples = microseconds(call)
    rclpy.shutdown()
    spinning.join()
    return samples


def _spin(executor: Any) -> None:
    from rclpy.executors import ExternalShutdownException  # noqa: PLC0415

    with suppress(ExternalShutdownException):
        executor.spin()


def _by_uoarm() -> list[float]:
    from uoarm.bridge import Registry  # noqa: PLC0415
    from uoarm.model import BridgeSpec, Endpoint, Role  # noqa: PLC0415

    bridge = Registry().create(BridgeSpec("ros", "ros2", {}))
    service = Endpoint("ros", "switch", Role.SERVICE, (NAME, KIND))
    bridge.describe(service)

    def call() -> None:
        assert bridge.call(service, {"data": True})["success"]

    samples = microseconds(call)
    bridge.close()
    return samples


def serve() -> None:
    """Be the server, in plain rclpy, until standard input ends."""
    import rclpy  # noqa: PLC0415
    from rclpy.executors import ExternalShutdownException  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from std_srvs.srv import SetBool  # noqa: PLC0415

    rclpy.init(args=[])
    node = Node("server")

    def answer(request: Any, response: Any) -> Any:
        response.success = request.data
        return response

    node.create_service(SetBool, NAME, answer)
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        serve()
    else:
        sys.exit(main())
