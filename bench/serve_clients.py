"""The WebSocket front end under load: `python -m bench.serve_clients` measures a server of its own.

For its rosbridge endpoint beside other servers see `bench.serve_rosbridge`.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import signal
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import cbor2
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

from bench._serve_components import CONFIGURATION, SOURCE
from bench.tables import at, print_table, row

SECONDS = 4.0
HERE = Path(__file__).parent
PLUGINS = ("rosbridge", "ros2")
SOURCES = {
    "hz100": ("texts", 100, 1000),
    "hz4000": ("texts", 4000, 1000),
    "flood": ("texts", 60_000, 1000),
    "pictures": ("images", 500, 921_600),
}
Row = tuple[str, ...]


class Speaker:
    """One native client in either form."""

    def __init__(self, socket: ClientConnection, *, binary: bool) -> None:
        self.socket = socket
        self.dump: Callable[[Any], Any] = cbor2.dumps if binary else json.dumps
        self.load: Callable[[Any], Any] = cbor2.loads if binary else json.loads

    async def ask(self, **fields: Any) -> Any:
        """Return the reply; data that comes before it is passed over."""
        await self.socket.send(self.dump({"id": "1", **fields}))
        while True:
            told = self.load(await self.socket.recv())
            if told["op"] == "Error":
                raise RuntimeError(told["jsonMessage"]["text"])
            if told["op"] == "Reply":
                return told.get("jsonMessage")


@asynccontextmanager
async def native(url: str, *, binary: bool = False) -> AsyncIterator[Speaker]:
    protocol = Subprotocol("uoarm.v1.cbor" if binary else "uoarm.v1.json")
    async with connect(url, subprotocols=[protocol], max_size=None, compression=None) as socket:
        speaker = Speaker(socket, binary=binary)
        speaker.load(await socket.recv())
        yield speaker


@asynccontextmanager
async def own_server(
    sources: Mapping[str, tuple[str, int, int]] = SOURCES,
) -> AsyncIterator[tuple[str, int]]:
    """Run `uoarm serve` with sources (kind, hertz, octets); yields its address and process id."""
    text = CONFIGURATION + "".join(
        SOURCE.format(name=name, kind=kind, hertz=hertz, size=size)
        for name, (kind, hertz, size) in sources.items()
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        file.write_text(text, encoding="utf-8")
        async with serving(file) as served:
            yield served


@asynccontextmanager
async def serving(file: Path, checkout: Path = HERE.parent) -> AsyncIterator[tuple[str, int]]:
    """Run `uoarm serve` of a checkout with a configuration; yields its address and process id."""
    plugins = (checkout / "plugins" / f"uoarm-{name}" / "src" for name in PLUGINS)
    sources = [checkout, checkout / "src", *plugins]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "uoarm", "serve", str(file), "--port", "0",
        stdout=asyncio.subprocess.PIPE,
        cwd=checkout,
        env={
            **os.environ, "PYTHONPATH": os.pathsep.join(map(str, sources)), "PYTHONUNBUFFERED": "1"
        },
    )  # fmt: skip
    assert process.stdout is not None
    try:
        line = (await asyncio.wait_for(process.stdout.readline(), 30)).decode()
        found = re.search(r"(ws://[^ ]+/) ", line)
        assert found is not None, line
        yield found.group(1), process.pid
    finally:
        process.send_signal(signal.SIGTERM)
        await asyncio.wait_for(process.wait(), 10)


def resident(process: int) -> float:
    """Return the megabytes of memory that a process has."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def busy_seconds(process: int) -> float:
    """Return the processor time that a process has taken."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def round_trips(url: str, *, binary: bool) -> tuple[Row, Row]:
    form = "CBOR" if binary else "JSON"
    async with native(url, binary=binary) as speaker:
        call = {"op": "Call", "type": "add", "jsonMessage": {"a": 1, "b": 2}}
        calls = [await timed(speaker.ask(**call)) for _ in range(2000)][100:]
        name = (await speaker.ask(op="Request", type="echo"))["connection"]
        message = speaker.dump(
            {"op": "Data", "type": name, "id": "e", "jsonMessage": {"data": "x"}}
        )

        async def echo() -> None:
            await speaker.socket.send(message)
            while speaker.load(await speaker.socket.recv())["op"] != "Data":
                pass

        echoes = [await timed(echo()) for _ in range(2000)][100:]
    return row(f"service call, {form}", sorted(calls)), row(f"echo, {form}", sorted(echoes))


async def timed(step: Any) -> float:
    """Return the microseconds that a step took."""
    start = time.perf_counter_ns()
    await step
    return (time.perf_counter_ns() - start) / 1000


async def flow(url: str, source: str, *, binary: bool, parse: bool = True) -> tuple[float, float]:
    """Return messages a second and the share of those sent that did not come."""
    async with native(url, binary=binary) as speaker:
        await speaker.ask(op="Request", type=source)
        first = last = count = 0
        end = time.perf_counter() + SECONDS
        began = None
        while time.perf_counter() < end:
            frame = await speaker.socket.recv()
            began = began or time.perf_counter()
            count += 1
            if parse:
                last = speaker.load(frame)["x-number"]
                first = first or last
        assert began is not None
        lost = 1 - count / (last - first + 1) if parse else float("nan")
        return count / (time.perf_counter() - began), lost


async def many(url: str, clients: int) -> Row:
    """Return latencies of `clients` that each get 100 messages of 1 KB a second."""
    latencies: list[float] = []

    async def one() -> None:
        async with native(url) as speaker:
            await speaker.ask(op="Request", type="hz100")
            end = time.perf_counter() + SECONDS
            while time.perf_counter() < end:
                told = speaker.load(await speaker.socket.recv())
                latencies.append((time.monotonic_ns() - told["jsonMessage"]["time"]) / 1000)

    await asyncio.gather(*(one() for _ in range(clients)))
    return row(f"{clients} clients at 100 Hz", sorted(latencies[clients * 50 :]))


async def never_reading(url: str, process: int) -> Row:
    """Return the growth of the server beside a client that never reads, and what others get."""
    alone, _ = await flow(url, "hz4000", binary=False)
    async with native(url) as stuck:
        await stuck.socket.send(json.dumps({"op": "Request", "type": "hz4000", "id": "1"}))
        stuck.socket.transport.pause_reading()
        before = resident(process)
        beside, lost = await flow(url, "hz4000", binary=False)
        grown = resident(process) - before
        stuck.socket.transport.abort()
    note = f"{beside / alone:.0%} of its messages, {lost:.1%} lost"
    return "a client that never reads", f"{grown / SECONDS:+.1f} MB/s", note


async def idle(url: str, process: int, clients: int) -> Row:
    before, start = resident(process), time.perf_counter()
    sockets = []
    for _ in range(clients // 50):
        sockets += await asyncio.gather(*(connect(url, compression=None) for _ in range(50)))
    took = time.perf_counter() - start
    each = (resident(process) - before) * 1000 / clients
    async with native(url) as speaker:
        calls = [
            await timed(speaker.ask(op="Call", type="add", jsonMessage={"a": 1, "b": 2}))
            for _ in range(200)
        ]
    await asyncio.gather(*(socket.close() for socket in sockets))
    note = f"all in {took:.1f} s; a call takes {at(sorted(calls), 0.5):,.0f} us beside them"
    return f"{clients} idle clients", f"{each:.0f} KB each", note


async def measure_own(clients: int) -> None:
    async with own_server() as (url, process):
        times = [one for binary in (False, True) for one in await round_trips(url, binary=binary)]
        times.append(await many(url, 50))
        print_table("uoarm serve, time (us)", ("what", "median", "p99", ""), times)
        rates: list[Row] = []
        for source, what in (
            ("hz4000", "4,000 Hz of 1 KB"),
            ("flood", "as fast as they come, 1 KB"),
        ):
            before = busy_seconds(process)
            rate, lost = await flow(url, source, binary=False)
            each = (busy_seconds(process) - before) / (rate * SECONDS) * 1e6
            rates.append((what, f"{rate:,.0f}", f"{lost:.1%} lost, {each:.0f} us CPU each"))
        for binary in (False, True):
            rate, _ = await flow(url, "pictures", binary=binary, parse=False)
            rates.append(
                (f"pictures of 921,600 B, {'CBOR' if binary else 'JSON'}", f"{rate:,.0f}", "")
            )
        rates.append(await never_reading(url, process))
        rates.append(await idle(url, process, clients))
        print_table("uoarm serve, messages a second to one client", ("what", "", ""), rates)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--idle", type=int, default=2000, help="idle clients")
    chosen = parser.parse_args()
    asyncio.run(measure_own(chosen.idle))
    return 0


if __name__ == "__main__":
    sys.exit(main())
