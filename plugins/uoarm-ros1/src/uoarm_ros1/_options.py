"""Addresses and options as the configuration writes them, and the names of ROS 1; no I/O."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from attrs import evolve, field, frozen

from uoarm.bridge import EndpointOptions, option, reading_endpoint
from uoarm.errors import ConfigurationError
from uoarm.model import Budget, Endpoint, Options, Role, Schema

__all__ = [
    "BRIDGE_OPTIONS",
    "Names",
    "Ros1Address",
    "Ros1BridgeOptions",
    "Ros1Options",
    "address_of",
    "mistake",
    "port_of",
    "read_ros1_options",
    "topic_name",
]

PARAMETER = "parameter"
_TEXT: Mapping[str, object] = {"type": "string", "minLength": 1}
_SECONDS: Mapping[str, object] = {"type": "number", "minimum": 0, "maximum": 60}
_COUNT: Mapping[str, object] = {"type": "integer", "minimum": 1}
_GRAPH_NAME = r"[/~]?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*"
_NAME = re.compile(_GRAPH_NAME)
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*")

BRIDGE_OPTIONS: Schema = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "master": {
            "type": "string",
            "pattern": r"^http://[^/@?#\s]+/?$",
            "description": "of the ROS master; default: ROS_MASTER_URI, else port 11311 here",
        },
        "node": {
            "type": "string",
            "pattern": "^[A-Za-z][A-Za-z0-9_]*$",
            "description": "name of the bridge's node; default: one that no other has",
        },
        "namespace": {
            "type": "string",
            "pattern": f"^(/|{_GRAPH_NAME})$",
            "description": "of the node and of relative names; default: ROS_NAMESPACE, else /",
        },
        "remap": {
            "type": "object",
            "propertyNames": {"pattern": f"^{_GRAPH_NAME}$"},
            "additionalProperties": {"type": "string", "pattern": f"^{_GRAPH_NAME}$"},
            "description": "names that stand for others",
        },
        "host": {
            **_TEXT,
            "description": "under which others reach the node; default: ROS_HOSTNAME, ROS_IP, "
            "else the address from which the master is reached",
        },
        "definitions": {
            "type": "array",
            "items": dict(_TEXT),
            "maxItems": 64,
            "description": "folders of .msg, .srv and .action files",
        },
        "wait": {**_SECONDS, "description": "seconds to wait for the other end; default 1"},
        "check": {
            "type": "number",
            "minimum": 0.05,
            "maximum": 3600,
            "description": "seconds between looks at the master; default 1",
        },
        "silence": {
            "type": "number",
            "minimum": 0.05,
            "maximum": 3600,
            "description": "seconds without a message until a publisher is asked whether it is "
            "alive; default 5",
        },
        "use_sim_time": {
            "type": "boolean",
            "description": "whether stale_after counts by /clock, and goals have its time; "
            "default false",
        },
        "rosout": {
            "type": "boolean",
            "description": "whether the node says on /rosout what is wrong; default true",
        },
        "max_octets": {**_COUNT, "description": "of a message that comes; default 16 MiB"},
        "max_values": {**_COUNT, "description": "in lists of a message; default 500,000"},
    },
}


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
class Ros1Options(EndpointOptions):
    """The options of one endpoint."""

    peer: str = option(
        "required",
        {"enum": ["required", "optional"]},
        "`optional`: available without another end, as for publishing outward",
    )
    wait: float | None = option(
        None,
        {**_SECONDS, "maximum": 86400},
        "seconds to wait for the other end; left out: as the bridge does",
        unit="s",
    )
    stale_after: float | None = option(
        None,
        {"type": "number", "exclusiveMinimum": 0, "maximum": 86400},
        "of an output: seconds without a message after which it is lost; left out: never",
        unit="s",
    )
    node: str = option(
        "",
        {"type": "string", "pattern": f"^{_GRAPH_NAME}$"},
        "of an output the one node whose messages are taken, of an input one that must subscribe; "
        "left out: all of the topic",
    )
    latch: int = option(
        0,
        {"type": ["boolean", "integer"], "minimum": 1, "maximum": 1000},
        "of an input: how many of the last messages each subscriber that comes is given, as for "
        "`/tf_static`; `true`: the last one",
    )
    queue: int = option(
        100,
        {"type": "integer", "minimum": 1, "maximum": 100_000},
        "of an input: messages that may wait for one subscriber; then the oldest are dropped and "
        "counted",
    )
    nodelay: bool = option(
        True,
        {"type": "boolean"},
        "of an output: the publisher is asked to send small messages at once",
    )
    definition: str = option("", _TEXT, "the text of the type, where no peer says it")
    at_once: int = option(
        8,
        {"type": "integer", "minimum": 1, "maximum": 64},
        "of what is offered: requests or goals that are handled at the same time",
    )

    @property
    def peer_required(self) -> bool:
        """Whether an endpoint without another end counts as unavailable."""
        return self.peer == "required"


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
class Ros1BridgeOptions:
    """The options of a bridge, with what the environment says of what they leave out."""

    master_host: str
    master_port: int
    names: Names
    host: str
    definitions: tuple[str, ...]
    wait: float
    check: float
    silence: float
    use_sim_time: bool
    rosout: bool
    budget: Budget

    @property
    def master(self) -> str:
        """The master's address."""
        return f"http://{self.master_host}:{self.master_port}/"


def read_ros1_options(
    name: str, options: Options, environment: Mapping[str, str]
) -> Ros1BridgeOptions:
    """Read the options of a bridge, already checked against the schema.

    Raises:
        ConfigurationError: the address of the master, or a name of the environment, is none.
    """
    given: dict[str, Any] = dict(options)
    uri = given.get("master") or environment.get("ROS_MASTER_URI") or "http://localhost:11311"
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname or "", parts.port or 11311
    except ValueError as error:
        raise ConfigurationError(f"bridge {name!r}: master {uri!r}: {error}") from None
    if parts.scheme != "http" or not host:
        text = f"bridge {name!r}: expected a master such as http://robot:11311, got {uri!r}"
        raise ConfigurationError(text)
    namespace = given.get("namespace") or environment.get("ROS_NAMESPACE") or "/"
    namespace = "/" + namespace.strip("/")
    if namespace != "/" and not _NAME.fullmatch(namespace):
        raise ConfigurationError(f"bridge {name!r}: ROS_NAMESPACE {namespace!r} is no namespace")
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    # Two nodes of one name end each other: unless it is stated, no other node has it.
    node = given.get("node") or f"uoarm_{plain}_{os.getpid()}_{os.urandom(4).hex()}"
    names = Names(f"{namespace.rstrip('/')}/{node}", namespace)
    remap = {
        names.resolve(alias): names.resolve(target)
        for alias, target in given.get("remap", {}).items()
    }
    said = environment.get("ROS_HOSTNAME") or environment.get("ROS_IP") or ""
    return Ros1BridgeOptions(
        host,
        port,
        Names(names.node, namespace, remap),
        given.get("host") or said,
        tuple(given.get("definitions", ())),
        given.get("wait", 1.0),
        given.get("check", 1.0),
        given.get("silence", 5.0),
        given.get("use_sim_time", False),
        given.get("rosout", True),
        Budget(
            octets=given.get("max_octets", 16_777_216), elements=given.get("max_values", 500_000)
        ),
    )


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


def port_of(endpoint: Endpoint) -> Ros1Options:
    """Read an endpoint's options. What is offered needs no peer.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    port = Ros1Options.of_endpoint(endpoint)
    return evolve(port, peer="optional") if endpoint.is_offered else port


def mistake(address: tuple[str, ...], options: Options) -> str:
    """Return what is wrong with an address, or ""."""
    del options  # each is checked by itself
    try:
        _address(address)
    except ValueError as error:
        return str(error)
    return ""


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
        text = f"{address.type!r} is not a type of ROS 1 such as sensor_msgs/Image"
        raise ValueError(f"{text}, nor `{PARAMETER}`")
    return address
