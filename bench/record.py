"""A million small messages into a file: all there, in order, and what that costs. And kills.

python -m bench.record [--messages 1000000] [--kills 100]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader

from bench.tables import print_table
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.model import Message, QueuePolicy
from uoarm.record._reading import McapReader
from uoarm.testing import MemoryBridge

_MESSAGES = 1_000_000
_KILLS = 100
_ROBOT = """
version: 1
bridges: {memory: {plugin: memory}}
functions:
  counter: {components: [{name: clicks, bridge: memory, output: {endpoint: [clicks]}}]}
"""
_COUNT: Any = {
    "type": "object",
    "properties": {"n": {"type": "integer", "minimum": 0, "maximum": 2**32 - 1}},
    "required": ["n"],
    "additionalProperties": False,
}
_BLOCK = QueuePolicy(length=10_000, policy="block", timeout=600)
_RATE = 2000


def main() -> None:
    """Print what recording costs, and whether the file has what was sent."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--messages", type=int, default=_MESSAGES)
    parser.add_argument("--kills", type=int, default=_KILLS)
    parser.add_argument("--emit", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.emit:
        _emit_for_ever(Path(given.emit))
        return
    with tempfile.TemporaryDirectory() as folder:
        _cost(Path(folder), given.messages)
        if given.kills:
            _kills(Path(folder), given.kills)


def _robot(bridge: MemoryBridge) -> tuple[RobotManager, Callable[[Message], None]]:
    clicks = bridge.emitter("clicks", _COUNT)
    robot = RobotManager(loads(_ROBOT), bridges={"memory": bridge})
    return robot, clicks.emit


def _cost(folder: Path, count: int) -> None:
    rows = []
    for compression in (None, "none", "lz4", "zstd"):
        path = folder / f"{compression}.mcap"
        before = _memory()
        with ExitStack() as stack:
            bridge = MemoryBridge()
            robot, emit = _robot(bridge)
            stack.enter_context(robot)
            received = [0]

            def take(_: Message, received: list[int] = received) -> None:
                received[0] += 1

            robot.request("counter", on_message=take)
            recording = None
            if compression is not None:
                recording = stack.enter_context(
                    robot.record("counter", path=path, queue=_BLOCK, compression=compression)
                )
            begun = time.perf_counter()
            for n in range(count):
                emit({"n": n})
            if recording is not None:
                recording.close()
            seconds = time.perf_counter() - begun
        grown = _memory() - before
        assert received[0] == count
        verdict, size = ("", "") if recording is None else _verdict(path, count)
        rows.append(
            (
                compression or "not recorded",
                f"{count / seconds:,.0f}",
                f"{seconds / count * 1e6:.1f}",
                f"{grown / 1024:,.0f}",
                size,
                verdict,
            )
        )
    paced = [_paced(folder, recorded=recorded) for recorded in (False, True)]
    load = os.getloadavg()[0]
    head = ("compression", "messages a second", "us each", "memory, MiB more", "file, MB", "file")
    print_table(f"{count:,} small messages, one application beside (load {load:.1f})", head, rows)
    title = f"{_RATE:,} messages a second for five seconds"
    print_table(title, ("", "processor time, ms a second"), paced)


def _paced(folder: Path, *, recorded: bool) -> tuple[str, str]:
    with ExitStack() as stack:
        bridge = MemoryBridge()
        robot, emit = _robot(bridge)
        stack.enter_context(robot)
        robot.request("counter", on_message=lambda _: None)
        if recorded:
            stack.enter_context(robot.record("counter", path=folder / "paced.mcap"))
        begun, used = time.perf_counter(), time.process_time()
        for n in range(5 * _RATE):
            emit({"n": n})
            ahead = begun + n / _RATE - time.perf_counter()
            if ahead > 0:
                time.sleep(ahead)
        used = time.process_time() - used
    return "recorded" if recorded else "not recorded", f"{used / 5 * 1000:.0f}"


def _memory() -> int:
    """Return the most memory that the process had, in KiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _verdict(path: Path, count: int) -> tuple[str, str]:
    """Return whether each message is there, in order and octet for octet."""
    place = 0
    for message in McapReader(path).messages("/counter", 0, sys.exit):
        if bytes(message.data) != b'{"n":%d}' % place:
            return f"wrong from message {place:,} on", ""
        place += 1
    text = "all, in order, octets equal" if place == count else f"{place:,} of {count:,}"
    return text, f"{path.stat().st_size / 1e6:.1f}"


def _emit_for_ever(path: Path) -> None:
    bridge = MemoryBridge()
    robot, emit = _robot(bridge)
    robot.record("counter", path=path, queue=QueuePolicy(length=100, policy="block", timeout=600))
    n = 0
    while True:
        emit({"n": n})
        n += 1
        if n % 100 == 0:
            print(n, flush=True)


def _kills(folder: Path, count: int) -> None:
    lost = []
    for turn in range(count):
        path = folder / f"kill{turn}.mcap"
        command = [sys.executable, "-m", "bench.record", "--emit", str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            sent = int(process.stdout.readline())
            end = time.monotonic() + random.uniform(0, 1.5)
            while time.monotonic() < end:
                sent = int(process.stdout.readline())
            process.send_signal(signal.SIGKILL)
            rest = process.stdout.read().split()
        numbers = _numbers(path)
        assert numbers == list(range(len(numbers))), f"{path}: not the first messages, in order"
        lost.append(int(rest[-1] if rest else sent) - len(numbers))
        path.unlink()
    rows = [(str(count), f"{max(lost):,}", f"{sum(lost) / count:,.0f}")]
    head = ("kills", "most messages lost", "on average")
    print_table("kill -9 at random moments; a chunk has up to 6,500 of these messages", head, rows)


def _numbers(path: Path) -> list[int]:
    found = []
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, McapMessage) and b'"n"' in record.data:
                    number = json.loads(record.data)["n"]
                    found.append(number)
        except Exception:  # noqa: BLE001 - it ends somewhere
            return found
    return found


if __name__ == "__main__":
    main()
