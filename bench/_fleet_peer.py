"""The other manager of the bench of links, in a process of its own, beside a bare WebSocket."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TypedDict

from websockets.asyncio.server import ServerConnection, serve

from uoarm import RobotManager
from uoarm._support.process_tuning import keep_memory, short_switch_interval
from uoarm.config import loads
from uoarm.local import Octets
from uoarm.server import ServerOptions, serve_in_thread

ROBOT = """
version: 1
bridges: {python: {}}
export: {local: ["*"]}
functions:
  echo: {components: [{name: echo, bridge: python, service: {endpoint: ["_fleet_peer:echo"]}}]}
  small: {components: [{name: small, bridge: python, output: {endpoint: ["_fleet_peer:small"]}}]}
  large: {components: [{name: large, bridge: python, output: {endpoint: ["_fleet_peer:large"]}}]}
"""
SMALL, LARGE = 1_000, 921_600


class Packet(TypedDict):
    """What is carried."""

    data: Octets


def echo(message: Packet) -> Packet:
    """Give back what came."""
    return message


def small() -> Iterator[Packet]:
    """Emit messages of 1 KB, as the reader lets it."""
    return _paced(SMALL)


def large() -> Iterator[Packet]:
    """Emit pictures, as the reader lets it."""
    return _paced(LARGE)


def _paced(octets: int) -> Iterator[Packet]:
    """Emit as many messages as the reader asks for, an octet each, in a pipe."""
    with Path(os.environ["FLEET_CREDIT"]).open("rb", buffering=0) as credit:
        while asked := credit.read(1024):
            for _ in asked:
                yield {"data": bytes(octets)}


async def _answer(socket: ServerConnection) -> None:
    """Give back what comes; of a text, send as many messages as it says, each so long."""
    async for message in socket:
        if isinstance(message, bytes):
            await socket.send(message)
        else:
            count, octets = map(int, message.split())
            for _ in range(count):
                await socket.send(bytes(octets))


async def _run() -> None:
    async with serve(_answer, "127.0.0.1", 0, max_size=None, compression=None) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        print(port, flush=True)
        await asyncio.to_thread(sys.stdin.read)


def main() -> None:
    """Print the ports of a robot's server and of a bare one, and serve until the input ends."""
    keep_memory()  # and a short switch interval, as `uoarm serve` has it
    robot = RobotManager(loads(ROBOT, origin=str(Path(__file__).parent / "robot.yaml")))
    with short_switch_interval(), robot, serve_in_thread(robot, ServerOptions(port=0)) as server:
        print(server.ports[0], flush=True)
        asyncio.run(_run())


if __name__ == "__main__":
    main()
