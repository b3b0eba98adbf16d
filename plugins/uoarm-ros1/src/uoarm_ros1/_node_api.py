"""What a node answers when the master or another node calls it: the Slave API, without I/O."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from attrs import define, field, frozen

from uoarm_ros1._xmlrpc import Fault

__all__ = ["NodeApi", "ParameterUpdate", "PublisherUpdate", "Shutdown"]

_DONE, _FAILED, _WRONG = 1, 0, -1
_MOST_PUBLISHERS = 1000


@frozen
class PublisherUpdate:
    """The master said who publishes a topic now: the addresses of their APIs."""

    topic: str
    publishers: tuple[str, ...]


@frozen
class ParameterUpdate:
    """The master said that a parameter, or one within it, has changed."""

    key: str
    value: Any


@frozen
class Shutdown:
    """The master, or an operator, asked the node to end."""

    reason: str


Event = PublisherUpdate | ParameterUpdate | Shutdown


@define
class NodeApi:
    """The answers of one node.

    Attributes:
        caller: the node's own name.
        master: where its master is.
        process: the number of its process.
        host: under which others reach it.
        port: on which it takes connections of TCPROS; 0: not yet.
        publications: types by topic.
        subscriptions: types by topic.
        connections: returns what `getBusInfo` lists.
    """

    caller: str
    master: str
    process: int
    host: str
    port: int = 0
    publications: dict[str, str] = field(factory=dict)
    subscriptions: dict[str, str] = field(factory=dict)
    connections: Callable[[], list[list[Any]]] = list

    def answer(self, method: str, arguments: list[Any]) -> tuple[Any, Event | None]:
        """Return what a call returns, and what it means for the node."""
        known: Mapping[str, Callable[..., tuple[list[Any], Event | None]]] = {
            "getBusStats": self._bus_stats,
            "getBusInfo": self._bus_info,
            "getMasterUri": self._master_uri,
            "getPid": self._pid,
            "getSubscriptions": self._subscriptions,
            "getPublications": self._publications,
            "requestTopic": self._request_topic,
            "publisherUpdate": self._publisher_update,
            "paramUpdate": self._param_update,
            "shutdown": self._shutdown,
        }
        if method not in known:
            return Fault(f"a node has no method {method[:80]!r}"), None
        if not arguments or not isinstance(arguments[0], str):
            return Fault(f"{method} is called with the name of the caller first"), None
        try:
            return known[method](*arguments[1:])
        except TypeError:
            return Fault(f"{method} does not take {len(arguments) - 1} arguments"), None

    def _bus_stats(self) -> tuple[list[Any], None]:
        return [_DONE, "", [[], [], []]], None

    def _bus_info(self) -> tuple[list[Any], None]:
        return [_DONE, "bus info", self.connections()], None

    def _master_uri(self) -> tuple[list[Any], None]:
        return [_DONE, "", self.master], None

    def _pid(self) -> tuple[list[Any], None]:
        return [_DONE, "", self.process], None

    def _subscriptions(self) -> tuple[list[Any], None]:
        return [_DONE, "", [[topic, kind] for topic, kind in self.subscriptions.items()]], None

    def _publications(self) -> tuple[list[Any], None]:
        return [_DONE, "", [[topic, kind] for topic, kind in self.publications.items()]], None

    def _request_topic(self, topic: object, protocols: object) -> tuple[list[Any], None]:
        if not isinstance(topic, str) or topic not in self.publications:
            return [_WRONG, f"{self.caller} does not publish {str(topic)[:200]}", []], None
        wanted = protocols if isinstance(protocols, list) else []
        if any(isinstance(protocol, list) and protocol[:1] == ["TCPROS"] for protocol in wanted):
            return [_DONE, "ready", ["TCPROS", self.host, self.port]], None
        return [_FAILED, "only TCPROS is spoken here", []], None

    def _publisher_update(
        self, topic: object, publishers: object
    ) -> tuple[list[Any], PublisherUpdate | None]:
        if (
            not isinstance(topic, str)
            or not isinstance(publishers, list)
            or len(publishers) > _MOST_PUBLISHERS
            or not all(isinstance(publisher, str) for publisher in publishers)
        ):
            return [_WRONG, "expected a topic and a list of addresses", 0], None
        return [_DONE, "", 0], PublisherUpdate(topic, tuple(publishers))

    def _param_update(self, key: object, value: Any) -> tuple[list[Any], ParameterUpdate | None]:
        if not isinstance(key, str):
            return [_WRONG, "expected the name of a parameter", 0], None
        return [_DONE, "", 0], ParameterUpdate(key, value)

    def _shutdown(self, reason: object = "") -> tuple[list[Any], Shutdown]:
        return [_DONE, "", 0], Shutdown(str(reason)[:500])
