"""A stand-in for the framework that the bridge reaches: a bus that speaks lines of JSON over TCP.

Delete it, and have the world of `test_conformance.py` start what your framework has instead.
"""

from __future__ import annotations

import itertools
import json
import queue
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from uoarm.testing import patience

__all__ = ["ExampleBus", "ExamplePeer"]

Fields = dict[str, Any]


class ExampleBus:
    """Topics and services for all that connect. `cut` has it away for a while.

    Args:
        topics: JSON Schema of the messages of each topic.
        services: JSON Schema of request and reply of each service.
        retained: topics whose last message stands.
    """

    def __init__(self, topics: Fields, services: Fields, retained: tuple[str, ...] = ()) -> None:
        self._topics, self._services, self._retained = topics, services, retained
        self._lock = threading.RLock()  # guards all that follows between the threads of clients
        self._is_cut = False
        self._clients: set[_BusClient] = set()
        self._last: dict[str, str] = {}
        self._calls: dict[int, tuple[_BusClient, int]] = {}
        self._numbers = itertools.count(1)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        self._thread = threading.Thread(target=self._accept, name="bus", daemon=True)
        self._thread.start()

    def cut(self) -> None:
        """End all connections, and serve no one until `mend`; the port stays its own."""
        with self._lock:
            self._is_cut = True
            clients = tuple(self._clients)
        for client in clients:
            client.close()

    def mend(self) -> None:
        """Serve again."""
        self._is_cut = False

    def close(self) -> None:
        """End with all that is connected."""
        self.cut()
        with suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self._thread.join()

    def _accept(self) -> None:
        while True:
            try:
                line, _ = self._listening.accept()
            except OSError:  # it was closed
                return
            with self._lock:
                if self._is_cut:
                    line.close()
                    continue
                self._clients.add(_BusClient(line, self._handle, self._end))

    def _end(self, client: _BusClient) -> None:
        """Forget a client; what it published has gone, and whom it owed a reply is refused."""
        with self._lock:
            self._clients.discard(client)
            for call in client.owed:
                self._reply(call, {"error": "what served it has gone"})
            for topic in client.publishes:
                self._send(topic, {"event": "gone", "cause": f"the publisher of {topic} has gone"})

    def _send(self, topic: str, event: Fields) -> None:
        for client in self._clients:
            for number, subscribed in client.subscribed.items():
                if subscribed == topic:
                    client.write({**event, "id": number})
            for number, (source, _) in client.links.items():
                if source == topic and event["event"] == "gone":
                    client.write({**event, "id": number})
        if event["event"] == "message":
            for client in tuple(self._clients):
                for source, sink in tuple(client.links.values()):
                    if source == topic:
                        self._publish(sink, event["payload"])

    def _publish(self, topic: str, payload: str) -> None:
        if topic in self._retained:
            self._last[topic] = payload
        self._send(topic, {"event": "message", "payload": payload})

    def _reply(self, call: int, fields: Fields) -> None:
        if call in self._calls:
            caller, asked = self._calls.pop(call)
            caller.write({"number": asked, **fields})

    def _handle(self, client: _BusClient, asked: Fields) -> None:
        """Do what a client asks; what is no question of its own has no reply."""
        with self._lock:
            try:
                result = self._do(client, asked)
            except LookupError as error:
                refused = {"error": f"there is no {error.args[0]!r}", "reason": "not_found"}
                client.write({"number": asked["number"], **refused})
                return
            if asked["do"] not in {"call", "publish", "reply"}:
                client.write({"number": asked["number"], "result": result})

    def _do(self, client: _BusClient, asked: Fields) -> Any:
        match asked:
            case {"do": "list"}:
                return {**{name: self._topic(name) for name in self._topics}, **self._services}
            case {"do": "describe", "name": name, "is_service": is_service}:
                return self._services[name] if is_service else self._topic(name)
            case {"do": "own", "topic": topic}:
                client.publishes.add(topic)
            case {"do": "subscribe", "topic": topic, "id": number}:
                self._topic(topic)
                client.subscribed[number] = topic
                if topic in self._last:
                    event = {"event": "message", "payload": self._last[topic]}
                    client.write({**event, "id": number})
            case {"do": "publish", "topic": topic, "payload": payload}:
                self._publish(topic, payload)
            case {"do": "link", "topic": topic, "to": to, "id": number}:
                client.links[number] = (topic, to)
            case {"do": "serve", "service": service, "id": number}:
                schemas = {"request": asked["request"], "reply": asked["reply"]}
                self._services.setdefault(service, schemas)
                client.serves[number] = service
            case {"do": "withdraw", "id": number}:
                for kept in (client.subscribed, client.links, client.serves):
                    kept.pop(number, None)
            case {"do": "call", "service": service, "payload": payload}:
                self._call(client, asked["number"], service, payload)
            case {"do": "reply", "call": call, "error": error}:
                self._reply(call, {"error": error, "reason": "raised"})
            case {"do": "reply", "call": call, "payload": payload}:
                self._reply(call, {"result": payload})
        return None  # also to a ping: all that came before has been handed on

    def _topic(self, name: str) -> Fields:
        return {"message": self._topics[name], "retained": name in self._retained}

    def _call(self, caller: _BusClient, asked: int, service: str, payload: str) -> None:
        for client in self._clients:
            for number, served in client.serves.items():
                if served == service:
                    call = next(self._numbers)
                    self._calls[call] = (caller, asked)
                    client.owed.add(call)
                    client.write({"event": "call", "call": call, "payload": payload, "id": number})
                    return
        raise LookupError(service)


class _BusClient:
    """One connection, with a thread that reads and one that writes."""

    def __init__(
        self,
        line: socket.socket,
        handle: Callable[[_BusClient, Fields], None],
        end: Callable[[_BusClient], None],
    ) -> None:
        self.subscribed: dict[int, str] = {}
        self.serves: dict[int, str] = {}
        self.links: dict[int, tuple[str, str]] = {}
        self.publishes: set[str] = set()
        self.owed: set[int] = set()
        self._line, self._handle, self._end = line, handle, end
        self._written: queue.Queue[bytes] = queue.Queue()
        self._written.put(b"\n")  # the greeting
        self._threads = [
            threading.Thread(target=work, name="bus client", daemon=True)
            for work in (self._read, self._write)
        ]
        for thread in self._threads:
            thread.start()

    def write(self, fields: Fields) -> None:
        self._written.put(json.dumps(fields).encode() + b"\n")

    def close(self) -> None:
        with suppress(OSError):
            self._line.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()

    def _read(self) -> None:
        try:
            with suppress(OSError), self._line.makefile("rb") as lines:
                for line in lines:
                    if line.endswith(b"\n"):  # else the connection broke within it
                        self._handle(self, json.loads(line))
        finally:
            self._written.put(b"")
            self._end(self)

    def _write(self) -> None:
        with suppress(OSError):
            while octets := self._written.get():
                self._line.sendall(octets)
        with suppress(OSError):
            self._line.shutdown(socket.SHUT_RDWR)
        self._line.close()


class ExamplePeer:
    """Another program on the bus, which knows nothing of uoarm; `close` is its death."""

    def __init__(self, bus: ExampleBus) -> None:
        self._line = socket.create_connection(("127.0.0.1", bus.port))
        self._lines = self._line.makefile("rb")
        self._lines.readline()
        self._answers: dict[int, Callable[[Any], Any]] = {}
        self._came: queue.Queue[Fields] = queue.Queue()
        self._numbers = itertools.count(1)
        self._thread = threading.Thread(target=self._read, name="peer", daemon=True)
        self._thread.start()

    def ask(self, do: str, **fields: Any) -> Any:
        self.post(do, **fields)
        return self._came.get(timeout=patience()).get("result")

    def post(self, do: str, **fields: Any) -> None:
        asked = {"do": do, "number": next(self._numbers), **fields}
        self._line.sendall(json.dumps(asked).encode() + b"\n")

    def serve(self, service: str, answer: Callable[[Any], Any]) -> None:
        """Answer requests: with a reply, an exception for a failure, or None for silence."""
        number = next(self._numbers)
        self._answers[number] = answer
        self.ask("serve", id=number, service=service, request=True, reply=True)

    def close(self) -> None:
        with suppress(OSError):
            self._line.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._lines.close()
        self._line.close()

    def _read(self) -> None:
        with suppress(OSError):
            for line in self._lines:
                if not line.endswith(b"\n"):  # the connection broke within it
                    return
                came = json.loads(line)
                if came.get("event") != "call":
                    self._came.put(came)
                    continue
                reply = self._answers[came["id"]](json.loads(came["payload"]))
                if isinstance(reply, Exception):
                    self.post("reply", call=came["call"], error=str(reply))
                elif reply is not None:
                    self.post("reply", call=came["call"], payload=json.dumps(reply))
