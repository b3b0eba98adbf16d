"""A link to another manager: what a hop costs beside a bare WebSocket, and a desk of many managers.

All on loopback. The server that is bare gives back what it gets; both are asked in turns, with the
same octets. Managers of the table have servers of their own, in threads of one process.
"""

from __future__ import annotations

import asyncio
import resource
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from websockets.asyncio.server import ServerConnection, serve
from websockets.sync.client import connect

from bench.tables import at, print_table
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, serve_in_thread

ORIGIN = str(Path(__file__).parent / "robot.yaml")
SIZES = {"100 B": 100, "10 KB": 10_000, "1 MB": 1_000_000}
ROUNDS, MANAGERS = 5, (1, 10, 50)
ROBOT = """
version: 1
bridges: {python: {}}
export: {local: [echo]}
functions:
  echo: {components: [{name: echo, bridge: python, service: {endpoint: ["_hosted_parts:echo"]}}]}
"""

Trip = Callable[[bytes], object]


def main() -> None:
    """Print round trips, and what a desk of many managers costs."""
    with ExitStack() as stack:
        trips = {
            "bare WebSocket": stack.enter_context(bare()),
            "call of a function of another manager": stack.enter_context(hop()),
        }
        samples = {(name, size): list[float]() for name in trips for size in SIZES}
        for _ in range(ROUNDS):
            for size, octets in SIZES.items():
                for name, trip in trips.items():
                    count = 200 if octets < 1e6 else 40
                    samples[name, size] += times(trip, bytes(octets), count)
    rows = [(name, *(cell(sorted(samples[name, size])) for size in SIZES)) for name in trips]
    print_table("Round trip (us, median / p99)", ("what", *SIZES), rows)
    head = (
        "managers",
        "until all were called (s)",
        "status (ms)",
        "MB each",
    )
    print_table("A desk", head, [desk(count) for count in MANAGERS])


def cell(samples: list[float]) -> str:
    """Return median and 99th percentile."""
    return f"{at(samples, 0.5):,.0f} / {at(samples, 0.99):,.0f}"


def times(trip: Trip, octets: bytes, count: int) -> list[float]:
    """Return how long each of so many trips took, in microseconds."""
    found = []
    for _ in range(count):
        start = time.perf_counter_ns()
        trip(octets)
        found.append((time.perf_counter_ns() - start) / 1000)
    return found


@contextmanager
def bare() -> Iterator[Trip]:
    """Have a server in a thread give back what comes over one connection."""
    loop, ports, closing = asyncio.new_event_loop(), list[int](), asyncio.Event()
    ready = threading.Event()

    async def echo(socket: ServerConnection) -> None:
        async for octets in socket:
            await socket.send(octets)

    async def run() -> None:
        async with serve(echo, "127.0.0.1", 0, max_size=None, compression=None) as server:
            ports.append(next(iter(server.sockets)).getsockname()[1])
            ready.set()
            await closing.wait()

    thread = threading.Thread(target=loop.run_until_complete, args=(run(),))
    thread.start()
    ready.wait()
    url = f"ws://127.0.0.1:{ports[0]}"
    with connect(url, compression=None, max_size=None) as socket:

        def trip(octets: bytes) -> object:
            socket.send(octets)
            return socket.recv()

        yield trip
    loop.call_soon_threadsafe(closing.set)
    thread.join()
    loop.close()


@contextmanager
def served() -> Iterator[str]:
    """Serve a robot; gives its address."""
    with (
        RobotManager(loads(ROBOT, origin=ORIGIN)) as robot,
        serve_in_thread(robot, ServerOptions(port=0)) as server,
    ):
        yield f"ws://127.0.0.1:{server.ports[0]}/"


def importing(urls: list[str]) -> str:
    """Return the configuration of a desk."""
    lines = ["version: 1", "bridges:"]
    lines += [
        f"  r{number}: {{plugin: remote, options: {{url: '{url}', silence: 1, grace: 1}}}}"
        for number, url in enumerate(urls)
    ]
    lines.append("functions:")
    lines += [
        f"  f{number}: {{components: [{{name: c{number}, bridge: r{number}, "
        f"service: {{endpoint: [echo]}}}}]}}"
        for number in range(len(urls))
    ]
    return "\n".join(lines)


@contextmanager
def hop() -> Iterator[Trip]:
    """Call a function of another manager."""
    with served() as url, RobotManager(loads(importing([url]))) as robot:

        def trip(octets: bytes) -> object:
            return robot.call("f0", {"data": octets})

        trip(b"")
        yield trip


def resident() -> float:
    """Return the memory of this process, in MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def desk(count: int) -> tuple[str, ...]:
    """Return the row of a desk of so many managers."""
    with ExitStack() as stack:
        urls = [stack.enter_context(served()) for _ in range(count)]
        before = resident()
        robot = stack.enter_context(RobotManager(loads(importing(urls))))
        start = time.perf_counter()
        for number in range(count):
            robot.call(f"f{number}", {"data": b"1"})
        called = time.perf_counter() - start
        start = time.perf_counter()
        robot.status()
        status = time.perf_counter() - start
        memory = (resident() - before) / count
    return str(count), f"{called:.2f}", f"{1000 * status:.1f}", f"{memory:.1f}"


if __name__ == "__main__":
    main()
