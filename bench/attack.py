"""Attacks a server of its own, with a well-behaved client beside it: `python -m bench.attack`.

For each attack it prints how the server answered, how long the calls of the well-behaved client
took, and what memory and threads the server had before, at most, and five seconds after. The exit
code is 1 when the server died. `--source FOLDER` attacks the uoarm of another checkout, to compare.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from attrs import define, field, frozen
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from bench._attack_components import CONFIGURATION
from bench._attacks import ATTACKS
from bench.tables import print_table

HERE = Path(__file__).parent
PACE_SECONDS = 0.02
QUIET_SECONDS = 3.0
SETTLE_SECONDS = 5.0
MOST_SECONDS = 90.0
AIM = 10


@frozen
class Use:
    """What the server's process uses."""

    megabytes: float
    threads: int


@define
class Caller:
    """A client that calls at a steady pace and notes how long each call took, in seconds."""

    socket: ClientConnection
    waits: list[float] = field(factory=list)
    _since: float | None = None

    async def run(self) -> None:
        """Call until cancelled."""
        call = '{"op":"Call","type":"add","id":"%d","jsonMessage":{"a":1,"b":2}}'
        number = 0
        while True:
            number += 1
            self._since = time.perf_counter()
            await self.socket.send(call % number)
            told = json.loads(await self.socket.recv())
            while told.get("id") != str(number):
                told = json.loads(await self.socket.recv())
            self.waits.append(time.perf_counter() - self._since)
            self._since = None
            await asyncio.sleep(PACE_SECONDS)

    def take(self) -> list[float]:
        """Return the waits since the last time, with that of a call under way."""
        waits, self.waits = self.waits, []
        if self._since is not None:
            waits.append(time.perf_counter() - self._since)
        return waits


@asynccontextmanager
async def serving(source: Path) -> AsyncIterator[tuple[str, asyncio.subprocess.Process]]:
    """Run `uoarm serve`; yields its address and process."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        file.write_text(CONFIGURATION, encoding="utf-8")
        paths = os.pathsep.join(map(str, (source / "src", HERE.parent)))
        log = (Path(folder) / "log").open("wb")
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "uoarm", "serve", str(file), "--port", "0", "--deflate",
            stdout=asyncio.subprocess.PIPE, stderr=log,
            env={**os.environ, "PYTHONPATH": paths, "PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        assert process.stdout is not None
        try:
            found = None
            while found is None:
                line = (await process.stdout.readline()).decode()
                if not line:
                    raise RuntimeError((Path(folder) / "log").read_text())
                found = re.search(r"(ws://[^ ]+/)", line)
            yield found.group(1), process
        finally:
            log.close()
            if process.returncode is None:
                process.send_signal(signal.SIGTERM)
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(process.wait(), 20)
            if process.returncode is None:
                process.kill()


def use(process: int) -> Use:
    """Return what a process uses now; nothing when it is gone."""
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    except OSError:
        return Use(0, 0)
    found = dict(re.findall(r"^(VmRSS|Threads):\s+(\d+)", status, re.MULTILINE))
    return Use(int(found.get("VmRSS", 0)) / 1000, int(found.get("Threads", 0)))


async def attacked(name: str, url: str, server: int) -> tuple[str, Use]:
    """Run one attack to its end; returns how the server answered, and the most that it used."""
    attacker = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "bench._attacks", name, url,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, cwd=HERE.parent,
    )  # fmt: skip
    reading = asyncio.ensure_future(attacker.communicate())
    peak = use(server)
    end = time.monotonic() + MOST_SECONDS
    while not reading.done() and time.monotonic() < end:
        now = use(server)
        peak = Use(max(peak.megabytes, now.megabytes), max(peak.threads, now.threads))
        await asyncio.sleep(0.05)
    if not reading.done():
        attacker.kill()
    out, err = await reading
    lines = (out or err).decode().strip().splitlines()
    return (lines[-1] if lines else f"no end after {MOST_SECONDS:g} s"), peak


async def attack(names: list[str], source: Path) -> list[tuple[str, ...]]:
    """Return a row for each attack; the last one says so where the server died."""
    rows: list[tuple[str, ...]] = []
    async with serving(source) as (url, process):
        form = Subprotocol("uoarm.v1.json")
        async with connect(url, subprotocols=[form], ping_interval=None, open_timeout=60) as socket:
            caller = Caller(socket)
            calling = asyncio.ensure_future(caller.run())
            for name in names:
                await asyncio.sleep(QUIET_SECONDS)
                quiet = statistics.median(caller.take())
                before = use(process.pid)
                answer, peak = await attacked(name, url, process.pid)
                waits = caller.take()
                await asyncio.sleep(SETTLE_SECONDS)
                caller.take()
                after = use(process.pid)
                median, worst = statistics.median(waits), max(waits)
                rows.append((
                    ATTACKS[name].row, ATTACKS[name].sent, answer[:90],
                    f"{quiet * 1000:,.1f}", f"{median * 1000:,.1f}", f"{worst * 1000:,.0f}",
                    f"{worst / quiet:,.0f}",
                    f"{before.megabytes:,.0f} / {peak.megabytes:,.0f} / {after.megabytes:,.0f}",
                    f"{before.threads} / {peak.threads} / {after.threads}",
                ))  # fmt: skip
                print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
                if process.returncode is not None or calling.done():
                    rows.append(("", "", f"the server ended: {process.returncode}", *[""] * 6))
                    break
            calling.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await calling
    return rows


def main() -> int:
    """Print the table; return 0 when the server lived."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(ATTACKS)}; all when left out")
    parser.add_argument("--source", type=Path, default=HERE.parent, metavar="FOLDER")
    options = parser.parse_args()
    rows = asyncio.run(attack(options.names or list(ATTACKS), options.source.resolve()))
    head = (
        "row", "sent", "answer", "quiet median, ms", "median, ms", "worst, ms",
        "worst / quiet", "MB before / most / after", "threads before / most / after",
    )  # fmt: skip
    print_table(f"A well-behaved client beside attacks (load {os.getloadavg()[0]:.1f})", head, rows)
    return int(rows[-1][2].startswith("the server ended"))


if __name__ == "__main__":
    sys.exit(main())
