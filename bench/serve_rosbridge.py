"""Rosbridge servers side by side on one ROS 2, measured by the same client in the same steps.

`python -m bench.serve_rosbridge` measures `uoarm serve` with the ROS 2 plugin; with
`--rosbridge ws://HOST:PORT` also the server there, which must be in the same ROS_DOMAIN_ID. With
`--process PID` of that server its memory beside a client that never reads is measured, too.
FASTDDS_BUILTIN_TRANSPORTS, where it is set, should be the same for all; it is told in the title.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from attrs import frozen
from websockets.asyncio.client import ClientConnection, connect

from bench.serve_clients import busy_seconds, resident, serving, timed
from bench.tables import at, print_table

SECONDS = 4.0
SETTLE_SECONDS = 1.0
CLIENTS = (1, 50, 100)
CONFIGURATION = """
version: 1
bridges:
  ros: {{plugin: ros2, options: {{domain_id: {domain}}}}}
functions:
  hz100: {{components: [{{name: hz100, bridge: ros, output: {{endpoint: [/bench/hz100]}}}}]}}
  hz1000: {{components: [{{name: hz1000, bridge: ros, output: {{endpoint: [/bench/hz1000]}}}}]}}
  hz4000: {{components: [{{name: hz4000, bridge: ros, output: {{endpoint: [/bench/hz4000]}}}}]}}
  flood: {{components: [{{name: flood, bridge: ros, output: {{endpoint: [/bench/flood]}}}}]}}
  pictures:
    components: [{{name: pictures, bridge: ros, output: {{endpoint: [/bench/pictures]}}}}]
  toggle: {{components: [{{name: toggle, bridge: ros, service: {{endpoint: [/bench/toggle]}}}}]}}
  in: {{components: [{{name: in, bridge: ros, input: {{endpoint: [/bench/in]}}}}]}}
  out: {{components: [{{name: out, bridge: ros, output: {{endpoint: [/bench/out]}}}}]}}
"""


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
        told = json.loads(await asyncio.wait_for(self.socket.recv(), 20))
        if told["op"] == "status":
            raise RuntimeError(told["msg"])
        return told


@asynccontextmanager
async def client(peer: Peer) -> AsyncIterator[Reader]:
    """Connect to a server."""
    async with connect(peer.url, max_size=None, compression=None, ping_interval=None) as socket:
        yield Reader(socket, peer.prefix)


async def round_trip(peer: Peer) -> list[float]:
    """Return sorted microseconds from publishing to the echo of another ROS 2 process."""
    async with client(peer) as reader:
        kind = {"type": "std_msgs/String"}
        await reader.send("advertise", "in", **kind)
        await reader.send("subscribe", "out", **kind)
        await asyncio.sleep(SETTLE_SECONDS)  # rosbridge never says when a topic is ready

        async def echo() -> None:
            await reader.send("publish", "in", msg={"data": "x"})
            await reader.receive()

        return sorted([await timed(echo()) for _ in range(1000)][50:])


async def service_call(peer: Peer) -> list[float]:
    """Return sorted microseconds of a service call to another ROS 2 process."""
    async with client(peer) as reader:

        async def call() -> None:
            fields = {"id": "1", "args": {"data": True}, "type": "std_srvs/SetBool"}
            await reader.send("call_service", "toggle", "service", **fields)
            told = await reader.receive()
            assert told["result"], told

        return sorted([await timed(call()) for _ in range(1000)][50:])


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


def _stamp(told: Any) -> tuple[int, int]:
    number, moment, _ = told["msg"]["data"].split(" ", 2)
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
    """Return how long messages take from source to program, for clients that each get 100 Hz."""
    latencies: list[float] = []

    async def one() -> None:
        async with client(peer) as reader:
            await reader.send("subscribe", "hz100", type="std_msgs/String")
            await reader.receive()
            begin = time.monotonic() + SETTLE_SECONDS
            while (now := time.monotonic()) < begin + SECONDS:
                moment = _stamp(await reader.receive())[1]
                if now > begin:
                    latencies.append((time.monotonic_ns() - moment) / 1000)

    await asyncio.gather(*(one() for _ in range(clients)))
    spread = sorted(latencies)
    return f"{_ms(spread, 0.5)} / {_ms(spread, 0.99)} ms, {len(spread) / SECONDS:,.0f} a second"


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


async def bare() -> str:
    """Return the pictures a second that a process gets that does nothing but subscribe."""
    reader = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "bench._ros2_reader", str(SECONDS), stdout=asyncio.subprocess.PIPE
    )
    told, _ = await asyncio.wait_for(reader.communicate(), 30)
    return f"{float(told):,.0f}"


def _busy(peer: Peer) -> float:
    return float("nan") if peer.process is None else busy_seconds(peer.process)


def _each(peer: Peer, before: float, count: int) -> str:
    """Return the processor time of the server for each message since it had had `before`."""
    return f"{(_busy(peer) - before) / count * 1e6:,.0f} us CPU each"


def _memory(peer: Peer) -> float:
    return float("nan") if peer.process is None else resident(peer.process)


async def measure(peer: Peer) -> list[str]:
    """Return one column of the table."""
    trips, calls = await round_trip(peer), await service_call(peer)
    return [
        f"{_ms(trips, 0.5)} / {_ms(trips, 0.99)} ms",
        f"{_ms(calls, 0.5)} / {_ms(calls, 0.99)} ms",
        *[await flow(peer, source) for source in ("flood", "hz4000", "hz1000")],
        *[await pictures(peer, compression) for compression in ("none", "cbor", "cbor-raw")],
        *[await many(peer, clients) for clients in CLIENTS],
        await never_reading(peer),
    ]


def _ms(samples: list[float], quantile: float) -> str:
    return f"{at(samples, quantile) / 1000:.2f}"


WHAT = (
    "publish, echo of another process, median / p99",
    "service call, median / p99",
    "1 KB messages a second to one client from a source of 10,000 Hz",
    "from a source of 4,000 Hz",
    "from a source of 1,000 Hz",
    "pictures of 921,600 B a second, of 600, JSON",
    "pictures of 921,600 B a second, of 600, CBOR",
    "pictures of 921,600 B a second, of 600, cbor-raw",
    *(f"clients at 100 Hz, 1 KB: {clients}, median / p99" for clients in CLIENTS),
    "memory beside a client that never reads pictures; another one at 100 Hz",
)


async def run(other: str | None, process: int | None) -> None:
    """Measure and print."""
    world = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "bench._ros2_world", stdout=asyncio.subprocess.PIPE
    )
    assert world.stdout is not None
    try:
        await asyncio.wait_for(world.stdout.readline(), 30)
        ceiling = await bare()
        columns: list[list[str]] = []
        names: list[str] = []
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "robot.yaml"
            domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
            file.write_text(CONFIGURATION.format(domain=domain), encoding="utf-8")
            async with serving(file) as (url, own):
                peer = Peer("uoarm serve", f"{url}rosbridge", "/uoarm/", own)
                names.append(peer.name)
                columns.append(await measure(peer))
        if other is not None:
            names.append(other)
            columns.append(await measure(Peer(other, other, "/bench/", process)))
    finally:
        world.send_signal(signal.SIGKILL)
        await world.wait()
    load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
    transports = os.environ.get("FASTDDS_BUILTIN_TRANSPORTS", "as they come")
    title = (
        f"rosbridge v2 on ROS 2, {os.cpu_count()} cores, load {load} at the end, transports "
        f"{transports}, a bare rclpy subscription gets {ceiling} pictures a second"
    )
    print_table(title, ("", *names), list(zip(WHAT, *columns, strict=True)))


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rosbridge", help="address of another rosbridge server to compare with")
    parser.add_argument("--process", type=int, help="process id of that server")
    chosen = parser.parse_args()
    asyncio.run(run(chosen.rosbridge, chosen.process))
    return 0


if __name__ == "__main__":
    sys.exit(main())
