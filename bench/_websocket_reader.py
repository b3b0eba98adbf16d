"""Many rosbridge clients in one process that does little but read, so that servers are measured.

`python -m bench._websocket_reader URL TOPIC CLIENTS SECONDS` prints a line when it begins to count,
and then, as JSON, how old the messages of `bench._ros2_world` were, in ms, and its own processor
time. Frames are parsed by `websockets` without a loop, tasks or queues behind it.
"""

from __future__ import annotations

import json
import math
import selectors
import socket
import sys
import time
from collections.abc import Sequence

from websockets.client import ClientProtocol
from websockets.frames import DATA_OPCODES, Frame
from websockets.uri import parse_uri

from bench.tables import at

SETTLE_SECONDS = 1.0
_DATA = b'"data":'
_AHEAD = 64
_READ = 2**18


class Reader:
    """One client, subscribed to one topic."""

    def __init__(self, url: str, topic: str) -> None:
        uri = parse_uri(url)
        self.protocol = ClientProtocol(uri, max_size=None)
        self.socket = socket.create_connection((uri.host, uri.port))
        self.protocol.send_request(self.protocol.connect())
        self._write()
        while self.protocol.handshake_exc is None and not self.read():
            pass
        asked = {"op": "subscribe", "topic": topic, "type": "std_msgs/String"}
        self.protocol.send_text(json.dumps(asked).encode())
        self._write()

    def read(self) -> Sequence[object]:
        """Wait for what comes, and return it."""
        self.protocol.receive_data(self.socket.recv(_READ))
        self._write()
        return self.protocol.events_received()

    def _write(self) -> None:
        for octets in self.protocol.data_to_send():
            self.socket.sendall(octets)


def sent_at(frame: Frame) -> int | None:
    """Return when a text left, in nanoseconds; None where it is no text."""
    octets = bytes(frame.data)
    start = octets.find(_DATA)
    if frame.opcode not in DATA_OPCODES or start < 0:
        return None
    return int(octets[start + len(_DATA) : start + _AHEAD].split(b" ")[-2])


def main() -> int:
    """Measure and print."""
    url, topic, clients, seconds = sys.argv[1:]
    selector = selectors.DefaultSelector()
    for _ in range(int(clients)):
        reader = Reader(url, topic)
        selector.register(reader.socket, selectors.EVENT_READ, reader)
    ages: list[float] = []
    begin, busy = math.inf, None  # the first may come late: a publisher has to be found
    while (now := time.monotonic()) < begin + float(seconds):
        if busy is None and now >= begin:
            busy = time.process_time()
            print("begins", flush=True)
        for key, _ in selector.select(0.1):
            for event in key.data.read():
                sent = sent_at(event) if isinstance(event, Frame) else None
                if sent is not None and begin == math.inf:
                    begin = now + SETTLE_SECONDS
                if sent is not None and busy is not None:
                    ages.append((time.monotonic_ns() - sent) / 1_000_000)
    spread = sorted(ages)
    reports = {
        "median": at(spread, 0.5),
        "p99": at(spread, 0.99),
        "count": len(spread),
        "busy": time.process_time() - (busy or 0.0),
    }
    print(json.dumps(reports))
    return 0


if __name__ == "__main__":
    sys.exit(main())
