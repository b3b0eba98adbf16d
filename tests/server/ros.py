"""A bare rosbridge client for tests."""

from __future__ import annotations

import json
from contextlib import ExitStack
from typing import Any

from tests.server.talk import SECONDS
from typing_extensions import Self
from websockets.sync.client import ClientConnection, connect

from uoarm._wire import read_binary
from uoarm.model import Budget, Spending
from uoarm.server import Server

__all__ = ["Ros", "url"]


def url(server: Server, path: str = "/rosbridge") -> str:
    return f"ws://127.0.0.1:{server.ports[0]}{path}"


class Ros:
    """A bare rosbridge client: sends what it is told, returns what comes."""

    def __init__(self, url: str, **options: Any) -> None:
        self._open = ExitStack()
        self.socket: ClientConnection = self._open.enter_context(
            connect(url, max_size=None, **options)
        )

    def send(self, **fields: object) -> None:
        self.socket.send(json.dumps(fields))

    def receive(self) -> dict[str, Any]:
        frame = self.socket.recv(timeout=SECONDS)
        if isinstance(frame, bytes):
            told = read_binary(frame, Spending(Budget()))
        else:
            told = json.loads(frame)
        assert isinstance(told, dict)
        return told

    def call(self, service: str, args: object = None) -> Any:
        self.send(op="call_service", id="c", service=service, args=args)
        response = self.receive()
        assert (response["op"], response["id"], response["result"]) == (
            "service_response", "c", True,
        ), response  # fmt: skip
        return response["values"]

    def refused(self, **fields: object) -> str:
        self.send(**fields)
        status = self.receive()
        assert (status["op"], status["level"]) == ("status", "error")
        assert status.get("id") == fields.get("id")
        message: str = status["msg"]
        return message

    def messages(self, count: int) -> list[Any]:
        told = [self.receive() for _ in range(count)]
        assert {one["op"] for one in told} == {"publish"}
        return [one["msg"] for one in told]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self._open.close()
