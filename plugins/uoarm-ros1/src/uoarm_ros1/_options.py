"""Addresses and options as the configuration writes them, and the names of ROS 1; no I/O."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from urllib.parse import urlsplit

from attrs import field, frozen

from uoarm.bridge import (
    BridgeOptions,
    PeerOptions,
    address_check,
    host_of,
    option,
    reading_endpoint,
)
from uoarm.errors import ConfigurationError
from uoarm.model import Budget, Endpoint, Options, Role

PARAMETER = "parameter"
_TEXT: Mapping[str, object] = {"type": "string", "minLength": 1}
_SECONDS: Mapping[str, object] = {"type": "number", "minimum": 0, "maximum": 60}
_COUNT: Mapping[str, object] = {"type": "integer", "minimum": 1}
_GRAPH_NAME = r"[/~]?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*"
_NAME = re.compile(_GRAPH_NAME)
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*")
_RESOURCE: Mapping[str, object] = {
    "type": "string",
    "pattern": f"^{_GRAPH_NAME}$",
    "examples": ["/camera"],
}

_PERIOD: Mapping[str, object] = {"type": "number", "minimum": 0.05, "maximum": 3600}


@frozen
class Ros1BridgeOptions(BridgeOptions):
    """The options of a bridge; what it takes from the environment is in its `NodeIdentity`."""

    master: str = option(
        "",
        {
            "type": "string",
            "pattern": r"^http://[^/@?#\s]+/?$",
            "examples": ["http://127.0.0.1:11311"],
        },
        "left out: `ROS_MASTER_URI`, else port 11311 here",
    )
    host: str = option(
        "",
        _TEXT,
        "under which nodes reach this one; left out: `ROS_HOSTNAME`, `ROS_IP`, else the "
        "address towards the master",
    )
    node: str = option(
        "",
        {"type": "string", "pattern": "^[A-Za-z][A-Za-z0-9_]*$", "examples": ["left"]},
        "two nodes of one name end each other; left out: one that no other has",
    )
    namespace: str = option(
        "",
        {"type": "string", "pattern": f"^(/|{_GRAPH_NAME})$", "examples": ["/left"]},
        "of the node and of relative names; left out: `ROS_NAMESPACE`, else `/`",
    )
    remap: Mapping[str, str] = option(
        {},
        {
            "type": "object",
            "propertyNames": _RESOURCE,
            "additionalProperties": _RESOURCE,
        },
        "names that stand for others",
    )
    definitions: tuple[str, ...] = option(
        (),
        {"type": "array", "items": {**_TEXT, "x-uoarm-path": True}, "maxItems": 64},
        "folders of `.msg`, `.srv` and `.action` files",
    )
    wait: float = option(1.0, _SECONDS, "seconds to wait for the other end", unit="s")
    check: float = option(1.0, _PERIOD, "seconds between looks at the master", unit="s")
    silence: float = option(
        5.0,
        _PERIOD,
        "seconds without a message until a publisher is asked whether it lives",
        unit="s",
    )
    use_sim_time: bool = option(
        False,
        {"type": "boolean"},
        "`stale_after` counts the seconds of `/clock`, and our goals and headers have its time",
    )
    rosout: bool = option(
        True, {"type": "boolean"}, "what the bridge reports is said on `/rosout`, too"
    )
    max_octets: int = option(16_777_216, _COUNT, "of one message that comes")
    max_values: int = option(500_000, _COUNT, "in lists of one message")

    @property
    def budget(self) -> Budget:
        """What one message may cost."""
        return Budget(octets=self.max_octets, elements=self.max_values)

    def check_together(self) -> None:
        """Refuse a master at what is no address."""
        if self.master:
            host_of(self.master)


@frozen
class Ros1Address:
    """A topic, a service, an action or a parameter by name.

    Attributes:
        name: as written.
        type: `package/Name`; empty: what the master says. Of a parameter `parameter`.
    """

    name: str
    type: str = ""

    @property
    def is_parameter(self) -> bool:
        """Whether it is a parameter."""
        return self.type == PARAMETER

    @property
    def is_action(self) -> bool:
        """Whether its type is that of an action."""
        return self.type.endswith("Action")


@frozen
class Ros1Options(PeerOptions):
    """The options of one endpoint."""

    wait: float | None = option(
        None,
        {**_SECONDS, "maximum": 86400},
        "seconds to wait for the other end; left out: as the bridge",
        unit="s",
    )
    node: str = option(
        "",
        _RESOURCE,
        "of an output the one node that is read, of an input one that must subscribe; left "
        "out: all",
    )
    latch: int = option(
        0,
        {"type": ["boolean", "integer"], "minimum": 0, "maximum": 1000},
        "of an input: how many last messages a new subscriber gets, as of `/tf_static`; "
        "`true`: one",
    )
    queue: int = option(
        100,
        {"type": "integer", "minimum": 1, "maximum": 100_000},
        "of an input: messages that may wait for a subscriber, four `max_octets` in all; "
        "the oldest are dropped and counted",
    )
    nodelay: bool = option(
        True,
        {"type": "boolean"},
        "of an output: the publisher is asked not to delay small messages",
    )
    definition: str = option("", _TEXT, "the text of the type, where no peer says it")


@frozen
class Names:
    """Turns names as people write them into names of the graph.

    Attributes:
        node: the full name of the node, which `~` stands for.
        namespace: of names that do not begin with `/`.
        remap: full names by full names.
    """

    node: str
    namespace: str = "/"
    remap: Mapping[str, str] = field(factory=dict)

    def resolve(self, name: str) -> str:
        """Return the full name, remapped."""
        full = self._full(name)
        return self.remap.get(full, full)

    def _full(self, name: str) -> str:
        if name.startswith("/"):
            return name
        if name.startswith("~"):
            return f"{self.node}/{name[1:].lstrip('/')}"
        return f"{self.namespace.rstrip('/')}/{name}"


@frozen
class NodeIdentity:
    """What a node is called and where its master is, by the options and the environment.

    Attributes:
        master_host: of the master.
        master_port: of the master.
        names: the node's own name, and what others stand for.
        host: under which others reach it; empty: the address from which the master is reached.
    """

    master_host: str
    master_port: int
    names: Names
    host: str

    @property
    def master(self) -> str:
        """The master's address."""
        return f"http://{self.master_host}:{self.master_port}/"

    @classmethod
    def of(
        cls, name: str, options: Ros1BridgeOptions, environment: Mapping[str, str]
    ) -> NodeIdentity:
        """Return that of a bridge.

        Raises:
            ConfigurationError: the address of the master, or a name of the environment, is none.
        """
        uri = options.master or environment.get("ROS_MASTER_URI") or "http://localhost:11311"
        try:
            parts = urlsplit(uri)
            host, port = parts.hostname or "", parts.port or 11311
        except ValueError as error:
            raise ConfigurationError(f"bridge {name!r}: master {uri!r}: {error}") from None
        if parts.scheme != "http" or not host:
            text = f"bridge {name!r}: expected a master such as http://robot:11311, got {uri!r}"
            raise ConfigurationError(text)
        namespace = options.namespace or environment.get("ROS_NAMESPACE") or "/"
        namespace = "/" + namespace.strip("/")
        if namespace != "/" and not _NAME.fullmatch(namespace):
            text = f"bridge {name!r}: ROS_NAMESPACE {namespace!r} is no namespace"
            raise ConfigurationError(text)
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        # Two nodes of one name end each other: unless it is stated, no other node has it.
        node = options.node or f"uoarm_{plain}_{os.getpid()}_{os.urandom(4).hex()}"
        names = Names(f"{namespace.rstrip('/')}/{node}", namespace)
        remap = {
            names.resolve(alias): names.resolve(target) for alias, target in options.remap.items()
        }
        said = environment.get("ROS_HOSTNAME") or environment.get("ROS_IP") or ""
        return cls(host, port, Names(names.node, namespace, remap), options.host or said)


def address_of(endpoint: Endpoint) -> Ros1Address:
    """Read an endpoint's address.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    with reading_endpoint(endpoint):
        address = _address(endpoint.address)
        if address.is_parameter and endpoint.role is Role.SERVICE:
            raise ValueError("a parameter is an output that is read, or an input that is set")
        if address.is_parameter and endpoint.is_offered:
            raise ValueError("a parameter is the master's: nothing can be offered as one")
    return address


port_of = Ros1Options.of_endpoint


def topic_name(address: tuple[str, ...], options: Options) -> str:
    """Return the topic that an address names, or "" for an action, a service or a parameter."""
    read = _address(address)
    is_else = read.is_parameter or read.is_action or "at_once" in options
    return "" if is_else else f"/{read.name.lstrip('/')}"


def _address(parts: tuple[str, ...]) -> Ros1Address:
    if not 1 <= len(parts) <= 2:  # noqa: PLR2004 - the two parts of the sentence
        raise ValueError(f"expected [name] or [name, type], got {list(parts)}")
    address = Ros1Address(*parts)
    if not _NAME.fullmatch(address.name):
        raise ValueError(f"{address.name!r} is not a name of ROS 1 such as /camera/image_raw")
    if len(parts) > 1 and not address.is_parameter and not _TYPE.fullmatch(address.type):
        meant = re.sub("/(msg|srv)/", "/", re.sub("/action/(.*)", r"/\1Action", address.type))
        hint = f"; did you mean {meant!r}?" if _TYPE.fullmatch(meant) else ""
        text = f"{address.type!r} is not a type of ROS 1 such as sensor_msgs/Image"
        raise ValueError(f"{text}, nor `{PARAMETER}`{hint}")
    return address


mistake = address_check(_address)
