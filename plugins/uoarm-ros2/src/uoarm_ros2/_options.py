"""Addresses and options as the configuration writes them, read without any middleware."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from attrs import frozen

from uoarm.bridge import BridgeOptions, PeerOptions, address_check, option, reading_endpoint
from uoarm.model import Endpoint, Options, Role
from uoarm_ros2._qos import AUTO_ONLY, QosOptions
from uoarm_ros2._types import ACTION, MESSAGE, SERVICE, kind_of, type_mistake

_GRAPH_NAME = "/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*"
_NAME = re.compile(_GRAPH_NAME)
_PARTS = {
    Role.OUTPUT: ("feedback", "result", "status"),
    Role.INPUT: ("goal", "cancel"),
    Role.SERVICE: (),
}
# Fast DDS announces a participant every 3 s: one that starts beside us may be unseen that long.
_WAIT_SECONDS = 3.5
HIGHEST_DOMAIN = 232  # from there on the ports that DDS computes do not exist
TF_MESSAGE, LOOKUP = "tf2_msgs/msg/TFMessage", "lookup"

_QOS: Any = QosOptions.schema()
_SECONDS: dict[str, object] = {"type": "number", "minimum": 0, "maximum": 60}


@frozen
class Ros2BridgeOptions(BridgeOptions):
    """The options of a bridge."""

    domain_id: int | None = option(
        None,
        {
            "type": "integer",
            "minimum": 0,
            "maximum": HIGHEST_DOMAIN,
            # 102 to 214 lie in the ephemeral ports of Linux; small numbers are people's own.
            "x-uoarm-assign": {"from": 64, "to": 101, "except_variable": "ROS_DOMAIN_ID"},
        },
        "DDS domain; left out: `ROS_DOMAIN_ID`, else 0, and 64 to 101 between hosted installations",
    )
    node: str = option(
        "",
        {"type": "string", "pattern": "^[A-Za-z_][A-Za-z0-9_]*$", "examples": ["left"]},
        "name of the bridge's node; left out: `uoarm_` and the bridge's name",
    )
    namespace: str = option(
        "",
        {"type": "string", "pattern": f"^({_GRAPH_NAME}|/)?$", "examples": ["/left"]},
        "of the bridge's node, and of relative names",
    )
    definitions: tuple[str, ...] = option(
        (),
        {
            "type": "array",
            "items": {"type": "string", "minLength": 1, "x-uoarm-path": True},
            "maxItems": 64,
        },
        "folders of `.msg` files for types that are not installed",
    )
    wait: float = option(
        _WAIT_SECONDS,
        _SECONDS,
        "seconds to wait for the other end, and after the start for the graph",
        unit="s",
    )
    shared_memory: int | None = option(
        None,
        {"type": "integer", "minimum": 1, "maximum": 1024},
        "MiB of shared memory for readers on this machine; left out: half a MiB",
    )
    settle: float = option(
        0.05, _SECONDS, "seconds given to a matched publisher to match us in turn", unit="s"
    )
    use_sim_time: bool = option(
        False, {"type": "boolean"}, "whether `stale_after` counts the seconds of `/clock`"
    )
    diagnostics_topic: str = option(
        "/diagnostics",
        {"type": "string", "pattern": f"^{_GRAPH_NAME}$", "examples": ["/diagnostics_agg"]},
        "the topic on which entries are read that outputs name with `diagnostics`",
    )
    diagnostics_timeout: float = option(
        5.0,
        {"type": "number", "exclusiveMinimum": 0, "maximum": 3600},
        "seconds without its entry after which a component is degraded",
        unit="s",
    )

    def node_name(self, bridge: str) -> str:
        """Return the name of the node of a bridge."""
        return self.node or f"uoarm_{''.join(c if c.isalnum() else '_' for c in bridge)}"


@frozen
class Ros2Address:
    """A topic, service or action by name.

    Attributes:
        name: as written; relative names are resolved in the bridge's namespace.
        type: `package/msg/Name` or the like; empty to take what the graph shows.
        part: of an action the stream meant, of `/tf` `lookup`; otherwise empty.
    """

    name: str
    type: str = ""
    part: str = ""

    @property
    def kind(self) -> str:
        """`msg`, `srv` or `action`; `msg` also when the type is left to the graph."""
        return kind_of(self.type) if self.type else MESSAGE


@frozen
class Ros2Options(PeerOptions):
    """The options of an endpoint."""

    qos: str | Mapping[str, Any] = option(
        "auto",
        {**_QOS, "type": ["string", "object"], **AUTO_ONLY},
        "`auto`, or a table of the policies below",
    )
    wait: float | None = option(
        None,
        {"type": "number", "minimum": 0},
        "seconds to wait for the other end; left out: as the bridge says",
        unit="s",
    )
    stale_after: float | None = option(
        None,
        {"type": "number", "exclusiveMinimum": 0},
        "seconds without a message until it is lost; left out: three times the `deadline` "
        "of every publisher, a second at least",
        unit="s",
    )
    node: str = option(
        "",
        {"type": "string", "pattern": f"^({_GRAPH_NAME})?$", "examples": ["/camera"]},
        "the node behind the component; left out: of the component's name",
    )
    activate: bool | str = option(
        False,
        {"enum": [False, True, "keep"]},
        "`true`: a lifecycle node is active while the component is in use; `keep`: also "
        "when another client deactivates it",
    )
    afterwards: str = option(
        "deactivate",
        {"enum": ["deactivate", "cleanup", "leave"]},
        "what then becomes of the node: `deactivate`, `cleanup` or `leave`",
    )
    diagnostics: str = option(
        "",
        {"type": "string", "maxLength": 256, "examples": ["driver: left wheel"]},
        "the entry on `diagnostics_topic` that says how the component is",
    )

    @property
    def policies(self) -> QosOptions:
        """What `qos` asks for."""
        return QosOptions() if isinstance(self.qos, str) else QosOptions(**self.qos)


def address_of(endpoint: Endpoint) -> Ros2Address:
    """Read an endpoint's address.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    with reading_endpoint(endpoint):
        address = _address(endpoint.address)
        if address.part == LOOKUP:
            if endpoint.role is not Role.SERVICE or endpoint.is_offered:
                raise ValueError("looking frames up is a service that is called, and nothing else")
            return address
        parts = _PARTS[_seen_by_clients(endpoint)]
        _fits(address, endpoint.role, parts)
        if address.kind == ACTION and endpoint.role is not Role.SERVICE:
            part = address.part or _default_part(endpoint, parts)
            address = Ros2Address(address.name, address.type, part)
    return address


def options_of(endpoint: Endpoint) -> Ros2Options:
    """Read an endpoint's options. What is offered needs no peer.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    options = Ros2Options.of_endpoint(endpoint)
    with reading_endpoint(endpoint):
        if endpoint.is_offered and (options.node or options.activate):
            raise ValueError(
                "what is offered stands on no node: node and activate do not go with it"
            )
        is_topic = endpoint.role is not Role.SERVICE and _address(endpoint.address).kind == MESSAGE
        if options.diagnostics and (endpoint.is_offered or not is_topic):
            raise ValueError(
                "diagnostics goes with topics of a component: services, actions and what is "
                "offered are not judged by it"
            )
    return options


def node_of(endpoint: Endpoint, options: Ros2Options) -> str:
    """Return the node behind a component, empty where nothing is asked of one.

    Raises:
        ValueError: it is not named, and the component's name is none of a node.
    """
    if not (options.node or options.activate or endpoint.parameters):
        return ""
    name = options.node or endpoint.component
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not the name of a node: say which it is with option node")
    return name


def topic_name(address: tuple[str, ...], options: Options) -> str:
    """Return the topic that an address names, or "" for an action or a service."""
    del options
    read = _address(address)
    return f"/{read.name.lstrip('/')}" if read.kind in (MESSAGE, "") and not read.part else ""


def _address(parts: tuple[str, ...]) -> Ros2Address:
    if not 1 <= len(parts) <= 3:  # noqa: PLR2004 - the three parts of the sentence
        raise ValueError(f"expected [name, type] or [name, action type, part], got {list(parts)}")
    address = Ros2Address(*parts)
    if not _NAME.fullmatch(address.name):
        raise ValueError(f"{address.name!r} is not a ROS 2 name such as /camera/image_raw")
    wrong = type_mistake(address.type) if len(parts) > 1 else ""
    if wrong:
        raise ValueError(wrong)
    known = tuple(part for parts in _PARTS.values() for part in parts)
    if (address.type, address.part) == (TF_MESSAGE, LOOKUP):
        return address
    if address.part and (address.kind != ACTION or address.part not in known):
        text = f"only an action has parts, and they are {', '.join(known)}; got {address.part!r}"
        raise ValueError(text)
    return address


mistake = address_check(_address)


def _seen_by_clients(endpoint: Endpoint) -> Role:
    """Return what clients have at an endpoint: an action that is offered is given its status."""
    if not endpoint.is_offered or endpoint.role is Role.SERVICE:
        return endpoint.role
    return Role.OUTPUT if endpoint.role is Role.INPUT else Role.INPUT


def _fits(address: Ros2Address, role: Role, parts: tuple[str, ...]) -> None:
    wanted = (SERVICE, ACTION) if role is Role.SERVICE else (MESSAGE, ACTION)
    if address.kind not in wanted and address.type:
        kinds = " or ".join(f"package/{kind}/Name" for kind in wanted)
        raise ValueError(f"an {role.value} takes a type {kinds}, got {address.type!r}")
    if address.part and address.part not in parts:
        raise ValueError(f"part {address.part!r} of an action is not an {role.value}")


def _default_part(endpoint: Endpoint, parts: tuple[str, ...]) -> str:
    if endpoint.port in parts:
        return endpoint.port
    return "result" if "result" in parts else "goal"
