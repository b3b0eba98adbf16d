"""A bare rosbridge client for tests, and what they wait for."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from typing_extensions import Self
from websockets.sync.client import ClientConnection, connect

from uoarm import RobotManager
from uoarm.model import Budget, BudgetUse
from uoarm.server import Server
from uoarm.server.front_end import read_binary
from uoarm.testing import patience

SECONDS = patience()


def url(server: Server, path: str = "/rosbridge") -> str:
    return f"ws://127.0.0.1:{server.ports[0]}{path}"


class Ros:
    """A bare rosbridge client: sends what it is given, returns what comes."""

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
            reports = read_binary(frame, BudgetUse(Budget()))
        else:
            reports = json.loads(frame)
        assert isinstance(reports, dict)
        return reports

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
        reports = [self.receive() for _ in range(count)]
        assert {report["op"] for report in reports} == {"publish"}, reports
        return [report["msg"] for report in reports]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self._open.close()


Serve = Callable[..., Server]
Enter = Callable[[], Ros]


def end(robot: RobotManager) -> None:
    """End the first connection, as the application may."""
    robot.connections()[0].kill()
