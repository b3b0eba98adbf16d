"""Addresses and options as the configuration writes them, read without any middleware.

The policy of a buffer travels as connector properties whatever side it is for, and is read from
them by the side that holds the buffer: `policy_properties` writes, `buffer_policy` reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from attrs import field, frozen

from uoarm.bridge import reading_endpoint
from uoarm.model import Endpoint, Options, Role, Schema

__all__ = [
    "BRIDGE_OPTIONS",
    "CONFIGURATION",
    "LIFECYCLE",
    "POLICY_OPTIONS",
    "SELF",
    "BufferPolicy",
    "PortAddress",
    "PushPolicy",
    "RtmBridgeOptions",
    "RtmEndpointOptions",
    "address_of",
    "bridge_options",
    "buffer_policy",
    "linked_options",
    "option_mistake",
    "options_of",
    "policy_properties",
    "push_policy",
    "says_what_empty_means",
]

POLICY_OPTIONS = ("buffer", "inport_buffer", "outport_buffer", "push_policy", "skip_count")
"""The options of an endpoint that `policy_properties` reads."""

_SIDES = ("inport", "outport")

_FULL = ("overwrite", "do_nothing", "block")
_EMPTY = ("do_nothing", "readback", "block")
_PUSH = ("new", "fifo", "skip", "all")
_PUSH_POLICY = "dataport.publisher.push_policy"
_SKIP_COUNT = "dataport.publisher.skip_count"
_LONGEST = 10_000
_MOST_SECONDS = 60.0
_MOST_SKIPPED = 1_000_000

_MEMBERS = {
    "length": "length",
    "full_policy": "write.full_policy",
    "write_timeout": "write.timeout",
    "empty_policy": "read.empty_policy",
    "read_timeout": "read.timeout",
}
"""Members of a `buffer` option, and what OpenRTM calls them."""


@frozen
class BufferPolicy:
    """What one buffer does when it is full, and when it is empty.

    Attributes:
        length: messages that it holds.
        full: `overwrite` the oldest, `do_nothing` with the new one, or `block`.
        write_seconds: how long a writer waits with `block`.
        empty: `do_nothing`, `readback` of the last message once more, or `block`.
        read_seconds: how long a reader waits with `block`.
    """

    length: int = 8
    full: str = "overwrite"
    write_seconds: float = 1.0
    empty: str = "do_nothing"
    read_seconds: float = 1.0

    @property
    def longest_write(self) -> float:
        """Seconds that a writer may be made to wait."""
        return self.write_seconds if self.full == "block" else 0.0

    @property
    def longest_read(self) -> float:
        """Seconds that a reader may be made to wait."""
        return self.read_seconds if self.empty == "block" else 0.0


@frozen
class PushPolicy:
    """Which of the messages that wait an OutPort pushes.

    Attributes:
        which: the `new`est alone, one after the other (`fifo`), `all`, or `skip`.
        skipped: with `skip`, how many are left out before each that is pushed.
    """

    which: str = "new"
    skipped: int = 0


def policy_properties(options: Mapping[str, object]) -> dict[str, str]:
    """Return the connector properties that POLICY_OPTIONS ask for.

    Raises:
        ValueError: with the option or its member, what was expected and what came.
    """
    properties = {}
    for option, sides in (
        ("buffer", _SIDES),
        ("inport_buffer", _SIDES[:1]),
        ("outport_buffer", _SIDES[1:]),
    ):
        for name, text in _buffer_texts(option, options.get(option, {})).items():
            properties.update({f"dataport.{side}.buffer.{name}": text for side in sides})
    if "push_policy" in options:
        properties[_PUSH_POLICY] = _policy_word(
            "push_policy", _policy_text(options["push_policy"]), _PUSH
        )
    if "skip_count" in options:
        if options.get("push_policy") != "skip":
            raise ValueError("skip_count means nothing without push_policy: skip")
        skipped = _policy_count("skip_count", _policy_text(options["skip_count"]), 0, _MOST_SKIPPED)
        properties[_SKIP_COUNT] = str(skipped)
    return properties


def buffer_policy(properties: Mapping[str, str], side: str) -> BufferPolicy:
    """Read the policy of the buffer at one side of a connector.

    What is said of the side comes before what is said of both (`dataport.buffer.`).

    Raises:
        ValueError: a property has a value that is unknown here.
    """
    said = {}
    for start in ("dataport.buffer.", f"dataport.{side}.buffer."):
        for name in _MEMBERS.values():
            text = properties.get(start + name, "").strip().lower()
            if text:
                said[name] = start + name, text
    return _policy(said)


def says_what_empty_means(properties: Mapping[str, str]) -> bool:
    """Whether properties say what an OutPort's buffer shall do while it is empty."""
    name = _MEMBERS["empty_policy"]
    return any(properties.get(f"dataport.{side}buffer.{name}") for side in ("", "outport."))


def push_policy(properties: Mapping[str, str]) -> PushPolicy:
    """Read which messages an OutPort is to push.

    Raises:
        ValueError: a property has a value that is unknown here.
    """
    which = properties.get(_PUSH_POLICY, "").strip().lower() or _PUSH[0]
    skipped = properties.get(_SKIP_COUNT, "").strip() or "0"
    return PushPolicy(
        _policy_word(_PUSH_POLICY, which, _PUSH),
        _policy_count(_SKIP_COUNT, skipped, 0, _MOST_SKIPPED),
    )


def _buffer_texts(option: str, table: object) -> dict[str, str]:
    """Return what the table of an option asks for, by OpenRTM's names below `buffer.`."""
    if not isinstance(table, Mapping):
        raise ValueError(f"{option} must be a table such as {{length: 4}}, got {table!r}")  # noqa: TRY004 - one kind
    unknown = sorted(set(table) - set(_MEMBERS), key=str)
    if unknown:
        text = f"{option} has no member {unknown[0]!r}; there are {', '.join(_MEMBERS)}"
        raise ValueError(text)
    for timeout, policy in (("write_timeout", "full_policy"), ("read_timeout", "empty_policy")):
        if timeout in table and table.get(policy) != "block":
            raise ValueError(f"{option}.{timeout} means nothing without {policy}: block")
    texts = {_MEMBERS[member]: _policy_text(value) for member, value in table.items()}
    _policy({_MEMBERS[item]: (f"{option}.{item}", texts[_MEMBERS[item]]) for item in table})
    return texts


def _policy(said: Mapping[str, tuple[str, str]]) -> BufferPolicy:
    """Read what is said, each with its place, and take what is usual for the rest."""
    usual = BufferPolicy()
    length, full, wait, empty, read = (said.get(name) for name in _MEMBERS.values())
    return BufferPolicy(
        _policy_count(*length, 1, _LONGEST) if length else usual.length,
        _policy_word(*full, _FULL) if full else usual.full,
        _policy_seconds(*wait) if wait else usual.write_seconds,
        _policy_word(*empty, _EMPTY) if empty else usual.empty,
        _policy_seconds(*read) if read else usual.read_seconds,
    )


def _policy_text(value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return repr(value)
    return str(value)


def _policy_word(name: str, text: str, words: tuple[str, ...]) -> str:
    if text not in words:
        raise ValueError(f"{name} must be {' or '.join(words)}, got {text!r}")
    return text


def _policy_count(name: str, text: str, least: int, most: int) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= len(str(most))):
        number = -1
    else:
        number = int(text)
    if not least <= number <= most:
        raise ValueError(f"{name} must be a whole number from {least} to {most}, got {text!r}")
    return number


def _policy_seconds(name: str, text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds <= _MOST_SECONDS:
        raise ValueError(f"{name} must be seconds from 0 to {_MOST_SECONDS:g}, got {text!r}")
    return seconds


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
