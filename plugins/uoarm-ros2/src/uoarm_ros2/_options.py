"""Addresses and options as the configuration writes them, read without any middleware."""

from __future__ import annotations

import re
from collections.abc import Mapping

from attrs import evolve, field, frozen

from uoarm.bridge import reading_endpoint
from uoarm.model import Endpoint, Options, Role, Schema
from uoarm_ros2._qos import QosOptions, qos_options
from uoarm_ros2._types import ACTION, MESSAGE, SERVICE, kind_of, type_mistake

__all__ = [
    "BRIDGE_OPTIONS",
    "HIGHEST_DOMAIN",
    "LOOKUP",
    "TF_MESSAGE",
    "Ros2Address",
    "Ros2BridgeOptions",
    "Ros2Options",
    "address_of",
    "mistake",
    "node_of",
    "options_of",
]

_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_PARTS = {
    Role.OUTPUT: ("feedback", "result", "status"),
    Role.INPUT: ("goal", "cancel"),
    Role.SERVICE: (),
}
# Fast DDS announces a participant every 3 s: one that starts beside us may be unseen that long.
_WAIT_SECONDS = 3.5
_SETTLE_SECONDS = 0.05
_MOST_AT_ONCE = 64
HIGHEST_DOMAIN = 232  # from there on the ports that DDS computes do not exist
TF_MESSAGE, LOOKUP = "tf2_msgs/msg/TFMessage", "lookup"
_AFTERWARDS = ("deactivate", "cleanup", "leave")

_SECONDS: dict[str, object] = {"type": "number", "minimum": 0, "maximum": 60}
BRIDGE_OPTIONS: Schema = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "domain_id": {
            "type": "integer",
            "minimum": 0,
            "maximum": HIGHEST_DOMAIN,
            # 102 to 214 lie in the ephemeral ports of Linux; small numbers are people's own.
            "x-uoarm-assign": {"from": 64, "to": 101, "except_variable": "ROS_DOMAIN_ID"},
            "description": "DDS domain; default: ROS_DOMAIN_ID of the environment, else 0",
        },
        "node": {
            "type": "string",
            "pattern": "^[A-Za-z_][A-Za-z0-9_]*$",
            "description": "name of the bridge's node; default: uoarm_ and the bridge's name",
        },
        "namespace": {"type": "string", "description": "namespace of the bridge's node"},
        "definitions": {
            "type": "array",
            "items": {"type": "string", "minLength": 1, "x-uoarm-path": True},
            "maxItems": 64,
            "description": "folders of .msg files for message types that are not installed",
        },
        "use_sim_time": {
            "type": "boolean",
            "description": "whether stale_after counts the seconds of /clock; default false",
        },
        "wait": {**_SECONDS, "description": "seconds to wait for the other end; default 3.5"},
        "shared_memory": {
            "type": "integer",
            "minimum": 1,
            "maximum": 1024,
            "description": "MiB of shared memory through which messages go out to readers on this "
            "machine; default: half a MiB, less than one picture",
        },
        "settle": {
            **_SECONDS,
            "description": "seconds for a matched publisher to learn of us; default 0.05",
        },
    },
}


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
class Ros2BridgeOptions:
    """The options of a bridge instance; `domain_id` None: what the environment says."""

    node: str
    namespace: str = ""
    domain_id: int | None = None
    wait: float = _WAIT_SECONDS
    settle: float = _SETTLE_SECONDS
    shared_memory: int | None = None
    definitions: tuple[str, ...] = ()
    use_sim_time: bool = False


@frozen
class Ros2Options:
    """The options of an endpoint.

    Attributes:
        qos: policies asked for.
        peer_required: whether an endpoint without another end counts as unavailable.
        wait: seconds to wait for the other end; None: as the bridge says.
        stale_after: seconds without a message after which the channel is lost; None: never.
        at_once: requests to a service that is offered that are handled at the same time.
        node: behind the component; empty: its name.
        activate: `false`, `true` or `keep`: whether a lifecycle node is active while it is used.
        afterwards: `deactivate`, `cleanup` or `leave`: what then becomes of it.
    """

    qos: QosOptions = field(factory=QosOptions)
    peer_required: bool = True
    wait: float | None = None
    stale_after: float | None = None
    at_once: int = 8
    node: str = ""
    activate: str = "false"
    afterwards: str = "deactivate"


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
    with reading_endpoint(endpoint):
        options = _read_options(endpoint.options)
        if not endpoint.is_offered:
            return options
        if options.node or options.activate != "false":
            raise ValueError(
                "what is offered stands on no node: node and activate do not go with it"
            )
        return evolve(options, peer_required=False)


def node_of(endpoint: Endpoint, options: Ros2Options) -> str:
    """Return the node behind a component, empty where nothing is asked of one.

    Raises:
        ValueError: it is not named, and the component's name is none of a node.
    """
    if not (options.node or options.activate != "false" or endpoint.parameters):
        return ""
    name = options.node or endpoint.component
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not the name of a node: say which it is with option node")
    return name


def mistake(address: tuple[str, ...], options: Options) -> str:
    """Return what is wrong with an address or its options, or ""."""
    try:
        _address(address)
        _read_options(options)
    except ValueError as error:
        return str(error)
    return ""


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


def _read_options(options: Options) -> Ros2Options:
    known = ("activate", "afterwards", "at_once", "node", "peer", "qos", "stale_after", "wait")
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise ValueError(f"there is no option {unknown[0]!r}; there are {', '.join(known)}")
    peer = options.get("peer", "required")
    if peer not in {"required", "optional"}:
        raise ValueError(f"peer must be required or optional, got {peer!r}")
    node = options.get("node", "")
    if node and not (isinstance(node, str) and _NAME.fullmatch(node)):
        raise ValueError(f"node must be the name of a node such as /camera, got {node!r}")
    activate = options.get("activate", False)
    if activate not in (True, False, "keep"):
        raise ValueError(f"activate must be true, false or keep, got {activate!r}")
    afterwards = options.get("afterwards", _AFTERWARDS[0])
    if afterwards not in _AFTERWARDS:
        raise ValueError(f"afterwards must be {' or '.join(_AFTERWARDS)}, got {afterwards!r}")
    return Ros2Options(
        qos_options(options.get("qos")),
        peer == "required",
        _seconds(options, "wait", zero=True),
        _seconds(options, "stale_after", zero=False),
        _at_once(options),
        str(node),
        str(activate).lower(),
        str(afterwards),
    )


def _at_once(options: Mapping[str, object]) -> int:
    value = options.get("at_once", 8)
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= _MOST_AT_ONCE:
        raise ValueError(f"at_once must be 1 to {_MOST_AT_ONCE}, got {value!r}")
    return value


def _seconds(options: Mapping[str, object], name: str, *, zero: bool) -> float | None:
    value = options.get(name)
    if value is None:
        return None
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not (value >= 0 if zero else value > 0):  # type: ignore[operator]  # a number
        raise ValueError(f"{name} must be seconds, got {value!r}")
    return float(value)  # type: ignore[arg-type]  # a number
