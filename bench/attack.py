"""Attacks a server of its own, with a well-behaved client beside it: `python -m bench.attack`.

For each attack it prints how the server answered, how long the calls of the well-behaved client
took, and an emergency stop beside it; what memory and threads the server had before, at most, and
five seconds after; and how long it lived on after SIGTERM, while the attack ran again. Each has a
server of its own, some with many open functions. The exit code is 1 when a server died before.
`--source FOLDER` attacks the uoarm of another checkout, to compare.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import re
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from attrs import define, field, frozen
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from bench._attacks import ATTACKS
from bench.tables import print_table
from bench.turns import ROOT, load, module, running, serving

PACE_SECONDS = 0.02
STOP_SECONDS = 0.25
QUIET_SECONDS = 3.0
SETTLE_SECONDS = 5.0
TERM_SECONDS = 2.0
MOST_SECONDS = 90.0
OPENED_AT_ONCE = 50
FORM = Subprotocol("uoarm.v1.json")
HOLDS = (
    "input: {endpoint: ['bench._components:hold']}, output: {endpoint: ['bench._components:hold']}"
)
ROBOT = "version: 1\nbridges: {python: {}}\nfunctions:\n"
FUNCTION = "  %s: {components: [{name: %s, bridge: python, %s}]}\n"
COMPONENTS = {
    **{
        name: f"service: {{endpoint: ['bench._components:{name}']}}"
        for name in ("add", "anything", "sleep")
    },
    "hang": HOLDS,
    "drive": "input: {endpoint: ['bench._components:drive'], stop: {message: {speed: 0}}}",
}


def configuration(functions: int) -> str:
    """Return the robot's file, with so many functions more, `f0` and on."""
    components = COMPONENTS | {f"f{number}": HOLDS for number in range(functions)}
    return ROBOT + "".join(FUNCTION % (name, name, does) for name, does in components.items())


@frozen
class Use:
    """What the server's process uses."""

    megabytes: float
    threads: int


@define
class Client:
    """A client that asks one thing after the other, and notes how long answers took, in seconds."""

    socket: ClientConnection
    waits: list[float] = field(factory=list)
    _number: int = 0
    _since: float | None = None

    async def call(self) -> None:
        """Call at a steady pace until cancelled."""
        while True:
            await self._ask('"op":"Call","type":"add","jsonMessage":{"a":1,"b":2}')
            await asyncio.sleep(PACE_SECONDS)

    async def stop(self) -> None:
        """Stop everything again and again until cancelled; only what stops is noted."""
        while True:
            report = await self._ask('"op":"Stop"')
            assert report["stopped"], report
            assert report["inputs"], report
            noted = len(self.waits)
            await self._ask('"op":"Stop","jsonMessage":{"release":true}')
            del self.waits[noted:]
            await asyncio.sleep(STOP_SECONDS)

    async def _ask(self, fields: str) -> Any:
        self._number += 1
        self._since = time.perf_counter()
        await self.socket.send(f'{{{fields},"id":"{self._number}"}}')
        answer = json.loads(await self.socket.recv())
        while answer.get("id") != str(self._number):
            answer = json.loads(await self.socket.recv())
        self.waits.append(time.perf_counter() - self._since)
        self._since = None
        return answer.get("jsonMessage")

    def take(self) -> list[float]:
        """Return the waits since the last time, with that of a question under way."""
        waits, self.waits = self.waits, []
        if self._since is not None:
            waits.append(time.perf_counter() - self._since)
        return waits


def use(process: int) -> Use:
    """Return what a process uses now; nothing when it is gone."""
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    except OSError:
        return Use(0, 0)
    found = dict(re.findall(r"^(VmRSS|Threads):\s+(\d+)", status, re.MULTILINE))
    return Use(int(found.get("VmRSS", 0)) / 1000, int(found.get("Threads", 0)))


@contextmanager
def attacking(name: str, url: str) -> Iterator[subprocess.Popen[str]]:
    """Run an attack in a process of its own; what it prints is the result."""
    words = module("bench._attacks", name, url)
    with running(words, signal.SIGKILL, stderr=subprocess.PIPE) as attacker:
        yield attacker.process


async def attacked(name: str, url: str, server: int) -> tuple[str, Use]:
    """Run one attack to its end; returns how the server answered, and the most that it used."""
    peak = use(server)
    end = time.monotonic() + MOST_SECONDS
    with attacking(name, url) as attacker:
        while attacker.poll() is None and time.monotonic() < end:
            now = use(server)
            peak = Use(max(peak.megabytes, now.megabytes), max(peak.threads, now.threads))
            await asyncio.sleep(0.05)
        out, err = attacker.communicate() if attacker.returncode is not None else ("", "")
    lines = (out or err).strip().splitlines()
    return (lines[-1] if lines else f"no end after {MOST_SECONDS:g} s"), peak


async def open_functions(socket: ClientConnection, count: int) -> None:
    """Open that many functions, some at a time, and one that a stop stops."""
    for first in range(0, count, OPENED_AT_ONCE):
        numbers = range(first, min(count, first + OPENED_AT_ONCE))
        for number in numbers:
            await socket.send(f'{{"op":"Request","type":"f{number}","id":"{number}"}}')
        await answered(socket, {str(number) for number in numbers})
    drive = {"op": "Request", "type": "drive", "id": "drive", "jsonMessage": {"receive": False}}
    await socket.send(json.dumps(drive))
    await answered(socket, {"drive"})


async def answered(socket: ClientConnection, identities: set[str]) -> None:
    """Wait for all answers."""
    while identities:
        answer = json.loads(await socket.recv())
        if answer["op"] == "Error":
            raise RuntimeError(str(answer["jsonMessage"]))
        identities.discard(answer.get("id", ""))


async def terminated(name: str, url: str, process: subprocess.Popen[str]) -> str:
    """Return for how many seconds a server lives on after SIGTERM, beside an attack."""
    with attacking(name, url):
        await asyncio.sleep(TERM_SECONDS)
        since = time.perf_counter()
        process.send_signal(signal.SIGTERM)
        try:
            await asyncio.to_thread(process.wait, MOST_SECONDS)
        except subprocess.TimeoutExpired:
            return f"more than {MOST_SECONDS:g}"
        return f"{time.perf_counter() - since:.1f}"


async def attack(name: str, source: Path) -> tuple[str, ...]:
    """Return the row of an attack."""
    attack = ATTACKS[name]
    text = configuration(attack.functions)
    with serving(source, text, "--deflate", stderr=subprocess.DEVNULL) as (url, process):
        options: dict[str, Any] = {"subprotocols": [FORM], "ping_interval": None, "max_size": None}
        async with (
            connect(url, open_timeout=60, **options) as owner,
            connect(url, open_timeout=60, **options) as call_socket,
            connect(url, open_timeout=60, **options) as stop_socket,
        ):
            await open_functions(owner, attack.functions)
            caller, stopper = Client(call_socket), Client(stop_socket)
            beside = [asyncio.ensure_future(caller.call()), asyncio.ensure_future(stopper.stop())]
            await asyncio.sleep(QUIET_SECONDS)
            quiet, quiet_stop = (statistics.median(client.take()) for client in (caller, stopper))
            before = use(process.pid)
            answer, peak = await attacked(name, url, process.pid)
            waits, stops = caller.take(), stopper.take()
            await asyncio.sleep(SETTLE_SECONDS)
            after, died = use(process.pid), any(task.done() for task in beside)
            ended = f"died: {process.returncode}" if died else await terminated(name, url, process)
            for task in beside:
                task.cancel()
                with suppress(asyncio.CancelledError, ConnectionClosed):
                    await task
    row = (
        name, attack.sent, answer[:90],
        *(f"{seconds * 1000:,.1f}" for seconds in (quiet, statistics.median(waits), max(waits))),
        f"{max(waits) / quiet:,.0f}",
        *(f"{seconds * 1000:,.1f}" for seconds in (quiet_stop, max(stops, default=0.0))),
        ended,
        f"{before.megabytes:,.0f} / {peak.megabytes:,.0f} / {after.megabytes:,.0f}",
        f"{before.threads} / {peak.threads} / {after.threads}",
    )  # fmt: skip
    print(" | ".join(row), file=sys.stderr, flush=True)
    return row


def main() -> int:
    """Print the table; return 0 when the server lived."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(ATTACKS)}; all when left out")
    parser.add_argument("--source", type=Path, default=ROOT, metavar="FOLDER")
    options = parser.parse_args()
    source = options.source.resolve()
    rows = [asyncio.run(attack(name, source)) for name in options.names or ATTACKS]
    head = (
        "attack", "sent", "answer", "quiet median, ms", "median, ms", "worst, ms", "worst / quiet",
        "Stop quiet, ms", "Stop worst, ms", "SIGTERM, s",
        "MB before / most / after", "threads before / most / after",
    )  # fmt: skip
    print_table(f"A well-behaved client beside attacks ({load()})", head, rows)
    return int(any(row[9].startswith("died") for row in rows))


if __name__ == "__main__":
    sys.exit(main())
