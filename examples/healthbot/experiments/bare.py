"""The frameworks by themselves: programs that send one message to and fro.

Each is measured in a process of its own, so that nothing else is loaded there. `NAME COUNT`
prints the seconds of every round trip as JSON; `NAME peer` is the other process.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import json
import queue
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

_HERE = Path(__file__).resolve()
_LIMIT = 30.0
_OCTETS = 64
_MATCHED = 0.02


def _timed(trip: Callable[[int], object], count: int) -> list[float]:
    taken = []
    for number in range(count + count // 10):
        begun = time.perf_counter()
        trip(number)
        taken.append(time.perf_counter() - begun)
    return taken[count // 10 :]


@contextmanager
def _peer(name: str) -> Iterator[str]:
    """Run the other process; yields the line that it prints."""
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, str(_HERE), name, "peer"], stdin=pipe, stdout=pipe,
                          text=True) as process:  # fmt: skip
        assert process.stdout is not None, "stdout is a pipe"
        try:
            yield process.stdout.readline().strip()
        finally:
            process.communicate(timeout=_LIMIT)


def python(count: int) -> list[float]:
    """Call a function that gives its argument back."""

    def loop(message: dict[str, int]) -> dict[str, int]:
        return message

    return _timed(lambda number: loop({"data": number}), count)


def tcp(count: int) -> list[float]:
    """Send 64 octets and read them back."""
    with _peer("socket") as port, socket.create_connection(("127.0.0.1", int(port))) as line:
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        octets = bytes(_OCTETS)

        def trip(_: int) -> None:
            line.sendall(octets)
            line.recv(_OCTETS, socket.MSG_WAITALL)

        return _timed(trip, count)


def tcp_peer() -> None:
    """Give back what comes, until the other closes."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        print(server.getsockname()[1], flush=True)
        line, _ = server.accept()
        with line:
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while octets := line.recv(_OCTETS):
                line.sendall(octets)


@contextmanager
def _node(name: str) -> Iterator[Any]:
    """A node that spins in a thread of its own."""
    import rclpy  # noqa: PLC0415 - only where it is measured
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415

    rclpy.init()
    node = rclpy.create_node(name)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()
    try:
        yield node
    finally:
        executor.shutdown()
        spinning.join()
        node.destroy_node()
        rclpy.shutdown()


def _topics(count: int, out: str, back: str) -> list[float]:
    from std_msgs.msg import Int32  # noqa: PLC0415

    received: queue.SimpleQueue[int] = queue.SimpleQueue()
    with _node("floor") as node:
        publisher = node.create_publisher(Int32, out, 10)
        node.create_subscription(Int32, back, lambda message: received.put(message.data), 10)
        # Publishing is how one learns that both sides have found each other.
        _until(lambda: publisher.publish(Int32(data=-1)), received)

        def trip(number: int) -> None:
            publisher.publish(Int32(data=number))
            while received.get(timeout=_LIMIT) != number:
                pass

        return _timed(trip, count)


def _until(send: Callable[[], None], received: queue.SimpleQueue[int]) -> None:
    deadline = time.monotonic() + _LIMIT
    while time.monotonic() < deadline:
        send()
        try:
            received.get(timeout=_MATCHED)
        except queue.Empty:
            continue
        return
    raise TimeoutError("nothing came back")


def topic(count: int) -> list[float]:
    """Publish on a topic to which the same node subscribes."""
    return _topics(count, "/floor", "/floor")


def topics(count: int) -> list[float]:
    """Publish to another process, which publishes back."""
    with _peer("topics"):
        return _topics(count, "/out", "/back")


def topics_peer() -> None:
    """Publish back what comes."""
    from std_msgs.msg import Int32  # noqa: PLC0415

    with _node("peer") as node:
        publisher = node.create_publisher(Int32, "/back", 10)
        node.create_subscription(Int32, "/out", publisher.publish, 10)
        print("ready", flush=True)
        sys.stdin.read()


def service(count: int) -> list[float]:
    """Call a service of another process."""
    from std_srvs.srv import SetBool  # noqa: PLC0415

    with _peer("service"), _node("floor") as node:
        client = node.create_client(SetBool, "/floor")
        assert client.wait_for_service(_LIMIT), "the peer has said that it serves"

        def trip(number: int) -> None:
            answered = threading.Event()
            client.call_async(SetBool.Request(data=bool(number % 2))).add_done_callback(
                lambda _: answered.set()
            )
            assert answered.wait(_LIMIT), "no reply"

        return _timed(trip, count)


def service_peer() -> None:
    """Answer at once."""
    from std_srvs.srv import SetBool  # noqa: PLC0415

    with _node("peer") as node:
        node.create_service(SetBool, "/floor", lambda _, reply: reply)
        print("ready", flush=True)
        sys.stdin.read()


@contextmanager
def _port(
    take: Callable[[int], None], joined: list[Any] | None = None
) -> Iterator[tuple[Any, Any]]:
    """An omniORB object, and who joins it; yields its ORB and its reference."""
    stubs = tempfile.TemporaryDirectory(prefix="floor-")
    compiler = str(Path(sys.executable).with_name("omniidl"))
    idl = str(_HERE.with_name("floor.idl"))
    subprocess.run([compiler, "-bpython", f"-C{stubs.name}", idl], check=True)
    sys.path.insert(0, stubs.name)
    from omniORB import CORBA  # noqa: PLC0415

    skeletons: Any = import_module("Floor__POA")

    class Port(skeletons.Port):  # type: ignore[misc]  # compiled a moment ago
        def call(self, number: int) -> int:
            return number

        def put(self, number: int) -> None:
            take(number)

        def join(self, other: Any) -> None:
            if joined is not None:
                joined.append(other)

    orb = CORBA.ORB_init(["floor", "-ORBendPoint", "giop:tcp:127.0.0.1:"], CORBA.ORB_ID)
    root = orb.resolve_initial_references("RootPOA")
    root._get_the_POAManager().activate()  # noqa: SLF001 - so CORBA calls it
    servant = Port()
    try:
        yield orb, servant._this()  # noqa: SLF001 - the same
    finally:
        orb.destroy()
        stubs.cleanup()


def call(count: int) -> list[float]:
    """Call an operation of an object in another process."""
    with _peer("put") as address, _port(lambda _: None) as (orb, _):
        other = orb.string_to_object(address)
        return _timed(other.call, count)


def put(count: int) -> list[float]:
    """Put a number into another process, which puts it back."""
    received: queue.SimpleQueue[int] = queue.SimpleQueue()
    with _peer("put") as address, _port(received.put) as (orb, ours):
        other = orb.string_to_object(address)
        other.join(ours)

        def trip(number: int) -> None:
            other.put(number)
            while received.get(timeout=_LIMIT) != number:
                pass

        return _timed(trip, count)


def put_peer() -> None:
    """Put back what comes, in a thread of its own, as an RT-Component does."""
    waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
    joined: list[Any] = []
    with _port(waiting.put, joined) as (orb, ours):

        def forward() -> None:
            while True:
                number = waiting.get()
                joined[-1].put(number)

        threading.Thread(target=forward, daemon=True).start()
        print(orb.object_to_string(ours), flush=True)
        sys.stdin.read()


_RUN = {
    "python": python, "socket": tcp, "topic": topic, "topics": topics, "service": service,
    "call": call, "put": put,
}  # fmt: skip
_PEERS = {"socket": tcp_peer, "topics": topics_peer, "service": service_peer, "put": put_peer}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=_RUN)
    parser.add_argument("count", help="round trips, or `peer`")
    given = parser.parse_args()
    if given.count == "peer" and given.name in _PEERS:
        _PEERS[given.name]()
    elif given.count.isdecimal():
        print(json.dumps(_RUN[given.name](int(given.count))))
    else:
        parser.error(f"expected a number of round trips, got {given.count}")
