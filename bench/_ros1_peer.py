"""What measures rospy and genpy of ROS 1; run by the Python that has them.

python3 _ros1_peer.py relay HERE THERE      a relay as one writes it by hand, until its input ends
python3 _ros1_peer.py client COUNT          measures relays /here_N to /there_N beside one another
python3 _ros1_peer.py genpy COUNT OCTETS    microseconds to write and to read a message
"""

# mypy: ignore-errors

import io
import json
import os
import struct
import sys
import threading
import time

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from sensor_msgs.msg import Image, Imu, LaserScan
from std_msgs.msg import UInt8MultiArray

SIZES = {"100 B": 100, "1 KB": 1_000, "1 MB": 1_000_000}
ROUNDS = {100: 2000, 1_000: 2000, 1_000_000: 200}
BURST = {100: 20_000, 1_000: 20_000, 1_000_000: 60}
BURSTS = 5
WINDOW = 50
SILENCE_SECONDS = 20.0
CODEC_ROUNDS = 300


def relay(here, there):
    rospy.init_node("relay", anonymous=True, disable_signals=True)
    publisher = rospy.Publisher(there, UInt8MultiArray, queue_size=None)
    rospy.Subscriber(here, UInt8MultiArray, publisher.publish, tcp_nodelay=True)
    print("ready", flush=True)
    sys.stdin.read()
    os._exit(0)


class Octets(rospy.AnyMsg):
    """Octets of a message, so that the client costs less than the relays do."""

    _type, _md5sum = UInt8MultiArray._type, UInt8MultiArray._md5sum
    _full_text = UInt8MultiArray._full_text


class Line:
    """One relay, as its client sees it."""

    def __init__(self, number):
        self.seen = self.least = 0
        self.changed = threading.Condition()
        self.publisher = rospy.Publisher(f"/here_{number}", Octets, queue_size=None)
        rospy.Subscriber(f"/there_{number}", Octets, self.take, tcp_nodelay=True)

    def take(self, _):
        with self.changed:
            self.seen += 1
            if self.seen >= self.least:
                self.changed.notify()

    def wait(self, least):
        with self.changed:
            self.least = least
            if not self.changed.wait_for(lambda: self.seen >= least, SILENCE_SECONDS):
                raise RuntimeError("a message was lost on the way")

    def round_trip(self, message):
        before = self.seen
        start = time.perf_counter_ns()
        self.publisher.publish(message)
        self.wait(before + 1)
        return (time.perf_counter_ns() - start) / 1000

    def burst(self, message, count):
        frame = struct.pack("<I", len(message._buff)) + message._buff
        together = max(1, min(WINDOW, 65_536 // len(frame)))
        connection = self.publisher.impl.connections[0].socket
        before, start = self.seen, time.perf_counter()
        for sent in range(0, count, together):
            self.wait(before + sent - 4 * together)
            connection.sendall(together * frame)
        self.wait(before + count)
        return count / (time.perf_counter() - start)


def octets(size):
    message, buffer = Octets(), io.BytesIO()
    UInt8MultiArray(data=bytes(size)).serialize(buffer)
    message._buff = buffer.getvalue()
    return message


def client(count):
    rospy.init_node("client", anonymous=True, disable_signals=True)
    lines = [Line(number) for number in range(count)]
    for line in lines:
        deadline = time.monotonic() + SILENCE_SECONDS
        while not line.seen:
            if time.monotonic() > deadline:
                raise RuntimeError("a relay passes nothing")
            line.publisher.publish(octets(1))
            time.sleep(0.05)
    time.sleep(0.5)
    for label, size in SIZES.items():
        message = octets(size)
        times = [[] for _ in lines]
        for _ in range(ROUNDS[size]):  # one after the other: what disturbs one disturbs all
            for line, samples in zip(lines, times):
                samples.append(line.round_trip(message))
        rates = [[] for _ in lines]
        for _ in range(BURSTS):
            for line, samples in zip(lines, rates):
                samples.append(line.burst(message, BURST[size]))
        print(json.dumps({"size": label, "times": times, "rates": rates}), flush=True)
    os._exit(0)


def samples(action, rounds):
    found = []
    for _ in range(rounds):
        begin = time.perf_counter()
        action()
        found.append((time.perf_counter() - begin) * 1e6)
    return sorted(found)


def genpy(count, octets):
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
        found = {
            "name": name,
            "write": samples(write, CODEC_ROUNDS),
            "read": samples(lambda: kind().deserialize(written), CODEC_ROUNDS),  # noqa: B023 - at once
        }
        print(json.dumps(found))


if sys.argv[1] == "relay":
    relay(*sys.argv[2:])
elif sys.argv[1] == "client":
    client(int(sys.argv[2]))
else:
    genpy(*map(int, sys.argv[2:]))
