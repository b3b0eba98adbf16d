"""Rosbridge servers side by side on one ROS 2, measured by the same client in the same steps.

`python -m bench.serve_rosbridge` measures `uoarm serve` with the ROS 2 plugin; with
`--before FOLDER` also that of another checkout, and with `--rosbridge ws://HOST:PORT` the server
there, which must be in the same ROS_DOMAIN_ID. With `--process PID` of that server its memory
beside a client that never reads is measured, too. All are measured in turns, row by row, as often
as `--rounds` says. FASTDDS_BUILTIN_TRANSPORTS, where it is set, should be the same for all; it is
shown in the title.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import ExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

from attrs import frozen
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from bench.tables import print_table, spread
from bench.turns import module, parser, resident_megabytes, running, serving, states

SECONDS = 4.0
SETTLE_SECONDS = 1.0
CLIENTS = (1, 50, 100)
TOPICS = 200
CONFIGURATION = """
version: 1
bridges:
  ros: {{plugin: ros2, options: {{domain_id: {domain}}}}}
functions:
"""
FUNCTION = "  {0}: {{components: [{{name: {0}, bridge: ros, {1}: {{endpoint: [/bench/{0}]}}}}]}}\n"
ROLES = {
    **{f"t{number}": "output" for number in range(TOPICS)},
    **dict.fromkeys(("hz100", "hz1000", "hz4000", "flood", "pictures", "out"), "output"),
    "in": "input",
    "toggle": "service",
}


@frozen
class Peer:
    """A server to measure.

    Attributes:
        name: in the table.
        url: where it is.
        prefix: before the names of the world's topics and services.
        process: its process, where it is known.
    """

    name: str
    url: str
    prefix: str
    process: int | None


class Reader:
    """One rosbridge client."""

    def __init__(self, socket: ClientConnection, prefix: str) -> None:
        self.socket = socket
        self._prefix = prefix

    async def send(self, op: str, name: str, kind: str = "topic", **fields: Any) -> None:
        """Send one operation about a topic or service."""
        message = {"op": op, kind: f"{self._prefix}{name}", **fields}
        await self.socket.send(json.dumps(message))

    async def receive(self) -> Any:
        """Return the next message; fails on a status, so that no error is measured."""
        report = json.loads(await asyncio.wait_for(self.socket.recv(), 20))
        if report["op"] == "status":
            raise RuntimeError(report["msg"])
        return report


@asynccontextmanager
async def client(peer: Peer) -> AsyncIterator[Reader]:
    """Connect to a server."""
    async with connect(peer.url, max_size=None, compression=None, ping_interval=None) as socket:
        yield Reader(socket, peer.prefix)


async def timed(step: Any) -> float:
    """Return the milliseconds that a step took."""
    start = time.perf_counter()
    await step
    return (time.perf_counter() - start) * 1000


async def begin(peer: Peer) -> str:
    """Wait for a first message: a server may look for ROS 2 only when it is asked for a topic."""
    async with client(peer) as reader:
        await reader.send("subscribe", "hz100", type="std_msgs/String")
        await reader.receive()
    return "begun"


async def round_trip(peer: Peer) -> list[float]:
    """Return milliseconds from publishing to the echo of another ROS 2 process."""
    async with client(peer) as reader:
        kind = {"type": "std_msgs/String"}
        await reader.send("advertise", "in", **kind)
        await reader.send("subscribe", "out", **kind)
        await asyncio.sleep(SETTLE_SECONDS)  # rosbridge never says when a topic is ready

        async def echo() -> None:
            await reader.send("publish", "in", msg={"data": "x"})
            await reader.receive()

        return [await timed(echo()) for _ in range(1000)][50:]


async def service_call(peer: Peer) -> list[float]:
    """Return milliseconds of a service call to another ROS 2 process."""
    async with client(peer) as reader:

        async def call() -> None:
            fields = {"id": "1", "args": {"data": True}, "type": "std_srvs/SetBool"}
            await reader.send("call_service", "toggle", "service", **fields)
            message = await reader.receive()
            assert message["result"], message

        return [await timed(call()) for _ in range(1000)][50:]


async def flow(peer: Peer, source: str) -> str:
    """Return messages of 1 KB a second, and the share that did not come."""
    async with client(peer) as reader:
        await reader.send("subscribe", source, type="std_msgs/String")
        first = number = _stamp(await reader.receive())[0]
        busy, start, count = _busy(peer), time.perf_counter(), 0
        while time.perf_counter() - start < SECONDS:
            number, count = _stamp(await reader.receive())[0], count + 1
        rate, lost = count / (time.perf_counter() - start), 1 - count / (number - first)
        return f"{rate:,.0f}, {lost:.1%} lost, {_each(peer, busy, count)}"


def _stamp(message: Any) -> tuple[int, int]:
    number, moment, _ = message["msg"]["data"].split(" ", 2)
    return int(number), int(moment)


async def pictures(peer: Peer, compression: str) -> str:
    """Return pictures a second; not decoded or parsed, which would measure the client."""
    async with client(peer) as reader:
        kind = {"type": "sensor_msgs/Image", "compression": compression}
        await reader.send("subscribe", "pictures", **kind)
        frame = await asyncio.wait_for(reader.socket.recv(), 20)
        assert len(frame) > 900_000, frame[:300]
        assert isinstance(frame, str) == (compression == "none")
        busy, start, count = _busy(peer), time.perf_counter(), 0
        while time.perf_counter() - start < SECONDS:
            await asyncio.wait_for(reader.socket.recv(decode=False), 20)
            count += 1
        rate = count / (time.perf_counter() - start)
        return f"{rate:,.1f}, {_each(peer, busy, count)}"


async def many(peer: Peer, clients: int) -> str:
    """Return how old messages are on arrival at clients that each get 100 Hz, and how many came.

    The clients are in a process of their own that does little but read.
    """
    address = (peer.url, f"{peer.prefix}hz100", str(clients), str(SECONDS))
    with running(module("bench._websocket_reader", *address)) as reader:
        reader.said("(begins)")
        busy = _busy(peer)
        report = json.loads(reader.said())
        busy = _busy(peer) - busy
    ages = f"{report['median']:,.1f} / {report['p99']:,.1f} ms"
    rate = f"{report['count'] / SECONDS:,.0f} a second"
    return f"{ages}, {rate}, {busy / SECONDS:.0%} of a core (client {report['busy'] / SECONDS:.0%})"


async def topics(peer: Peer) -> str:
    """Return how long many topics take from the first subscription to the last's first message."""
    async with client(peer) as reader:
        busy, start = _busy(peer), time.perf_counter()
        for number in range(TOPICS):
            await reader.send("subscribe", f"t{number}", type="std_msgs/String")
        waiting = {f"{peer.prefix}t{number}" for number in range(TOPICS)}
        while waiting:
            waiting.discard((await reader.receive())["topic"])
        took = time.perf_counter() - start
        return f"{took:.2f} s, {(_busy(peer) - busy) / TOPICS * 1000:.1f} ms CPU each"


async def head_of_line(peer: Peer) -> str:
    """Return how old small messages are beside 10 pictures a second on the same connection."""
    ages: list[float] = []
    async with client(peer) as reader:
        kind = {"type": "sensor_msgs/Image", "compression": "cbor"}
        await reader.send("subscribe", "pictures", throttle_rate=100, **kind)
        await reader.send("subscribe", "hz100", type="std_msgs/String")
        begin = time.monotonic() + SETTLE_SECONDS
        while (now := time.monotonic()) < begin + SECONDS:
            frame = await asyncio.wait_for(reader.socket.recv(), 20)
            if isinstance(frame, str) and now > begin:
                ages.append((time.monotonic_ns() - _stamp(json.loads(frame))[1]) / 1e6)
    return f"{spread(ages, 2)} ms, {len(ages) / SECONDS:,.0f} a second" if ages else "none came"


async def never_reading(peer: Peer) -> str:
    """Return the growth of the server beside a client that never reads, and what others get."""
    async with client(peer) as stuck, client(peer) as healthy:
        await stuck.send("subscribe", "pictures", type="sensor_msgs/Image")
        await asyncio.wait_for(stuck.socket.recv(), 20)
        stuck.socket.transport.pause_reading()
        await healthy.send("subscribe", "hz100", type="std_msgs/String")
        settled, count = time.perf_counter() + SETTLE_SECONDS, 0
        while time.perf_counter() < settled:
            await healthy.receive()
        before, start = _memory(peer), time.perf_counter()
        while time.perf_counter() - start < SECONDS:
            await healthy.receive()
            count += 1
        grown = (_memory(peer) - before) / (time.perf_counter() - start)
        stuck.socket.transport.abort()
    return f"{grown:+.1f} MB/s; the other {count / SECONDS:.0f} a second"


def bare(*arguments: str) -> dict[str, Any]:
    """Return what a process gets that does nothing but subscribe."""
    words = module("bench._ros2_world", "read", str(SECONDS), *arguments)
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True, timeout=30)
    got: dict[str, Any] = json.loads(done.stdout)
    return got


def bare_beside() -> str:
    """Return how old small messages are beside pictures where no server is between."""
    reports = bare("small")
    return f"{reports['ages']} ms, {reports['small']:,.0f} a second"


def _busy(peer: Peer) -> float:
    """Return the processor time that a server has taken, in seconds; NaN where it is not known."""
    if peer.process is None:
        return float("nan")
    fields = Path(f"/proc/{peer.process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _each(peer: Peer, before: float, count: int) -> str:
    """Return the processor time of the server for each message since it had had `before`."""
    return f"{(_busy(peer) - before) / count * 1e6:,.0f} us CPU each"


def _memory(peer: Peer) -> float:
    """Return the megabytes of memory that a server has; NaN where its process is not known."""
    return float("nan") if peer.process is None else resident_megabytes(peer.process)


async def _trips(peer: Peer, measured: Callable[[Peer], Awaitable[list[float]]]) -> str:
    return f"{spread(await measured(peer), 2)} ms"


BESIDE = "age of 100 Hz of 1 KB beside 10 pictures a second, median / p99"
Measured = Callable[[Peer], Awaitable[str]]
ROWS: dict[str, Measured] = {
    "publish, echo of another process, median / p99": partial(_trips, measured=round_trip),
    "service call, median / p99": partial(_trips, measured=service_call),
    **{
        f"1 KB messages a second to one client, of {hertz}": partial(flow, source=source)
        for source, hertz in (("flood", "10,000"), ("hz4000", "4,000"), ("hz1000", "1,000"))
    },
    **{
        f"pictures of 921,600 B a second, of 600, {name}": partial(pictures, compression=kind)
        for kind, name in (("none", "JSON"), ("cbor", "CBOR"), ("cbor-raw", "cbor-raw"))
    },
    **{
        f"age at {clients} clients, 100 Hz of 1 KB, median / p99": partial(many, clients=clients)
        for clients in CLIENTS
    },
    f"{TOPICS} topics to one client": topics,
    BESIDE: head_of_line,
    "memory beside a client that never reads pictures; another one at 100 Hz": never_reading,
}


async def _cell(measured: Measured, peer: Peer) -> str:
    """Return one cell; a server that does not answer in time costs its cell, not the others."""
    try:
        return await measured(peer)
    except (asyncio.TimeoutError, ConnectionClosed, RuntimeError) as error:
        return f"{type(error).__name__} {error}"


async def run(chosen: argparse.Namespace) -> None:
    """Measure and print."""
    rows = {what: row for what, row in ROWS.items() if chosen.only in what}
    table: list[Sequence[str]] = []
    text = CONFIGURATION.format(domain=os.environ.get("ROS_DOMAIN_ID", "0"))
    text += "".join(FUNCTION.format(*role) for role in ROLES.items())
    with ExitStack() as stack:
        words = module("bench._ros2_world", str(TOPICS))
        stack.enter_context(running(words, signal.SIGKILL)).said("(ready)")
        ceiling = bare()["pictures"]
        peers: list[Peer] = []
        for name, checkout in states(chosen).items():
            url, process = stack.enter_context(serving(checkout, text, cwd=checkout))
            peers.append(Peer(name, f"{url}rosbridge", "/uoarm/", process.pid))
        if chosen.rosbridge is not None:
            url = chosen.rosbridge
            peers.append(Peer(url, url, "/bench/", chosen.process))
        for peer in peers:
            print(peer.name, await _cell(begin, peer), file=sys.stderr, flush=True)
        for number in range(chosen.rounds):
            for what, measured in rows.items():
                load = f"{os.getloadavg()[0]:.1f}"
                cells = [await _cell(measured, peer) for peer in peers]
                without = bare_beside() if what == BESIDE else ""
                table.append((f"{number + 1}: {what}", *cells, without, load))
                print(*table[-1], sep=" | ", file=sys.stderr, flush=True)
    transports = os.environ.get("FASTDDS_BUILTIN_TRANSPORTS", "as they come")
    title = (
        f"rosbridge v2 on ROS 2, {os.cpu_count()} cores, transports {transports}, "
        f"a bare rclpy subscription gets {ceiling:,.0f} pictures a second"
    )
    print_table(
        title, ("", *(peer.name for peer in peers), "bare rclpy", "load"), sorted(table, key=_what)
    )


def _what(line: Sequence[str]) -> int:
    """Return the place of a line, with the rounds of each row together."""
    return list(ROWS).index(line[0].partition(": ")[2])


def main() -> int:
    """Print the table."""
    asked = parser(__doc__)
    asked.add_argument("--rosbridge", help="address of another rosbridge server to compare with")
    asked.add_argument("--process", type=int, help="process id of that server")
    asked.add_argument("--only", default="", help="measure the rows only that have this in them")
    asyncio.run(run(asked.parse_args()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
