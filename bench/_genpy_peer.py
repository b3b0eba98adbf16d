"""Measures genpy of ROS 1, in Debian's own Python: microseconds to write and to read a message."""

# mypy: ignore-errors

import io
import json
import sys
import time

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from sensor_msgs.msg import Image, Imu, LaserScan


def samples(action, rounds):
    found = []
    for _ in range(rounds):
        begin = time.perf_counter()
        action()
        found.append((time.perf_counter() - begin) * 1e6)
    return sorted(found)


def main(count, octets):
    numbers = [index / 7 for index in range(count)]
    messages = {
        "Imu": Imu(),
        "LaserScan, lists": LaserScan(ranges=numbers, intensities=numbers),
        "Path of 20": Path(poses=[PoseStamped() for _ in range(20)]),
        "Image": Image(height=480, width=640, step=1920, encoding="rgb8", data=bytes(octets)),
    }
    for name, message in messages.items():

        def write(message=message):
            buffer = io.BytesIO()
            message.serialize(buffer)
            return buffer.getvalue()

        written, kind = write(), type(message)
        rounds = 300
        found = {
            "name": name,
            "write": samples(write, rounds),
            "read": samples(lambda: kind().deserialize(written), rounds),  # noqa: B023 - at once
        }
        print(json.dumps(found))


main(*map(int, sys.argv[1:]))
