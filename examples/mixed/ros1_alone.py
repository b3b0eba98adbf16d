"""A master and a camera of ROS 1 in plain Python, for machines without Debian's rospy.

python ros1_alone.py master PORT      as much of a master as a topic needs
python ros1_alone.py camera URI       a node that publishes /camera/image, as ros1_camera.py does
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Mapping
from typing import Any
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

HERE, TOPIC, KIND = "127.0.0.1", "/camera/image", "sensor_msgs/Image"
WIDTH, HEIGHT, DARK = 64, 48, 20
MD5 = "060021388200f6f0f447d0fcd9c64743"
DEFINITION = f"""Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{"=" * 80}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""


class Handler(SimpleXMLRPCRequestHandler):
    """XML-RPC as ROS 1 speaks it, on any path."""

    rpc_paths = ()


class Server(SimpleXMLRPCServer):
    """Answers calls of methods whose names are those of ROS."""

    def __init__(self, port: int) -> None:
        super().__init__((HERE, port), Handler, logRequests=False, allow_none=True)

    def _dispatch(self, method: str, params: Any) -> Any:
        return getattr(self, method, lambda *_: [1, "", 0])(*params)

    @property
    def uri(self) -> str:
        """Where it is."""
        return f"http://{HERE}:{self.server_address[1]}/"


class Master(Server):
    """Knows who publishes and subscribes, and says so to subscribers."""

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self._kinds: dict[str, str] = {}
        self._ends: tuple[dict[str, dict[str, str]], ...] = ({}, {})

    def registerPublisher(self, node: str, topic: str, kind: str, uri: str) -> Any:  # noqa: N802
        """Take a publisher, and have the subscribers know."""
        self._kinds[topic] = kind
        self._ends[0].setdefault(topic, {})[node] = uri
        self._update_publishers(topic)
        return [1, "", list(self._ends[1].get(topic, {}).values())]

    def registerSubscriber(self, node: str, topic: str, kind: str, uri: str) -> Any:  # noqa: N802
        """Take a subscriber, and say who publishes."""
        if kind != "*":
            self._kinds.setdefault(topic, kind)
        self._ends[1].setdefault(topic, {})[node] = uri
        return [1, "", list(self._ends[0].get(topic, {}).values())]

    def unregisterPublisher(self, node: str, topic: str, uri: str) -> Any:  # noqa: N802
        """Forget a publisher."""
        del uri
        self._ends[0].get(topic, {}).pop(node, None)
        self._update_publishers(topic)
        return [1, "", 1]

    def unregisterSubscriber(self, node: str, topic: str, uri: str) -> Any:  # noqa: N802
        """Forget a subscriber."""
        del uri
        self._ends[1].get(topic, {}).pop(node, None)
        return [1, "", 1]

    def getSystemState(self, _: str) -> Any:  # noqa: N802
        """Return publishers, subscribers and services."""
        ends = [
            [[topic, list(nodes)] for topic, nodes in end.items() if nodes] for end in self._ends
        ]
        return [1, "", [*ends, []]]

    def getTopicTypes(self, _: str) -> Any:  # noqa: N802
        """Return the type of each topic."""
        return [1, "", [[*pair] for pair in self._kinds.items()]]

    def lookupNode(self, _: str, name: str) -> Any:  # noqa: N802
        """Return where a node is."""
        for topics in self._ends:
            for nodes in topics.values():
                if name in nodes:
                    return [1, "", nodes[name]]
        return [-1, f"there is no node {name}", ""]

    def hasParam(self, _: str, __: str) -> Any:  # noqa: N802
        """Return that there is none."""
        return [1, "", False]

    def getParam(self, _: str, name: str) -> Any:  # noqa: N802
        """Return that it is not set."""
        return [-1, f"parameter {name} is not set", 0]

    def getUri(self, _: str) -> Any:  # noqa: N802
        """Return where it is."""
        return [1, "", self.uri]

    def getPid(self, _: str) -> Any:  # noqa: N802
        """Return its process."""
        return [1, "", os.getpid()]

    def _update_publishers(self, topic: str) -> None:
        uris = list(self._ends[0].get(topic, {}).values())
        for uri in self._ends[1].get(topic, {}).values():
            threading.Thread(target=update, args=(uri, topic, uris), daemon=True).start()


def update(uri: str, topic: str, uris: list[str]) -> None:
    """Notify a subscriber of its publishers; it may be gone."""
    try:
        ServerProxy(uri).publisherUpdate("/master", topic, uris)
    except OSError:
        return


class Camera(Server):
    """The slave API of a node with one topic, and its connections."""

    def __init__(self) -> None:
        super().__init__(0)
        self._listener = socket.create_server((HERE, 0))
        self._readers: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()
        threading.Thread(target=self._publish, daemon=True).start()

    def requestTopic(self, _: str, __: str, ___: Any) -> Any:  # noqa: N802
        """Return where messages are to be had."""
        return [1, "", ["TCPROS", HERE, self._listener.getsockname()[1]]]

    def getPid(self, _: str) -> Any:  # noqa: N802
        """Return its process."""
        return [1, "", os.getpid()]

    def getBusInfo(self, _: str) -> Any:  # noqa: N802
        """Return the connections."""
        count = range(len(self._readers))
        return [1, "", [[number, "/subscriber", "o", "TCPROS", TOPIC, True] for number in count]]

    def _accept(self) -> None:
        fields = {
            "callerid": "/camera", "topic": TOPIC, "type": KIND, "md5sum": MD5, "latching": "0",
            "message_definition": DEFINITION,
        }  # fmt: skip
        while True:
            reader, _ = self._listener.accept()
            (size,) = struct.unpack("<I", reader.recv(4, socket.MSG_WAITALL))
            reader.recv(size, socket.MSG_WAITALL)
            reader.sendall(header(fields))
            self._readers.append(reader)

    def _publish(self) -> None:
        number = 0
        while True:
            number += 1
            octets = picture(number)
            for reader in list(self._readers):
                try:
                    reader.sendall(octets)
                except OSError:
                    self._readers.remove(reader)
            time.sleep(0.05)


def header(fields: Mapping[str, str]) -> bytes:
    """Return a connection header of TCPROS."""
    lines = [f"{name}={value}".encode() for name, value in fields.items()]
    return text(b"".join(map(text, lines)))


def text(octets: bytes) -> bytes:
    """Return octets behind their number."""
    return struct.pack("<I", len(octets)) + octets


def picture(number: int) -> bytes:
    """Return an Image as ROS 1 serialises it."""
    now = time.time_ns()
    body = struct.pack("<III", number, *divmod(now, 10**9)) + text(b"camera")
    body += struct.pack("<II", HEIGHT, WIDTH) + text(b"mono8") + struct.pack("<BI", 0, WIDTH)
    return text(body + text(bytes([DARK]) * (WIDTH * HEIGHT)))


def main() -> None:
    """Run a part until it is ended."""
    what, where = sys.argv[1:]
    if what == "master":
        Master(int(where)).serve_forever()
    camera = Camera()
    ServerProxy(where).registerPublisher("/camera", TOPIC, KIND, camera.uri)
    camera.serve_forever()


if __name__ == "__main__":
    main()
