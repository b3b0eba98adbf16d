"""What hints are annotated with and stand for, and the error for one without a message."""

from __future__ import annotations

from typing import Annotated, Any, NewType, TypeAlias, get_args, get_origin

from attrs import frozen

from uoarm.errors import BridgeError, FailureReason

__all__ = [
    "HintError",
    "Octets",
    "OctetsMark",
    "Range",
    "Shape",
    "UInt8",
    "is_class",
    "unwrapped",
]


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


def is_class(hint: Any) -> bool:
    """Say whether a hint is a class itself; `list[int]` says so on CPython 3.10, too."""
    return isinstance(hint, type) and get_origin(hint) is None


def unwrapped(hint: Any) -> Any:
    """Return what a NewType or a `type` alias, with its parameters or without, stands for."""
    while True:
        if isinstance(hint, NewType):
            hint = hint.__supertype__
        elif _is_alias(hint):
            hint = hint.__value__
        elif _is_alias(get_origin(hint)):
            hint = get_origin(hint).__value__[get_args(hint)]
        else:
            return hint


def _is_alias(hint: Any) -> bool:
    return type(hint).__name__ == "TypeAliasType"  # of typing or of typing_extensions
