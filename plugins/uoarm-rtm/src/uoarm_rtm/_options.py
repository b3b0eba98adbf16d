"""Addresses and options as the configuration writes them, read without any middleware."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from attrs import field, frozen

from uoarm.bridge import reading_endpoint
from uoarm.model import Endpoint, Options, Role, Schema
from uoarm_rtm._buffering import POLICY_OPTIONS, buffer_policy, policy_properties, push_policy

__all__ = [
    "BRIDGE_OPTIONS",
    "CONFIGURATION",
    "LIFECYCLE",
    "SELF",
    "PortAddress",
    "RtmBridgeOptions",
    "RtmEndpointOptions",
    "address_of",
    "bridge_options",
    "linked_options",
    "option_mistake",
    "options_of",
]

SELF = "self"
"""The component path that means the component that the bridge itself is."""

LIFECYCLE, CONFIGURATION = "@lifecycle", "@configuration"
"""Port names that mean a component itself rather than a port of it."""

_OF_ONE_END = frozenset({"activate", "reset", "stale_after", "timeout"})
_OF_OPTIONS = {
    "dataport.serializer.cdr.endian": "endian",
    "dataport.data_type": "the third part of the address",
}

_NAMESERVER = "corbaloc::localhost:2809/NameService"
_TEXTS: dict[str, object] = {"type": "array", "items": {"type": "string"}, "minItems": 1}
_IDL: dict[str, object] = {"type": "string", "minLength": 1, "x-uoarm-path": r"[^{]+"}

BRIDGE_OPTIONS: Schema = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "nameserver": {
            "anyOf": [{"type": "string", "minLength": 1}, _TEXTS],
            "description": "one or several naming services, corbaloc or host:port",
        },
        "idl": {
            "anyOf": [_IDL, {"type": "array", "items": _IDL, "minItems": 1}],
            "description": "IDL files or texts with further data types",
        },
        "idl_folder": {
            "type": "string",
            "x-uoarm-path": True,
            "default": ".",
            "description": "where texts of `idl` find what they include; default: the file's",
        },
        "address": {"type": "string", "description": "interface to listen on; default 127.0.0.1"},
        "call_timeout": {
            "type": "number",
            "exclusiveMinimum": 0,
            "maximum": 60,
            "description": "seconds that one CORBA call may take; default 2, and for operations "
            "of services the limit of the call",
        },
        "watch": {
            "type": "number",
            "minimum": 0,
            "maximum": 3600,
            "description": "seconds between checks of components; 0 never; default 1",
        },
        "observe": {
            "type": "boolean",
            "description": "whether components are asked to notify us when their states change; "
            "default true",
        },
        "text": {
            "enum": ["utf-8", "latin-1"],
            "description": "encoding of strings in data; default utf-8",
        },
        "max_message": {
            "type": "integer",
            "minimum": 1 << 16,
            "maximum": 1 << 30,
            "description": "octets of one message that we send or take at most; default 64 MiB",
        },
        "component": {
            "type": "string",
            "pattern": "^[A-Za-z0-9_]+$",
            "description": "name of the bridge's own component; default: uoarm_ and its name",
        },
    },
}


@frozen
class PortAddress:
    """A port of a component, or the component itself.

    Attributes:
        component: path in the naming service, its last step alone, or `self`.
        port: the port's name, `@lifecycle` or `@configuration`.
        type: data type, or `Interface::operation` of a service; empty for what the port says.
    """

    component: str
    port: str
    type: str = ""


@frozen
class RtmBridgeOptions:
    """The options of a bridge instance; `operation_seconds` is None where none are asked for."""

    component: str
    nameservers: tuple[str, ...] = (_NAMESERVER,)
    idl: tuple[str, ...] = ()
    address: str = "127.0.0.1"
    call_seconds: float = 2.0
    watch_seconds: float = 1.0
    text: str = "utf-8"
    most_octets: int = 1 << 26
    operation_seconds: float | None = None
    observe: bool = True
    idl_folder: str = "."


@frozen
class RtmEndpointOptions:
    """The options of an endpoint; meaning in docs/rtm.md.

    `properties` holds also what the options for buffers and pushing come to.
    """

    flow: Literal["push", "pull"] = "push"
    subscription: Literal["flush", "new", "periodic"] = "flush"
    rate: float = 20.0
    endian: Literal["little", "big"] = "little"
    activate: Literal[False, True, "keep"] = False
    reset: bool = False
    event: str = ""
    instance: str = ""
    interface: str = ""
    timeout: float | None = None
    stale_after: float | None = None
    properties: Mapping[str, str] = field(factory=dict, hash=False)

    @property
    def period(self) -> float:
        """Seconds from one push of ours to the next; 0 for whenever there is something."""
        return 1.0 / self.rate if self.subscription == "periodic" else 0.0


def bridge_options(name: str, options: Options) -> RtmBridgeOptions:
    """Read the options of a bridge, which have been checked against BRIDGE_OPTIONS."""
    defaults = RtmBridgeOptions(str(options.get("component", f"uoarm_{name}")))
    return RtmBridgeOptions(
        defaults.component,
        _texts(options.get("nameserver")) or defaults.nameservers,
        _texts(options.get("idl")),
        str(options.get("address", defaults.address)),
        _seconds(options, "call_timeout") or defaults.call_seconds,
        _number(options.get("watch", defaults.watch_seconds), "watch"),
        str(options.get("text", defaults.text)),
        int(str(options.get("max_message", defaults.most_octets))),
        _seconds(options, "call_timeout"),
        options.get("observe", defaults.observe) is True,
        str(options.get("idl_folder", defaults.idl_folder)),
    )


def address_of(endpoint: Endpoint) -> PortAddress:
    """Read an endpoint's address.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    with reading_endpoint(endpoint):
        address = _address(endpoint.address)
        _fits(address, endpoint.role, is_offered=endpoint.is_offered)
    return address


def options_of(endpoint: Endpoint) -> RtmEndpointOptions:
    """Read an endpoint's options.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    with reading_endpoint(endpoint):
        return _read_options(endpoint.options)


def linked_options(source: Endpoint, sink: Endpoint) -> RtmEndpointOptions | None:
    """Return what both ends of a native link ask together; None where one link cannot be both.

    That is so where the two contradict each other, or ask for what needs us in between:
    `stale_after` of an output, `timeout` of an input.
    """
    if source.options.get("stale_after") is not None or sink.options.get("timeout") is not None:
        return None
    together: dict[str, object] = {}
    for options in (source.options, sink.options):
        for name, value in options.items():
            if name in _OF_ONE_END:
                continue
            before = together.setdefault(name, value)
            if isinstance(before, Mapping) and isinstance(value, Mapping):
                if any(key in value and value[key] != before[key] for key in before):
                    return None
                together[name] = {**before, **value}
            elif before != value:
                return None
    try:
        return _read_options(together)
    except ValueError:  # each is right by itself, and the two are not
        return None


def option_mistake(address: tuple[str, ...], options: Options) -> str:
    """Return what is wrong with an address or its options, or ""."""
    try:
        _address(address)
        _read_options(options)
    except ValueError as error:
        return str(error)
    return ""


def _address(parts: tuple[str, ...]) -> PortAddress:
    if not 2 <= len(parts) <= 3 or not all(parts[:2]):  # noqa: PLR2004 - as the sentence says
        text = "expected [component, port] or [component, port, type]"
        raise ValueError(f"{text}, such as [Camera0.rtc, image], got {list(parts)}")
    return PortAddress(*parts)


def _fits(address: PortAddress, role: Role, *, is_offered: bool) -> None:
    if role is not Role.SERVICE and address.port in {LIFECYCLE, CONFIGURATION}:
        raise ValueError(f"{address.port} is a service, not an {role.value}")
    if address.component == SELF and not address.type and not is_offered:
        raise ValueError("a port of our own component needs its type as third part")


def _read_options(options: Options) -> RtmEndpointOptions:
    known = [*(attr.name for attr in RtmEndpointOptions.__attrs_attrs__), *POLICY_OPTIONS]
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise ValueError(f"there is no option {unknown[0]!r}; there are {', '.join(known)}")
    activate, reset = options.get("activate", False), options.get("reset", False)
    if not isinstance(activate, bool) and activate != "keep":
        raise ValueError(f"activate must be true, false or keep, got {activate!r}")
    if not isinstance(reset, bool):
        raise ValueError(f"reset must be true or false, got {reset!r}")  # noqa: TRY004 - one kind
    if reset and not activate:
        raise ValueError("reset means nothing without activate: true or keep")
    flow = _one_of(options, "flow", ("push", "pull"))
    subscription = _one_of(options, "subscription", ("flush", "new", "periodic"))
    if "push_policy" in options and (flow == "pull" or subscription == "flush"):
        text = "push_policy means nothing without flow: push and subscription: new or periodic"
        raise ValueError(text)
    event = _word(options, "event")
    properties = {
        **policy_properties(options),
        **({"dataport.fsm_event_name": event} if event else {}),
        **_properties(options.get("properties", {})),
    }
    for side in ("inport", "outport"):
        buffer_policy(properties, side)
    push_policy(properties)
    return RtmEndpointOptions(
        flow,  # type: ignore[arg-type]  # checked above
        subscription,  # type: ignore[arg-type]  # checked above
        _seconds(options, "rate") or RtmEndpointOptions().rate,
        _one_of(options, "endian", ("little", "big")),  # type: ignore[arg-type]  # checked there
        activate,
        reset,
        event,
        _word(options, "instance"),
        _word(options, "interface"),
        _seconds(options, "timeout"),
        _seconds(options, "stale_after"),
        properties,
    )


def _one_of(options: Options, name: str, values: tuple[str, ...]) -> str:
    value = options.get(name, values[0])
    if value not in values:
        raise ValueError(f"{name} must be {' or '.join(values)}, got {value!r}")
    return str(value)


def _word(options: Options, name: str) -> str:
    value = options.get(name, "")
    if not isinstance(value, str):
        raise ValueError(f"{name} must be a text, got {value!r}")  # noqa: TRY004 - one kind
    return value


def _seconds(options: Options, name: str) -> float | None:
    value = options.get(name)
    if value is None:
        return None
    number = _number(value, name)
    if not number > 0:
        raise ValueError(f"{name} must be more than 0, got {value!r}")
    return number


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} must be a number, got {value!r}")  # noqa: TRY004 - one kind
    return float(value)


def _texts(value: object) -> tuple[str, ...]:
    if value is None:
        return ()
    return (value,) if isinstance(value, str) else tuple(map(str, value))  # type: ignore[call-overload]  # by the schema


def _properties(value: object) -> Mapping[str, str]:
    if not isinstance(value, Mapping) or not all(isinstance(item, str) for item in value.values()):
        raise ValueError(f"properties must be a table of strings, got {value!r}")
    for name, option in _OF_OPTIONS.items():
        if name in value:
            # We encode and decode by the option: the property alone would make garbage of both.
            raise ValueError(f"properties must not hold {name}: use {option}")
    interface = value.get("dataport.interface_type", "corba_cdr")
    if interface != "corba_cdr":
        text = f"interface type {interface!r} is not spoken here: only corba_cdr is"
        raise ValueError(text)
    return dict(value)
