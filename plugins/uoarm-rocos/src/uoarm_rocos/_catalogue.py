"""Catalogues: which APIs a device offers, and how two catalogues differ."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

from attrs import define, field, frozen

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.\-]{0,63}", re.ASCII)
INT64 = (-(2**63), 2**63 - 1)


@frozen
class BooleanField:
    """True or false."""


@frozen
class IntegerField:
    """A whole number within inclusive bounds; `unit` as UCUM writes it."""

    minimum: int = INT64[0]
    maximum: int = INT64[1]
    unit: str = ""


@frozen
class NumberField:
    """A 64-bit float; None is no bound; `nonfinite` admits NaN and infinities."""

    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    nonfinite: bool = False


@frozen
class StringField:
    """Text of at most `max_length` code points, or one of `choices` where there are any."""

    choices: tuple[str, ...] = ()
    max_length: int | None = None


@frozen
class OctetsField:
    """At most `max_length` octets."""

    max_length: int | None = None


@frozen
class StructField:
    """Named members, in the catalogue's order."""

    members: Fields = field(factory=dict, hash=False)


@frozen
class ListField:
    """Items of one type."""

    items: Field
    min_items: int = 0
    max_items: int | None = None


Field: TypeAlias = (
    BooleanField | IntegerField | NumberField | StringField | OctetsField | StructField | ListField
)


@frozen
class NamedField:
    """A field with its name's rules: whether a message may leave it out."""

    type: Field
    required: bool = True


Fields: TypeAlias = Mapping[str, NamedField]


PROFILE = 1


class ApiKind(Enum):
    """How an API is used."""

    SERVICE = "service"
    FLOW = "flow"


@frozen
class Api:
    """One API of a device.

    Attributes:
        name: what hosts ask for.
        kind: a service answers calls; a flow sends its output, takes its input, or both.
        input: what it takes.
        output: what it gives.
        period: seconds between two messages of a flow; None: whenever there is something.
        text: a description for people.
    """

    name: str
    kind: ApiKind
    input: Fields = field(factory=dict, hash=False)
    output: Fields = field(factory=dict, hash=False)
    period: float | None = None
    text: str = ""


@frozen
class DeviceCatalogue:
    """What one device offers; `heartbeat` is its period in seconds."""

    device: str
    apis: Mapping[str, Api] = field(factory=dict, hash=False)
    revision: str = ""
    heartbeat: float = 1.0


def differences(before: DeviceCatalogue, after: DeviceCatalogue) -> dict[str, str]:
    """Return a sentence for each API that is gone, new, or not what it was.

    Descriptions and the order of fields are no difference.
    """
    found = {}
    for name in sorted(before.apis.keys() | after.apis.keys()):
        old, new = before.apis.get(name), after.apis.get(name)
        if old is None or new is None:
            found[name] = f"API {name!r} is {'gone' if new is None else 'new'}"
            continue
        parts = [
            f"{part} was {_shown(getattr(old, part))}, is {_shown(getattr(new, part))}"
            for part in ("kind", "period")
            if getattr(old, part) != getattr(new, part)
        ]
        for part in ("input", "output"):
            parts += _changed(part, getattr(old, part), getattr(new, part))
        if parts:
            found[name] = f"API {name!r} changed: {'; '.join(parts)}"
    return found


def difference(api: Api, now: DeviceCatalogue) -> str:
    """Return a sentence on what an API is no more in a catalogue; empty where it is as it was."""
    there = now.apis.get(api.name)
    if there is api or there == api:
        return ""
    both = [DeviceCatalogue("", {api.name: item} if item else {}) for item in (api, there)]
    return differences(*both).get(api.name, "")


def _changed(part: str, old: Fields, new: Fields) -> list[str]:
    sentences = []
    for name in sorted(old.keys() | new.keys()):
        if name not in new:
            sentences.append(f"{part}.{name} is gone")
        elif name not in old:
            sentences.append(f"{part}.{name} is new")
        elif old[name] != new[name]:
            sentences.append(f"{part}.{name} was {old[name]}, is {new[name]}")
    return sentences


def _shown(value: object) -> str:
    return str(value.value if isinstance(value, Enum) else value)


if TYPE_CHECKING:
    from attrs import frozen as message
else:  # frozen for type checkers: one that is at run time, too, takes thrice as long to make
    message = define(unsafe_hash=True)

Values: TypeAlias = Mapping[str, Any]


class Direction(Enum):
    """Which way the data of a flow go, seen from the device."""

    INPUT = "input"
    OUTPUT = "output"


class ErrorCode(Enum):
    """Why a device ends a conversation."""

    PROFILE = "profile"
    UNKNOWN_API = "unknown-api"
    BAD_INPUT = "bad-input"
    BUSY = "busy"
    CANCELLED = "cancelled"
    FAILED = "failed"
    LIMIT = "limit"


@message
class DescribeMessage:
    """The host asks for the catalogue."""

    seq: int
    id: int
    profile: int = PROFILE


@message
class CatalogueMessage:
    """The device answers `DescribeMessage`."""

    seq: int
    id: int
    catalogue: DeviceCatalogue


@message
class CallMessage:
    """The host asks a service."""

    seq: int
    id: int
    api: str
    values: Values = field(factory=dict, hash=False)


@message
class ResultMessage:
    """The device answers `CallMessage`."""

    seq: int
    id: int
    values: Values = field(factory=dict, hash=False)


@message
class OpenMessage:
    """The host begins a flow; the device says the same again when it is open."""

    seq: int
    id: int
    api: str
    direction: Direction


@message
class DataMessage:
    """One message of an open flow; `time` in seconds of the sender's clock."""

    seq: int
    id: int
    values: Values = field(factory=dict, hash=False)
    time: float | None = None


@message
class CloseMessage:
    """A flow ends in good order, or a call is given up."""

    seq: int
    id: int


@message
class ErrorMessage:
    """The device ends a conversation for a reason; `id` 0 is the whole line."""

    seq: int
    id: int
    code: ErrorCode
    text: str = ""


@message
class HeartbeatMessage:
    """I am here."""

    seq: int


WireMessage: TypeAlias = (
    DescribeMessage
    | CatalogueMessage
    | CallMessage
    | ResultMessage
    | OpenMessage
    | DataMessage
    | CloseMessage
    | ErrorMessage
    | HeartbeatMessage
)
