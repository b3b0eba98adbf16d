"""Mosquitto, and peers that know nothing of uoarm."""

from __future__ import annotations

import getpass
import random
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from uoarm_mqtt._client import ThreadedClient

from uoarm.testing import patience, wait

PROGRAM = shutil.which("mosquitto") or "/usr/sbin/mosquitto"  # Debian: not on every user's PATH


class Broker:
    """Mosquitto in a process of its own, on a loopback address that no other test chooses.

    An address and not only a port: it can be killed and comes back at the same place, which no
    outgoing connection of another program has taken meanwhile.
    """

    def __init__(self, folder: Path, lines: str = "allow_anonymous true") -> None:
        folder.mkdir(exist_ok=True)
        self.folder = folder
        self.host = "127." + ".".join(str(random.randint(1, 254)) for _ in range(3))
        self.port = 1883
        self.lines = lines
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"mqtt://{self.host}:{self.port}"

    def start(self) -> None:
        file = self.folder / "mosquitto.conf"
        # As root it would become another user, who may not read the test's folders.
        lines = (f"user {getpass.getuser()}", f"listener {self.port} {self.host}", self.lines)
        file.write_text("\n".join(lines), encoding="utf-8")
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen([PROGRAM, "-c", str(file)], stdout=log, stderr=log)
        wait(self._answers, "Mosquitto does not answer")

    def kill(self) -> None:
        """End it without a word, as a loss of power does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def stop(self) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.wait()

    def send_signal(self, number: int) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def _answers(self) -> bool:
        assert self._process is not None
        said = (self.folder / "log").read_text(encoding="utf-8", errors="replace")
        assert self._process.poll() is None, said
        try:
            socket.create_connection((self.host, self.port), 1).close()
        except OSError:
            return False
        return True


@contextmanager
def running(folder: Path, lines: str = "allow_anonymous true") -> Iterator[Broker]:
    """A broker while a block runs."""
    broker = Broker(folder, lines)
    broker.start()
    try:
        yield broker
    finally:
        broker.stop()


class Peer:
    """Another client: paho, as an application uses it."""

    def __init__(self, broker: Broker, will: tuple[str, str] | None = None, **more: Any) -> None:
        self._client = ThreadedClient(
            CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5
        )
        self._client.on_message = self._on_message
        self._handlers: dict[str, Callable[[Any], object]] = {}
        self._suback = threading.Event()
        self._client.on_subscribe = lambda *_: self._suback.set()
        if will is not None:
            self._client.will_set(*will, qos=1, retain=True)
        if more.get("context") is not None:
            self._client.tls_set_context(more["context"])
        if "user" in more:
            self._client.username_pw_set(more["user"], more["password"])
        self._client.connect(broker.host, broker.port)
        self._client.loop_start()

    def publish(
        self, topic: str, payload: bytes | str, *, retain: bool = False, **more: Any
    ) -> None:
        self._publish(topic, payload, retain, more).wait_for_publish(patience())

    def publish_soon(self, topic: str, payload: bytes | str, **more: Any) -> None:
        """Publish from a handler, which must wait for nothing."""
        self._publish(topic, payload, retain=False, more=more)

    def _publish(self, topic: str, payload: bytes | str, retain: bool, more: dict[str, Any]) -> Any:
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        qos = more.pop("qos", 1)
        for name, value in more.items():
            setattr(properties, name, value)
        return self._client.publish(topic, payload, qos, retain, properties)

    def subscribe(self, topic: str, handler: Callable[[Any], object]) -> None:
        self._handlers[topic] = handler
        self._suback.clear()
        self._client.subscribe(topic, 1)
        assert self._suback.wait(patience())

    def collect(self, topic: str) -> list[Any]:
        """Subscribe and return the list of what comes."""
        came: list[Any] = []
        self.subscribe(topic, came.append)
        return came

    def serve(self, topic: str, answer: Callable[[bytes], bytes | Exception | None]) -> None:
        """Answer requests, as MQTT 5 says; with None for silence."""

        def reply(request: Any) -> None:
            said = answer(request.payload)
            if said is None:
                return
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.CorrelationData = request.properties.CorrelationData
            if isinstance(said, Exception):
                properties.UserProperty = ("error", str(said))
                said = b""
            self._client.publish(request.properties.ResponseTopic, said, 1, properties=properties)

        self.subscribe(topic, reply)

    def die(self) -> None:
        """End without a word: the broker publishes the last will."""
        self._client.on_disconnect = lambda client, *_: client.disconnect()
        sock = self._client.socket()
        if isinstance(sock, socket.socket):
            sock.shutdown(socket.SHUT_RDWR)
        self._client.loop_stop()
        self._client._reset_sockets()

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()
        self._client._reset_sockets()

    def _on_message(self, client: object, user: object, message: Any) -> None:
        del client, user
        for topic, handler in list(self._handlers.items()):
            if message.topic == topic or topic.endswith("#"):
                handler(message)
