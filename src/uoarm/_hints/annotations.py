"""What hints may be annotated with, and the error for a hint that has no message structure."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from attrs import frozen

from uoarm.errors import BridgeError, FailureReason

__all__ = ["HintError", "Octets", "OctetsMark", "Range", "Shape", "UInt8"]


class HintError(BridgeError):
    """A type hint that has no message structure."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.BAD_ENDPOINT)


@frozen
class Range:
    """Bounds of a number, both included; None where there is none."""

    minimum: float | int | None = None
    maximum: float | int | None = None


@frozen(init=False)
class Shape:
    """The lengths of an array's dimensions, None where any will do: `Shape(480, None, 3)`."""

    lengths: tuple[int | None, ...]

    def __init__(self, *lengths: int | None) -> None:
        self.__attrs_init__(lengths)


@frozen
class OctetsMark:
    """Marks `bytes` that may come as any buffer of octets, without a copy."""


UInt8: TypeAlias = Annotated[int, Range(0, 255)]
Octets: TypeAlias = Annotated[bytes, OctetsMark()]
