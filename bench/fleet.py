"""A link to another manager: what a hop costs beside a bare WebSocket, and a desk of many managers.

All on loopback. The robot and the server that is bare are in one process, the desk in another; both
are asked in turns, with the same octets. Managers of the table have servers of their own, in
threads of the desk's process.
"""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from websockets.asyncio.server import ServerConnection, serve
from websockets.sync.client import ClientConnection, connect

from bench._components import Packet
from bench.tables import at, microseconds, print_table, spread
from bench.turns import ROOT, module, resident_megabytes, running
from uoarm import QueuePolicy, RobotManager
from uoarm._support.process_tuning import keep_memory, short_switch_interval
from uoarm.config import loads
from uoarm.server import ServerOptions, serve_in_thread

ORIGIN = str(ROOT / "bench" / "robot.yaml")
SMALL, LARGE = 1_000, 921_600
ROBOT = """
version: 1
bridges: {python: {}}
export: {local: ["*"]}
functions:
  echo: {components: [{name: echo, bridge: python, service: {endpoint: ["_components:echo"]}}]}
  small: {components: [{name: small, bridge: python, output: {endpoint: ["bench.fleet:small"]}}]}
  large: {components: [{name: large, bridge: python, output: {endpoint: ["bench.fleet:large"]}}]}
"""
SIZES = {"100 B": 100, "10 KB": 10_000, "1 MB": 1_000_000}
STREAMS = {"1 KB": (SMALL, 20_000, 500), "921,600 B": (LARGE, 200, 8)}
"""Octets of a message, how many are read, and how many may be under way."""
FUNCTIONS = {SMALL: "small", LARGE: "large"}
BARE, LINKED = "bare WebSocket", "call of a function of another manager"
ROUNDS, MANAGERS = 5, (1, 10, 50)

Trip = Callable[[bytes], object]


def main() -> None:
    """Print round trips, rates, and what a desk of many managers costs."""
    with ExitStack() as stack:
        robot, bare, credit = stack.enter_context(peers())
        desk = stack.enter_context(importer(robot))
        socket = stack.enter_context(connect(bare, compression=None, max_size=None))
        trips = {BARE: bare_trip(socket), LINKED: hop(desk)}
        samples = {(name, size): list[float]() for name in trips for size in SIZES}
        rates = {(name, size): list[float]() for name in trips for size in STREAMS}
        for _ in range(ROUNDS):
            for size, octets in SIZES.items():
                for name, trip in trips.items():
                    count = 200 if octets < 1e6 else 40
                    samples[name, size] += microseconds(partial(trip, bytes(octets)), repeat=count)
            for size, (octets, count, window) in STREAMS.items():
                rates[BARE, size].append(bare_rate(socket, octets, count))
                rates[LINKED, size].append(stream_rate(desk, credit, octets, count, window))
    rows = [(name, *(spread(samples[name, size]) for size in SIZES)) for name in trips]
    print_table("Round trip (us, median / p99)", ("what", *SIZES), rows)
    table = [
        (what, *(f"{at(sorted(rates[name, size]), 0.5):,.0f}" for size in STREAMS))
        for what, name in ((BARE, BARE), ("output of another manager", LINKED))
    ]
    print_table("Messages a second (median of rounds)", ("what", *STREAMS), table)
    head = ("managers", "until all were called (s)", "status (ms)", "MB each", "a death seen (s)")
    print_table("A desk", head, [many(count) for count in MANAGERS])


@contextmanager
def peers() -> Iterator[tuple[str, str, Path]]:
    """Have another process; gives addresses of the robot and the bare server, and the pipe."""
    with tempfile.TemporaryDirectory() as folder:
        credit = Path(folder) / "credit"
        os.mkfifo(credit)
        words = module("bench.fleet", "peer")
        with running(words, env={**os.environ, "FLEET_CREDIT": str(credit)}) as peer:
            robot, bare = (f"ws://127.0.0.1:{peer.said()}/" for _ in range(2))
            yield robot, bare, credit


def bare_trip(socket: ClientConnection) -> Trip:
    """Return what sends octets and waits until they come back."""

    def trip(octets: bytes) -> object:
        socket.send(octets)
        return socket.recv()

    return trip


def bare_rate(socket: ClientConnection, octets: int, count: int) -> float:
    """Return how many messages a second come."""
    start = time.perf_counter()
    socket.send(f"{count} {octets}")
    for _ in range(count):
        socket.recv()
    return count / (time.perf_counter() - start)


def stream_rate(desk: RobotManager, credit: Path, octets: int, count: int, window: int) -> float:
    """Return how many messages a second come of an output, with a window of them under way."""
    queue = QueuePolicy(2 * window)
    with (
        desk.request(FUNCTIONS[octets], queue=queue) as stream,
        credit.open("wb", buffering=0) as pipe,
    ):
        start = time.perf_counter()
        pipe.write(bytes(window))
        for _ in range(count - 1):
            stream.get(10)
            pipe.write(b"0")
        stream.get(10)
        return count / (time.perf_counter() - start)


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
def importer(url: str) -> Iterator[RobotManager]:
    """Have a desk that imports all of one robot."""
    text = importing([url]) + "".join(
        f"\n  {name}: {{components: [{{name: {name}, bridge: r0, "
        f"output: {{endpoint: [{name}]}}}}]}}"
        for name in FUNCTIONS.values()
    )
    with RobotManager(loads(text)) as desk:
        yield desk


def hop(desk: RobotManager) -> Trip:
    """Return what calls a function of another manager."""

    def trip(octets: bytes) -> object:
        return desk.call("f0", {"data": octets})

    trip(b"")
    return trip


def many(count: int) -> tuple[str, ...]:
    """Return the row of a desk of so many managers."""
    with ExitStack() as stack:
        dying = stack.enter_context(ExitStack())
        urls = [dying.enter_context(served())]
        urls += [stack.enter_context(served()) for _ in range(count - 1)]
        before = resident_megabytes()
        desk = stack.enter_context(RobotManager(loads(importing(urls))))
        start = time.perf_counter()
        for number in range(count):
            desk.call(f"f{number}", {"data": b"1"})
        called = time.perf_counter() - start
        start = time.perf_counter()
        desk.status()
        status = time.perf_counter() - start
        memory = (resident_megabytes() - before) / count
        start = time.perf_counter()
        dying.close()
        while not any(dict(bridge.facts)["breaks"] for bridge in desk.status().bridges):
            time.sleep(0.01)
        seen = time.perf_counter() - start
    return str(count), f"{called:.2f}", f"{1000 * status:.1f}", f"{memory:.1f}", f"{seen:.2f}"


def small() -> Iterator[Packet]:
    """Emit messages of 1 KB, as the reader lets it."""
    return _paced(SMALL)


def large() -> Iterator[Packet]:
    """Emit pictures, as the reader lets it."""
    return _paced(LARGE)


def _paced(octets: int) -> Iterator[Packet]:
    """Emit as many messages as the reader asks for, an octet each, in a pipe."""
    with Path(os.environ["FLEET_CREDIT"]).open("rb", buffering=0) as credit:
        while asked := credit.read(1024):
            for _ in asked:
                yield {"data": bytes(octets)}


async def _answer(socket: ServerConnection) -> None:
    """Give back what comes; of a text, send as many messages as it says, each so long."""
    async for message in socket:
        if isinstance(message, bytes):
            await socket.send(message)
        else:
            count, octets = map(int, message.split())
            for _ in range(count):
                await socket.send(bytes(octets))


async def _run() -> None:
    async with serve(_answer, "127.0.0.1", 0, max_size=None, compression=None) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        print(port, flush=True)
        await asyncio.to_thread(sys.stdin.read)


def serve_peer() -> None:
    """Print the ports of a robot's server and of a bare one, and serve until the input ends."""
    keep_memory()  # and a short switch interval, as `uoarm serve` has it
    robot = RobotManager(loads(ROBOT, origin=ORIGIN))
    with short_switch_interval(), robot, serve_in_thread(robot, ServerOptions(port=0)) as server:
        print(server.ports[0], flush=True)
        asyncio.run(_run())


if __name__ == "__main__":
    if sys.argv[1:]:
        serve_peer()
    else:
        main()
