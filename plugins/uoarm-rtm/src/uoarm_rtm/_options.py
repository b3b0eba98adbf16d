"""Addresses and options as the configuration writes them, read without any middleware.

The policy of a buffer travels as connector properties whatever side it is for, and is read from
them by the side that holds the buffer: `requested_properties` writes, `buffer_policy` reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from attrs import frozen

from uoarm.bridge import (
    BridgeOptions,
    DeclaredOptions,
    EndpointOptions,
    address_check,
    option,
    reading_endpoint,
)
from uoarm.model import Endpoint, Role

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
"""Options of a buffer, and what OpenRTM calls them."""


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
_TEXT = {"type": "string"}
_TEXTS: dict[str, object] = {"type": "array", "items": _TEXT, "minItems": 1}
_IDL: dict[str, object] = {"type": "string", "minLength": 1, "x-uoarm-path": r"[^{]+"}
_CALL_SECONDS = 2.0


@frozen
class RtmBridgeOptions(BridgeOptions):
    """The options of a bridge."""

    nameserver: str | tuple[str, ...] = option(
        _NAMESERVER,
        {"anyOf": [{"type": "string", "minLength": 1}, _TEXTS]},
        "one or several naming services; `host:port` will do",
    )
    idl: str | tuple[str, ...] = option(
        (),
        {"anyOf": [_IDL, {"type": "array", "items": _IDL}]},
        'IDL files or texts with further types; `#include "BasicDataType.idl"` finds ours',
    )
    idl_folder: str = option(
        ".",
        {"type": "string", "x-uoarm-path": True},
        "where a text of `idl` finds what it includes, relative to the configuration's file",
    )
    call_timeout: float | None = option(
        None,
        {"type": "number", "exclusiveMinimum": 0, "maximum": 60},
        "seconds for one CORBA call, connecting included; left out: 2. Calls of operations "
        "have it only where it is written down",
        unit="s",
    )
    max_message: int = option(
        1 << 26,
        {"type": "integer", "minimum": 1 << 16, "maximum": 1 << 30},
        "bytes of one GIOP message, up to 1 GiB, for all bridges of a process",
    )
    watch: float = option(
        1.0,
        {"type": "number", "minimum": 0, "maximum": 3600},
        "seconds between checks of components; 0: never",
        unit="s",
    )
    observe: bool = option(
        True,
        {"type": "boolean"},
        "whether components are asked to report changes",
    )
    text: str = option(
        "utf-8",
        {"enum": ["utf-8", "latin-1"]},
        "encoding of strings; `latin-1` for components that send umlauts from omniORBpy",
    )
    address: str = option(
        "127.0.0.1",
        _TEXT,
        "the interface that our side listens on; `0.0.0.0`, or one address, for other machines",
    )
    component: str = option(
        "",
        {"type": "string", "pattern": "^[A-Za-z0-9_]+$", "examples": ["Manager0"]},
        "name of our own component; left out: `uoarm_` and the bridge's name",
    )

    @property
    def nameservers(self) -> tuple[str, ...]:
        """Naming services."""
        return _texts(self.nameserver)

    @property
    def idl_sources(self) -> tuple[str, ...]:
        """IDL files or texts."""
        return _texts(self.idl)

    @property
    def call_seconds(self) -> float:
        """Seconds that one CORBA call may take."""
        return _CALL_SECONDS if self.call_timeout is None else self.call_timeout


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


_WAITING = {"type": "number", "minimum": 0, "maximum": _MOST_SECONDS}
_ABOVE_ZERO = {"type": "number", "exclusiveMinimum": 0}


@frozen
class BufferOptions(DeclaredOptions):
    """How messages wait at one end of a connector; what is left out is the holder's to choose."""

    length: int | None = option(
        None,
        {"type": "integer", "minimum": 1, "maximum": _LONGEST},
        "messages that it holds",
    )
    full_policy: str | None = option(
        None,
        {"enum": list(_FULL)},
        "`overwrite` the oldest message, `do_nothing`: refuse the new one, `block`: let the "
        "writer wait",
    )
    write_timeout: float | None = option(
        None,
        _WAITING,
        "seconds that a writer waits with `block`",
        unit="s",
    )
    empty_policy: str | None = option(
        None,
        {"enum": list(_EMPTY)},
        "`do_nothing`: say so, `readback`: give the last message again, `block`: let the "
        "reader wait",
    )
    read_timeout: float | None = option(
        None,
        _WAITING,
        "seconds that a reader waits with `block`",
        unit="s",
    )

    @property
    def texts(self) -> dict[str, str]:
        """What is asked for, by OpenRTM's names below `buffer.`."""
        asked = {name: getattr(self, option) for option, name in _MEMBERS.items()}
        # 4.0 is a whole number in JSON, but not to the component that reads the property.
        asked["length"] = None if self.length is None else int(self.length)
        return {name: str(value) for name, value in asked.items() if value is not None}

    def check_together(self) -> None:
        """Refuse a time limit of what does not wait."""
        for timeout, policy in (("write_timeout", "full_policy"), ("read_timeout", "empty_policy")):
            if getattr(self, timeout) is not None and getattr(self, policy) != "block":
                raise ValueError(f"{timeout} means nothing without {policy}: block")


@frozen
class RtmEndpointOptions(EndpointOptions):
    """The options of an endpoint."""

    flow: Literal["push", "pull"] = option(
        "push",
        {"enum": ["push", "pull"]},
        "`push`: the OutPort calls the InPort; `pull`: the InPort asks the OutPort",
    )
    subscription: Literal["flush", "new", "periodic"] = option(
        "flush",
        {"enum": ["flush", "new", "periodic"]},
        "how an OutPort pushes: `flush` at once, `new` from a thread, `periodic`",
    )
    rate: float = option(
        20,
        _ABOVE_ZERO,
        "times a second, of `periodic` and of asking with `flow: pull`",
        unit="Hz",
    )
    push_policy: str | None = option(
        None,
        {"enum": list(_PUSH)},
        "which waiting messages are pushed: the `new`est (usual), `fifo`, `all`, or `skip`",
    )
    skip_count: int | None = option(
        None,
        {"type": "integer", "minimum": 0, "maximum": _MOST_SKIPPED},
        "how many `skip` leaves out before each that is pushed; left out: 0",
    )
    buffer: BufferOptions | None = option(
        None, BufferOptions, "how messages wait at both ends, see below"
    )
    inport_buffer: BufferOptions | None = option(
        None, BufferOptions, "the same for the InPort, before `buffer`"
    )
    outport_buffer: BufferOptions | None = option(
        None, BufferOptions, "the same for the OutPort, before `buffer`"
    )
    endian: Literal["little", "big"] = option(
        "little",
        {"enum": ["little", "big"]},
        "byte order; `big` not for OutPorts that push and InPorts that pull: C++ takes no notice",
    )
    activate: Literal[False, True, "keep"] = option(
        False,
        {"enum": [False, True, "keep"]},
        "`true`: activate the component on request, and deactivate it at the end, unless it "
        "was active before. `keep`: also when another program has deactivated it",
    )
    reset: bool = option(
        False,
        {"type": "boolean"},
        "with `activate`: reset a component in state ERROR first",
    )
    event: str = option(
        "",
        _TEXT,
        "of a state machine's port: the event that a message is, such as `minute` at "
        "`[Microwave0.rtc, event, TimedLong]`",
    )
    timeout: float | None = option(
        None,
        _ABOVE_ZERO,
        "seconds for one message to an InPort, or for one call",
        unit="s",
    )
    instance: str = option(
        "",
        _TEXT,
        "of our own service: name of the provided interface, as `rtcon` connects it; left "
        "out: the interface's name in lower case",
    )
    interface: str = option(
        "",
        _TEXT,
        "its type; left out: the interface's name; for C++ `SimpleService::MyService`",
    )
    stale_after: float | None = option(
        None,
        _ABOVE_ZERO,
        "seconds without a message after which an output is lost; left out: never",
        unit="s",
    )
    properties: Mapping[str, str] | None = option(
        None,
        {"type": "object", "additionalProperties": _TEXT},
        "further connector properties, before the other options; not byte order, data type "
        "or interface type",
    )

    @property
    def period(self) -> float:
        """Seconds from one push of ours to the next; 0 for whenever there is something."""
        return 1.0 / self.rate if self.subscription == "periodic" else 0.0

    @property
    def requested_properties(self) -> dict[str, str]:
        """What `properties` and the options for buffers, pushing and events ask of a connector."""
        requested = {}
        for table, sides in (
            (self.buffer, _SIDES),
            (self.inport_buffer, _SIDES[:1]),
            (self.outport_buffer, _SIDES[1:]),
        ):
            for name, text in table.texts.items() if table is not None else ():
                requested.update({f"dataport.{side}.buffer.{name}": text for side in sides})
        if self.push_policy is not None:
            requested[_PUSH_POLICY] = self.push_policy
        if self.skip_count is not None:
            requested[_SKIP_COUNT] = str(int(self.skip_count))
        if self.event:
            requested["dataport.fsm_event_name"] = self.event
        return {**requested, **(self.properties or {})}

    def check_together(self) -> None:
        """Refuse options of which one means nothing without, or beside, another."""
        if self.reset and not self.activate:
            raise ValueError("reset means nothing without activate: true or keep")
        if self.push_policy and (self.flow == "pull" or self.subscription == "flush"):
            text = "push_policy means nothing without flow: push and subscription: new or periodic"
            raise ValueError(text)
        if self.skip_count is not None and self.push_policy != "skip":
            raise ValueError("skip_count means nothing without push_policy: skip")
        properties = self.properties or {}
        for name, instead in _OF_OPTIONS.items():
            if name in properties:
                # We encode and decode by the option: the property alone would make garbage of both.
                raise ValueError(f"properties must not hold {name}: use {instead}")
        interface = properties.get("dataport.interface_type", "corba_cdr")
        if interface != "corba_cdr":
            text = f"interface type {interface!r} is not spoken here: only corba_cdr is"
            raise ValueError(text)
        requested = self.requested_properties
        for side in _SIDES:
            buffer_policy(requested, side)
        push_policy(requested)


def address_of(endpoint: Endpoint) -> PortAddress:
    """Read an endpoint's address.

    Raises:
        BridgeError: with BAD_ENDPOINT and what is wrong.
    """
    with reading_endpoint(endpoint):
        address = _address(endpoint.address)
        _fits(address, endpoint.role, is_offered=endpoint.is_offered)
    return address


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
        return RtmEndpointOptions.of(together)
    except ValueError:  # each is right by itself, and the two are not
        return None


def _address(parts: tuple[str, ...]) -> PortAddress:
    if not 2 <= len(parts) <= 3 or not all(parts[:2]):  # noqa: PLR2004 - as the sentence says
        text = "expected [component, port] or [component, port, type]"
        raise ValueError(f"{text}, such as [Camera0.rtc, image], got {list(parts)}")
    return PortAddress(*parts)


option_mistake = address_check(_address)


def _fits(address: PortAddress, role: Role, *, is_offered: bool) -> None:
    if role is not Role.SERVICE and address.port in {LIFECYCLE, CONFIGURATION}:
        raise ValueError(f"{address.port} is a service, not an {role.value}")
    if address.component == SELF and not address.type and not is_offered:
        raise ValueError("a port of our own component needs its type as third part")


def _texts(value: str | tuple[str, ...]) -> tuple[str, ...]:
    return (value,) if isinstance(value, str) else value
