"""The floor as a process: vehicles command their bodies, and sense, over UDP on loopback.

`python -m warehouse_floor PORT` until interrupted. A datagram is one object of JSON and its answer
another. A vehicle that says nothing more stands soon: its base has a timeout of its own.
"""

from __future__ import annotations

import json
import select
import signal
import socket
import sys
import time
from typing import Any, Final

from attrs import asdict

from warehouse_floor.bodies import Floor

_STEP: Final = 0.02
_OCTETS: Final = 65_507


class Server:
    """Answers datagrams, and lets the time go on between them.

    Args:
        port: on loopback.

    Raises:
        OSError: the port is in use.
    """

    def __init__(self, port: int) -> None:
        self.floor = Floor()
        self.is_running = True
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._then = time.monotonic()

    def run(self) -> None:
        """Go on until `is_running` is not true any more."""
        while self.is_running:
            select.select([self._socket], [], [], _STEP)
            self._pass()
            while self._answer():
                pass

    def _pass(self) -> None:
        """Let the time pass that has; where the machine was late, in several steps."""
        while (now := time.monotonic()) - self._then >= _STEP:
            self._then = max(self._then + _STEP, now - 1)
            self.floor.step(self._then, _STEP)

    def _answer(self) -> bool:
        try:
            octets, sender = self._socket.recvfrom(_OCTETS)
        except BlockingIOError:
            return False
        number = None
        try:
            asked = json.loads(octets)
            number = asked.get("number")
            reply = self._reply(asked)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            reply = {"error": f"{type(error).__name__}: {error}"}
        reply["number"] = number
        self._socket.sendto(json.dumps(reply).encode(), sender)
        return True

    def _reply(self, asked: dict[str, Any]) -> dict[str, Any]:
        floor = self.floor
        if "vehicle" in asked:
            name = asked["vehicle"]
            floor.add(name, asked["home"], is_holonomic=asked["is_holonomic"])
            forward, left, turn = asked["velocity"]
            now = time.monotonic()
            floor.command(name, (forward, left, turn), asked["until"], now)
            floor.carry(name, asked["carry"])
            return asdict(floor.sense(name))
        if "block" in asked:
            return {"is_blocked": floor.block(asked["block"], asked["clear"])}
        if "unblock" in asked:
            floor.obstacles.discard(asked["unblock"])
        if "localised" in asked:
            floor.bodies[asked["localised"]].is_localised = asked["is"]
        return {
            "bodies": {name: asdict(floor.sense(name)) for name in floor.bodies},
            "boxes": floor.boxes,
            "deliveries": floor.deliveries,
            "obstacles": sorted(floor.obstacles),
            "collisions": floor.collisions,
            "contacts": floor.contacts,
            "unauthorised": floor.unauthorised,
            "repeats": floor.repeats,
            "metres": floor.metres,
        }


def main() -> None:
    """Serve the port named on the command line."""
    server = Server(int(sys.argv[1]))

    def stop(*_: object) -> None:
        server.is_running = False

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    print("ready", flush=True)
    server.run()


if __name__ == "__main__":
    main()
