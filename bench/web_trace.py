"""How far a message goes until a client of the web has it: calls, modules and their changes.

The median of some messages: what the server does beside, such as its pings, is among the calls.

    python -m bench.web_trace            the table
    python -m bench.web_trace --path     and each module on the way, in order
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from bench.control_trace import Trace
from bench.tables import print_table
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import MemoryBridge

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
MESSAGES = 15


def main() -> None:
    """Print the table of ways."""
    trace = Trace()
    bridge = MemoryBridge("memory")
    emitter = bridge.emitter("number", RECORD)
    robot = RobotManager(loads(ROBOT), bridges={"memory": bridge})
    rows = []
    with robot, serve_in_thread(robot, ServerOptions(port=0)) as server:
        for path, ask in ASKS.items():
            names = None if path != "/" else [Subprotocol("uoarm.v1.json")]
            with connect(f"ws://127.0.0.1:{server.ports[0]}{path}", subprotocols=names) as client:
                client.send(json.dumps(ask))

                def pass_one(client: ClientConnection = client, timeout: float = 10) -> None:
                    emitter.emit(MESSAGE)
                    while MESSAGE["data"] not in str(client.recv(timeout)):
                        continue

                for _ in range(MESSAGES):  # the first may come before the stream is open
                    with suppress(TimeoutError):
                        pass_one(timeout=0.2)
                ways = []
                for _ in range(MESSAGES):
                    calls, modules, _, threads = trace.run(pass_one, quiet=0)
                    ways.append((len(trace.path("uoarm")), calls, modules, threads))
                    if "--path" in sys.argv:
                        print(*trace.path("uoarm"), "", sep="\n")
                rows.append((path, *map(str, sorted(ways)[MESSAGES // 2])))
    trace.close()
    columns = ("client of", "changes of module", "calls", "modules", "threads")
    print_table("a message of 1 KB to one client", columns, rows)


if __name__ == "__main__":
    main()
