"""A million small messages into a file: all there, in order, and what that costs. And kills.

python -m bench.record [--messages 1000000] [--kills 100]
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import random
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader

from bench.tables import print_table
from bench.turns import load, module, resident_megabytes, running
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
_OCTETS = {"type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}}
_PICTURE: Any = {
    **_COUNT,
    "properties": {**_COUNT["properties"], "data": {**_OCTETS, "x-octets": True}},
    "required": ["n", "data"],
}
_PACES = (
    ("2,000 small messages a second", 2000.0, 0),
    ("4,000 of 1 KB", 4000.0, 1000),
    ("30 pictures of 921,600 B", 30.0, 921_600),
)
_TURNS = 5
_SECONDS = 3
_NOT = "not recorded"
_ALL = "all, in order, octets equal"


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
        _flat(Path(folder), given.messages)
        if given.kills:
            _kills(Path(folder), given.kills)


@contextmanager
def _robot(schema: Any = _COUNT) -> Iterator[tuple[RobotManager, Callable[[Message], None]]]:
    bridge = MemoryBridge()
    clicks = bridge.emitter("clicks", schema)
    with RobotManager(loads(_ROBOT), bridges={"memory": bridge}) as robot:
        yield robot, clicks.emit


def _cost(folder: Path, count: int) -> None:
    rows = []
    rates: dict[str, list[float]] = {}
    # In turns, as other work of the machine changes from minute to minute.
    for turn in range(_TURNS):
        for compression in (_NOT, "none", "zstd"):
            path = folder / f"{compression}{turn}.mcap"
            recorded = None if compression == _NOT else compression
            rate, verdict = _flow(path, recorded, count // _TURNS)
            rates.setdefault(compression, []).append(rate)
            assert verdict in ("", _ALL), f"{compression}: {verdict}"
    plain = statistics.median(rates[_NOT])
    for compression, found in rates.items():
        rate = statistics.median(found)
        more = "" if compression == _NOT else f"{(1 / rate - 1 / plain) * 1e6:.1f}"
        rows.append((compression, f"{rate:,.0f}", f"{1e6 / rate:.1f}", more))
    head = ("compression", "messages a second of processor", "us each", "us more")
    title = f"small messages as fast as they come, median of {_TURNS} turns ({load()})"
    print_table(title, head, rows)
    paced = []
    for name, rate, size in _PACES:
        used: dict[bool, list[float]] = {False: [], True: []}
        for turn in range(_TURNS):
            for is_recorded in (False, True):
                path = folder / f"paced{turn}.mcap"
                used[is_recorded].append(_paced(path if is_recorded else None, rate, size))
                path.unlink(missing_ok=True)
        without, with_ = (statistics.median(used[key]) for key in (False, True))
        paced.append((name, f"{without:.0f}", f"{with_:.0f}", f"{(with_ - without) / 10:.1f} %"))
    head = ("", "not recorded", "recorded", "of a core")
    print_table("processor time, ms a second, median of turns", head, paced)


def _flow(path: Path, compression: str | None, count: int) -> tuple[float, str]:
    """Return messages a second of processor time, and whether the file has each of them."""
    with ExitStack() as stack:
        robot, emit = stack.enter_context(_robot())
        received = [0]

        def take(_: Message) -> None:
            received[0] += 1

        robot.request("counter", on_message=take)
        recording = None
        if compression is not None:
            recording = stack.enter_context(
                robot.record("counter", path=path, queue=_BLOCK, compression=compression)
            )
        begun = time.process_time()
        for n in range(count):
            emit({"n": n})
        if recording is not None:
            recording.close()
        seconds = time.process_time() - begun
    assert received[0] == count
    verdict = "" if recording is None else _verdict(path, count)
    path.unlink(missing_ok=True)
    return count / seconds, verdict


def _flat(folder: Path, count: int) -> None:
    """Print what a long recording does to the memory."""
    with ExitStack() as stack:
        robot, emit = stack.enter_context(_robot())
        path = folder / "long.mcap"
        recording = stack.enter_context(robot.record("counter", path=path, queue=_BLOCK))
        seen = []
        for n in range(count):
            emit({"n": n})
            if n % (count // 10) == count // 10 - 1:
                seen.append(resident_megabytes())
        recording.close()
    verdict = _verdict(path, count)
    rows = [(f"{(n + 1) * count // 10:,}", f"{memory:.1f}") for n, memory in enumerate(seen)]
    print_table(f"memory, MB; the file has {verdict}", ("messages", "resident"), rows)


def _paced(path: Path | None, rate: float, size: int) -> float:
    """Return the processor time of a flow, in ms a second."""
    with ExitStack() as stack:
        robot, emit = stack.enter_context(_robot(_PICTURE if size else _COUNT))
        robot.request("counter", on_message=lambda _: None)
        if path is not None:
            stack.enter_context(robot.record("counter", path=path))
        data = os.urandom(size)
        begun, used = time.perf_counter(), time.process_time()
        for n in range(int(_SECONDS * rate)):
            emit({"n": n, "data": data} if size else {"n": n})
            ahead = begun + n / rate - time.perf_counter()
            if ahead > 0:
                time.sleep(ahead)
        used = time.process_time() - used
    return used / _SECONDS * 1000


def _verdict(path: Path, count: int) -> str:
    """Return whether each message is there, in order and octet for octet."""
    place = 0
    for message in McapReader(path).messages("/counter", 0, sys.exit):
        if bytes(message.data) != b'{"n":%d}' % place:
            return f"something else from message {place:,} on"
        place += 1
    return _ALL if place == count else f"{place:,} of {count:,}"


def _emit_for_ever(path: Path) -> None:
    with _robot() as (robot, emit):
        queue = QueuePolicy(length=100, policy="block", timeout=600)
        robot.record("counter", path=path, queue=queue)
        for n in itertools.count(1):
            emit({"n": n - 1})
            if n % 100 == 0:
                print(n, flush=True)


def _kills(folder: Path, count: int) -> None:
    lost = []
    for turn in range(count):
        path = folder / f"kill{turn}.mcap"
        with running(module("bench.record", "--emit", str(path)), signal.SIGKILL) as child:
            end = time.monotonic() + random.uniform(0, 1.5)
            sent = int(child.said())
            while time.monotonic() < end:
                sent = int(child.said())
            child.process.kill()
            assert child.process.stdout is not None
            rest = child.process.stdout.read().split()
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
