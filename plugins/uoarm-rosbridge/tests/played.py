"""A rosbridge server that answers as it is written, for the bridge that is its client."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from websockets.sync.server import ServerConnection, serve

from uoarm.bridge import Bridge, Registry
from uoarm.model import BridgeSpec, Endpoint, MessageStructure, Role
from uoarm.testing import patience

STRING = {
    "type": "std_msgs/String", "fieldnames": ["data"], "fieldtypes": ["string"],
    "fieldarraylen": [-1], "examples": [""], "constnames": [], "constvalues": [],
}  # fmt: skip


def typedef(kind: str, /, **fields: tuple[str, int]) -> dict[str, object]:
    """Describe a type as rosapi does: by field its type and its length, -1 where it is no array."""
    return {
        "type": kind, "fieldnames": list(fields),
        "fieldtypes": [own for own, _ in fields.values()],
        "fieldarraylen": [length for _, length in fields.values()],
    }  # fmt: skip


class Played:
    """A server that answers rosapi as it is written here, and keeps what came.

    Args:
        answers: by service of rosapi; one that is a function is called with the arguments.

    Attributes:
        came: all operations, in their order.
        sockets: on which something was done beside calls.
        on: says more to an operation; a test replaces it.
    """

    def __init__(self, answers: Mapping[str, object]) -> None:
        self.answers = dict(answers)
        self.came: list[Any] = []
        self.sockets: list[ServerConnection] = []
        self._all: list[ServerConnection] = []
        self._port = 0
        self.on: Callable[[ServerConnection, Any], object] = lambda *_: None
        self.start()

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self._port}"

    def start(self) -> None:
        """Be there, after a `stop` at the same place."""
        self._server = serve(self._talk, "127.0.0.1", self._port)
        self._port = self._server.socket.getsockname()[1]
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()

    def stop(self) -> None:
        """Be away: every connection ends, and nothing listens."""
        self._server.shutdown()
        self._thread.join(patience())
        pipe: Any = (self._server.shutdown_watcher, self._server.shutdown_notifier)
        if isinstance(pipe[0], int):  # websockets before 17 keeps it open
            for end in pipe:
                os.close(end)
        for socket in self._all:
            socket.close()

    def say(self, **fields: object) -> None:
        """Send an operation on the connection that did something beside calls last."""
        self.sockets[-1].send(json.dumps(fields))

    def _talk(self, socket: ServerConnection) -> None:
        self._all.append(socket)
        for text in socket:
            fields = json.loads(text)
            if fields["op"] != "call_service" and socket not in self.sockets:
                self.sockets.append(socket)
            self.came.append(fields)
            if fields["op"] == "call_service":
                name = fields["service"].rpartition("/")[2]
                is_known = name in self.answers
                values = self.answers.get(name, f"there is no service {name}")
                if callable(values):
                    values = values(fields["args"])
                answer = {
                    "op": "service_response", "id": fields["id"], "values": values,
                    "result": is_known,
                }  # fmt: skip
                socket.send(json.dumps(answer))
            self.on(socket, fields)

    def refuse(self, operation: str, why: str, data: object = None) -> None:
        """Refuse operations of this kind from now on; of publish only those with this data."""

        def on(socket: ServerConnection, fields: Any) -> None:
            if fields["op"] == operation and (data is None or fields["msg"]["data"] == data):
                status = {"op": "status", "level": "error", "msg": why, "id": fields["id"]}
                socket.send(json.dumps(status))

        self.on = on

    def close(self) -> None:
        self.stop()


ANSWERS: dict[str, object] = {
    "topic_type": {"type": "std_msgs/String"},
    "message_details": {"typedefs": [STRING]},
    "publishers": {"publishers": ["/talker"]},
    "subscribers": {"subscribers": ["/listener"]},
    "get_time": {"time": {"secs": 1, "nsecs": 2}},
}
TALK = Endpoint("far", "talker", Role.OUTPUT, ("/chatter",))
LISTEN = Endpoint("far", "listener", Role.INPUT, ("/chatter",))


@contextmanager
def bridge_to(address: str, **options: object) -> Iterator[Bridge]:
    given = {"url": address, "check": 0.1, "wait": min(patience(), 60), **options}
    bridge = Registry().create(BridgeSpec("far", "rosbridge", given))
    try:
        yield bridge
    finally:
        bridge.close()


def stream(bridge: Bridge, endpoint: Endpoint) -> MessageStructure:
    structure = bridge.describe(endpoint).message
    assert structure is not None
    return structure


def asked(played: Played, op: str) -> list[Any]:
    return [fields for fields in played.came if fields["op"] == op]
