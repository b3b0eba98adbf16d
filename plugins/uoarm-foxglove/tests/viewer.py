"""A bare viewer for tests, which sends what it is given and keeps what comes."""

from __future__ import annotations

import json
import struct
from contextlib import ExitStack
from typing import Any, Protocol

from typing_extensions import Self
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from uoarm.server import Limits, Server
from uoarm.testing import patience

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")


class Serve(Protocol):
    """Starts a server before the robot."""

    def __call__(self, limits: Limits | None = None, **more: Any) -> Server: ...


class Viewer:
    """One connection; what comes is a mapping, binary messages under `op` 1 and 3, as their number.

    Args:
        server: on loopback.
        subprotocol: that it asks for.
        query: of the address, such as a token.
    """

    def __init__(self, server: Server, subprotocol: str = SUBPROTOCOLS[0], query: str = "") -> None:
        self._open = ExitStack()
        self.socket = self._open.enter_context(
            connect(
                f"ws://127.0.0.1:{server.ports[0]}/foxglove{query}",
                subprotocols=[Subprotocol(subprotocol)],
                max_size=None,
            )
        )
        self.info = self.receive()
        assert self.info["op"] == "serverInfo"
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.others: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def send(self, op: str, **fields: object) -> None:
        self.socket.send(json.dumps({"op": op, **fields}))

    def receive(self, timeout: float | None = None) -> dict[str, Any]:
        frame = self.socket.recv(timeout=patience() if timeout is None else timeout)
        if isinstance(frame, str):
            read: dict[str, Any] = json.loads(frame)
            return read
        if frame[0] == 1:
            subscription, stamp = struct.unpack_from("<IQ", frame, 1)
            return {"op": 1, "subscription": subscription, "stamp": stamp, "data": frame[13:]}
        service, call, length = struct.unpack_from("<III", frame, 1)
        encoding, data = frame[13 : 13 + length].decode(), frame[13 + length :]
        return {
            "op": frame[0],
            "service": service,
            "call": call,
            "encoding": encoding,
            "data": data,
        }

    def has(self, op: object) -> bool:
        """Whether a message of an operation is there, which is taken."""
        try:
            self.until(op, 0.0)
        except TimeoutError:
            return False
        return True

    def until(self, op: object, timeout: float | None = None) -> dict[str, Any]:
        """Return the next message of an operation; announcements before it are kept by name."""
        while True:
            message = self.receive(timeout)
            for channel in message.get("channels", ()):
                self.channels[channel["topic"]] = channel
            for service in message.get("services", ()):
                self.services[service["name"]] = service
            if message["op"] == op:
                return message
            self.others.append(message)

    def channel(self, topic: str) -> dict[str, Any]:
        """Wait until a channel is announced."""
        while topic not in self.channels:
            self.until("advertise")
        return self.channels[topic]

    def service(self, name: str) -> dict[str, Any]:
        """Wait until a service is announced."""
        while name not in self.services:
            self.until("advertiseServices")
        return self.services[name]

    def subscribe(self, topic: str, number: int = 1) -> None:
        self.send(
            "subscribe", subscriptions=[{"id": number, "channelId": self.channel(topic)["id"]}]
        )

    def publish(self, number: int, data: bytes) -> None:
        self.socket.send(struct.pack("<BI", 1, number) + data)

    def call(self, name: str, data: bytes, encoding: str = "", number: int = 1) -> None:
        service = self.service(name)
        stated = (encoding or service["request"]["encoding"]).encode()
        head = struct.pack("<BIII", 2, service["id"], number, len(stated))
        self.socket.send(head + stated + data)
