"""The messages of the profile as plain values; `seq` counts what one side sends on a line."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

from attrs import define, field

from uoarm_rocos._catalogue import PROFILE, Catalogue

__all__ = [
    "Call",
    "CatalogueMessage",
    "Close",
    "Data",
    "Describe",
    "Direction",
    "ErrorCode",
    "ErrorMessage",
    "Heartbeat",
    "Open",
    "Result",
    "Values",
    "WireMessage",
]

if TYPE_CHECKING:
    from attrs import frozen as message
else:  # frozen for whoever writes code: one that is at run time, too, takes thrice as long to make
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
class Describe:
    """The host asks for the catalogue."""

    seq: int
    id: int
    profile: int = PROFILE


@message
class CatalogueMessage:
    """The device answers `Describe`."""

    seq: int
    id: int
    catalogue: Catalogue


@message
class Call:
    """The host asks a service."""

    seq: int
    id: int
    api: str
    values: Values = field(factory=dict, hash=False)


@message
class Result:
    """The device answers `Call`."""

    seq: int
    id: int
    values: Values = field(factory=dict, hash=False)


@message
class Open:
    """The host begins a flow; the device says the same again when it is open."""

    seq: int
    id: int
    api: str
    direction: Direction


@message
class Data:
    """One message of an open flow; `time` in seconds of the sender's clock."""

    seq: int
    id: int
    values: Values = field(factory=dict, hash=False)
    time: float | None = None


@message
class Close:
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
class Heartbeat:
    """I am here."""

    seq: int


WireMessage: TypeAlias = (
    Describe | CatalogueMessage | Call | Result | Open | Data | Close | ErrorMessage | Heartbeat
)
