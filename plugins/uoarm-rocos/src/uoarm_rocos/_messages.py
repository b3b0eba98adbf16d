"""The messages of the profile as plain values; `seq` counts what one side sends on a line."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

from attrs import define, field

from uoarm_rocos._catalogue import PROFILE, DeviceCatalogue

__all__ = [
    "CallMessage",
    "CatalogueMessage",
    "CloseMessage",
    "DataMessage",
    "DescribeMessage",
    "Direction",
    "ErrorCode",
    "ErrorMessage",
    "HeartbeatMessage",
    "OpenMessage",
    "ResultMessage",
    "Values",
    "WireMessage",
]

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
