"""Message structures from Python type hints."""

from __future__ import annotations

import dataclasses
import enum
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, TypeAlias, Union, get_args, get_origin, get_type_hints

import attrs
from attrs import frozen
from typing_extensions import NotRequired, Required

from uoarm.errors import BridgeError, FailureReason

__all__ = ["HintError", "Octets", "Range", "UInt8", "schema_of"]


class HintError(BridgeError):
    """A type hint that has no message structure."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.BAD_ENDPOINT)


@frozen
class Range:
    """Bounds of a number, both included; None where there is none."""

    minimum: float | int | None = None
    maximum: float | int | None = None


@frozen
class _Octets:
    """Marks `bytes`, which stand for an array of integers from 0 to 255."""


UInt8: TypeAlias = Annotated[int, Range(0, 255)]
Octets: TypeAlias = Annotated[bytes, _Octets()]

_OCTET_ARRAY: Mapping[str, object] = {
    "type": "array",
    "items": {"type": "integer", "minimum": 0, "maximum": 255},
    "x-octets": True,
}
_SIMPLE: Mapping[object, Mapping[str, object]] = {
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": "number"},
    str: {"type": "string"},
    bytes: _OCTET_ARRAY,
    bytearray: _OCTET_ARRAY,
    memoryview: _OCTET_ARRAY,
    None: {"type": "null"},
    types.NoneType: {"type": "null"},
}
_MAX_DEPTH = 32


def schema_of(hint: Any, depth: int = 0) -> Mapping[str, object]:
    """Return the JSON Schema of a type hint: closed objects, every field required.

    Understands bool, int, float, str, bytes, None, Literal, Enum, unions, list, tuple, dict,
    TypedDict (NotRequired too), dataclasses, attrs classes, and Annotated with `Range`.

    Raises:
        HintError: the hint has no message structure; the text names it.
    """
    if depth > _MAX_DEPTH:
        raise HintError(f"the type hint {hint!r} is nested too deep or recursive")
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return {"enum": [member.value for member in hint]}
    fields = _fields_of(hint)
    if fields is not None:
        return _object(fields, depth)
    return _generic(hint, depth)


def _generic(hint: Any, depth: int) -> Mapping[str, object]:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in {Required, NotRequired}:
        return schema_of(arguments[0], depth)
    if origin is Annotated:
        return _annotated(schema_of(arguments[0], depth), arguments[1:])
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin in {Union, types.UnionType}:
        return {"anyOf": [schema_of(one, depth + 1) for one in arguments]}
    if origin is list:
        return {"type": "array", "items": schema_of(arguments[0], depth + 1)}
    if origin is tuple:
        return _tuple(arguments, depth)
    if origin is dict and arguments[0] is str:
        return {"type": "object", "additionalProperties": schema_of(arguments[1], depth + 1)}
    raise HintError(f"the type hint {hint!r} has no message structure: declare one")


def _annotated(schema: Mapping[str, object], notes: Iterable[object]) -> Mapping[str, object]:
    bounded = dict(schema)
    for note in notes:
        if isinstance(note, Range):
            bounds = {"minimum": note.minimum, "maximum": note.maximum}
            bounded |= {key: value for key, value in bounds.items() if value is not None}
        elif isinstance(note, Mapping):
            bounded |= note
    return bounded


def _tuple(arguments: tuple[Any, ...], depth: int) -> Mapping[str, object]:
    if len(arguments) == 2 and arguments[1] is Ellipsis:  # noqa: PLR2004 - tuple[X, ...]
        return {"type": "array", "items": schema_of(arguments[0], depth + 1)}
    count = len(arguments)
    return {
        "type": "array",
        "prefixItems": [schema_of(one, depth + 1) for one in arguments],
        "items": False,
        "minItems": count,
    }


def _fields_of(hint: Any) -> dict[str, tuple[Any, bool]] | None:
    """Return name to (hint, required) of a record type, None for any other."""
    if typing.is_typeddict(hint):
        hints = get_type_hints(hint, include_extras=True)
        return {name: (one, _is_required(hint, name, one)) for name, one in hints.items()}
    if isinstance(hint, type) and (dataclasses.is_dataclass(hint) or attrs.has(hint)):
        hints = get_type_hints(hint, include_extras=True)
        return {name: (one, True) for name, one in hints.items()}
    return None


def _is_required(record: Any, name: str, hint: Any) -> bool:
    if get_origin(hint) is NotRequired:
        return False
    return get_origin(hint) is Required or name in record.__required_keys__


def _object(fields: Mapping[str, tuple[Any, bool]], depth: int) -> Mapping[str, object]:
    return {
        "type": "object",
        "properties": {name: schema_of(hint, depth + 1) for name, (hint, _) in fields.items()},
        "required": [name for name, (_, required) in fields.items() if required],
        "additionalProperties": False,
    }
