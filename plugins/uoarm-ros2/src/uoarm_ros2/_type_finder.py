"""Where types come from: installed packages, folders of definitions, the nodes that talk them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Message
from uoarm_ros2._defined import DefinedTypes
from uoarm_ros2._described import described_type
from uoarm_ros2._frame_lookups import tf_message
from uoarm_ros2._middleware import Peer
from uoarm_ros2._settings import TF_MESSAGE
from uoarm_ros2._types import import_type

__all__ = ["DESCRIPTION_SERVICE", "TypeFinder"]

DESCRIPTION_SERVICE = "type_description_interfaces/srv/GetTypeDescription"
_MOST_KEPT = 4_096


class TypeFinder:
    """Finds the classes of message types; what nodes described is kept by its hash.

    Args:
        ask: asks the node of a full name for the description of a type; raises BridgeError.
        peers: returns the ends of a topic.
        defined: what the folders of the bridge define.
    """

    def __init__(
        self,
        ask: Callable[[str, Message], Message],
        peers: Callable[[str], Iterable[Peer]],
        defined: DefinedTypes,
    ) -> None:
        self._ask = ask
        self._peers = peers
        self._defined = defined
        self._lock = threading.Lock()
        self._described: dict[tuple[str, str], type] = {}

    def find(self, name: str, topic: str) -> type:
        """Return the class of a type that a topic carries; blocks while nodes are asked.

        Raises:
            BridgeError: its package is not installed, no folder defines it whole, and no node on
                the topic describes it.
        """
        try:
            return import_type(name)
        except BridgeError as error:
            if error.reason is not FailureReason.NOT_FOUND:
                raise
            missing = error
        defined = self._defined.find(name)
        if defined is not None:
            return defined
        if name == TF_MESSAGE:
            return tf_message()
        asked: list[str] = []
        for peer in self._peers(topic):
            if peer.type != name or not peer.definition:
                continue
            key = name, peer.definition
            with self._lock:
                known = self._described.get(key)
            if known is not None:
                return known
            try:
                self._require_room()
                made = self._from(peer)
            except BridgeError as error:
                asked.append(f"{peer.node} does not describe it ({error})")
                continue
            with self._lock:
                return self._described.setdefault(key, made)
        why = "; ".join(asked) or "no node on its topic describes it"
        text = f"{missing}; {why}; option definitions takes folders of .msg files"
        raise BridgeError(text, FailureReason.NOT_FOUND) from missing

    def _require_room(self) -> None:
        """Raise BridgeError where no more types are kept: what a class is made of stays for good.

        So none is forgotten in favour of another.
        """
        with self._lock:
            if len(self._described) >= _MOST_KEPT:
                text = f"{_MOST_KEPT} types are known from nodes already, which is the most"
                raise BridgeError(text, FailureReason.REFUSED)

    def _from(self, peer: Peer) -> type:
        request = {
            "type_name": peer.type,
            "type_hash": peer.definition,
            "include_type_sources": False,
        }
        reply = self._ask(peer.node, request)
        if not reply["successful"]:
            text = f"it says {reply['failure_reason']!r:.200}"
            raise BridgeError(text, FailureReason.REFUSED)
        return described_type(reply["type_description"], peer.type, peer.definition)
