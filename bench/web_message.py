"""What a message of 1 KB to one client of the web costs the server: one after the other.

    python -m bench.web_message                  processor time of the server, as a table
    python -m bench.web_message /rosbridge 1300  so many messages to a client of that path, no table

On a busy machine instructions say more than time: those of a message are the difference of two runs
of the latter under `valgrind --tool=callgrind --trace-children=yes`, by that of their messages.
"""

from __future__ import annotations

import json
import select
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

from websockets.sync.client import connect
from websockets.typing import Subprotocol

from bench.tables import print_table
from bench.turns import module, running
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import Emitter, MemoryBridge

ROBOT = """
version: 1
bridges: {memory: {plugin: memory}}
functions:
  number: {components: [{name: number, bridge: memory, output: {endpoint: [number]}}]}
"""
RECORD = {"type": "object", "properties": {"data": {"type": "string"}}, "required": ["data"]}
MESSAGE = {"data": "x" * 1000}
ASKS = {
    "/": {"op": "Request", "type": "number", "id": "1", "jsonMessage": {}},
    "/rosbridge": {"op": "subscribe", "id": "1", "topic": "/uoarm/number"},
}
COUNT = 2000
ROUNDS = 5
SETTLE_SECONDS = 1.0
LARGE = 1_000_000
_ARRIVED = b"."


def main() -> None:
    """Print the table, or send what was asked for."""
    if sys.argv[1:2] == ["--client"]:
        _read(*sys.argv[2:])
        return
    bridge = MemoryBridge("memory")
    emitter = bridge.emitter("number", RECORD)
    with (
        RobotManager(loads(ROBOT), bridges={"memory": bridge}) as robot,
        serve_in_thread(robot, ServerOptions(port=0)) as server,
    ):
        url = f"ws://127.0.0.1:{server.ports[0]}"
        if len(sys.argv) > 1:
            path, count = sys.argv[1:]
            with _client(url, path, emitter) as arrivals:
                _send(emitter, arrivals, int(count))
            return
        rows = []
        for path in ASKS:
            with _client(url, path, emitter) as arrivals:
                costs = sorted(_send(emitter, arrivals, COUNT) for _ in range(ROUNDS))
            rows.append((path, *(f"{cost * 1e6:.0f}" for cost in (costs[0], costs[ROUNDS // 2]))))
    print_table("a message of 1 KB to one client", ("client of", "least us", "median"), rows)


def _send(emitter: Emitter, arrivals: IO[bytes], count: int) -> float:
    """Send messages, each when the one before has arrived; return the seconds that each took."""
    began = time.process_time()
    for _ in range(count):
        emitter.emit(MESSAGE)
        assert arrivals.read(1) == _ARRIVED, "the client has gone"
    return (time.process_time() - began) / count


@contextmanager
def _client(url: str, path: str, emitter: Emitter) -> Iterator[IO[bytes]]:
    """Run a client in a process of its own that says when a message has arrived."""
    words = module("bench.web_message", "--client", url, path)
    with running(words, signal.SIGKILL, bufsize=0, text=False) as client:
        arrivals: Any = client.process.stdout
        assert arrivals.read(1) == b"o", "the client is not served"
        while not select.select([arrivals], (), (), 1.0)[0]:  # until its stream is open
            emitter.emit(MESSAGE)
        time.sleep(SETTLE_SECONDS)
        arrivals.read(LARGE)
        yield arrivals


def _read(url: str, path: str) -> None:
    names = None if path != "/" else [Subprotocol("uoarm.v1.json")]
    with connect(f"{url}{path}", subprotocols=names) as client:
        client.send(json.dumps(ASKS[path]))
        sys.stdout.buffer.write(b"o")
        sys.stdout.buffer.flush()
        for frame in client:
            if MESSAGE["data"] in str(frame):
                sys.stdout.buffer.write(_ARRIVED)
                sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
