"""The nodes of rospy that measure relays of ROS 1; run by the Python that has rospy.

python3 _ros1_peer.py relay HERE THERE      a relay as one writes it by hand, until its input ends
python3 _ros1_peer.py client COUNT          measures relays /here_N to /there_N beside one another
"""

# mypy: ignore-errors

import json
import os
import sys
import threading
import time

import rospy
from std_msgs.msg import UInt8MultiArray

SIZES = {"100 B": 100, "1 KB": 1_000, "1 MB": 1_000_000}
ROUNDS = {100: 2000, 1_000: 2000, 1_000_000: 200}
BURST = {100: 2000, 1_000: 2000, 1_000_000: 60}
BURSTS = 5
WINDOW = 50
SILENCE_SECONDS = 20.0


def relay(here, there):
    rospy.init_node("relay", anonymous=True, disable_signals=True)
    publisher = rospy.Publisher(there, UInt8MultiArray, queue_size=None)
    rospy.Subscriber(here, UInt8MultiArray, publisher.publish, tcp_nodelay=True)
    print("ready", flush=True)
    sys.stdin.read()
    os._exit(0)


class Line:
    """One relay, as its client sees it."""

    def __init__(self, number):
        self.seen = 0
        self.changed = threading.Condition()
        self.publisher = rospy.Publisher(f"/here_{number}", UInt8MultiArray, queue_size=None)
        rospy.Subscriber(f"/there_{number}", UInt8MultiArray, self.take, tcp_nodelay=True)

    def take(self, _):
        with self.changed:
            self.seen += 1
            self.changed.notify()

    def wait(self, least):
        with self.changed:
            if not self.changed.wait_for(lambda: self.seen >= least, SILENCE_SECONDS):
                raise RuntimeError("a message was lost on the way")

    def round_trip(self, message):
        before = self.seen
        start = time.perf_counter_ns()
        self.publisher.publish(message)
        self.wait(before + 1)
        return (time.perf_counter_ns() - start) / 1000

    def burst(self, message, count):
        before, start = self.seen, time.perf_counter()
        for sent in range(count):
            self.wait(before + sent - WINDOW)
            self.publisher.publish(message)
        self.wait(before + count)
        return count / (time.perf_counter() - start)


def client(count):
    rospy.init_node("client", anonymous=True, disable_signals=True)
    lines = [Line(number) for number in range(count)]
    ready = UInt8MultiArray(data=b"0")
    for line in lines:
        deadline = time.monotonic() + SILENCE_SECONDS
        while not line.seen:
            if time.monotonic() > deadline:
                raise RuntimeError("a relay passes nothing")
            line.publisher.publish(ready)
            time.sleep(0.05)
    time.sleep(0.5)
    for label, size in SIZES.items():
        message = UInt8MultiArray(data=bytes(size))
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


if sys.argv[1] == "relay":
    relay(*sys.argv[2:])
else:
    client(int(sys.argv[2]))
