"""Model values to JSON-ready data and back."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from functools import cache
from typing import Any, TypeVar

import attrs
import cattrs

from uoarm.model._plan import Reason, Rejection
from uoarm.model._structure import MessageStructure

__all__ = ["from_json", "to_json"]

T = TypeVar("T")

_MAX_CAUSES = 50
_SHOWN = 5
_CUT = Reason("its own causes lie too deep to be written down")


def to_json(value: Any) -> Any:
    """Return a model value as dicts, lists, strings, numbers, booleans and None.

    Rejections nested more than 50 deep end in a reason that says so; what is no model value, such
    as octets in a message, is left as it is.
    """
    return _plain(value, _MAX_CAUSES)


def from_json(data: Any, kind: type[T]) -> T:
    """Return the model value that `to_json` made data of.

    Raises:
        ValueError: the data is of another shape; the text names the first few fields.
    """
    try:
        return _converter().structure(data, kind)
    except cattrs.BaseValidationError as error:
        told = cattrs.transform_error(error)
        more = f"; and {len(told) - _SHOWN} more" if len(told) > _SHOWN else ""
        raise ValueError(f"{kind.__name__}: {'; '.join(told[:_SHOWN])}{more}") from error
    except (cattrs.StructureHandlerNotFoundError, TypeError, ValueError) as error:
        raise ValueError(f"{kind.__name__}: {error}") from error
    except RecursionError:
        raise ValueError(f"{kind.__name__}: the data is nested too deeply") from None


def _plain(value: Any, causes: int) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, MessageStructure):
        return {"schema": _plain(value.schema, causes), "native_type": value.native_type}
    if isinstance(value, Rejection):
        causes -= 1
        if causes <= 0 and value.because_of:
            value = attrs.evolve(value, reasons=(*value.reasons, _CUT), because_of=())
    if attrs.has(type(value)):
        fields = attrs.fields(type(value))
        return {one.name: _plain(getattr(value, one.name), causes) for one in fields}
    if isinstance(value, Mapping):
        return {str(key): _plain(one, causes) for key, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(one, causes) for one in value]
    return value


@cache
def _converter() -> cattrs.Converter:
    """Take nothing for what it is not: no number for text, no text for a number."""
    converter = cattrs.Converter(forbid_extra_keys=True)
    for kind in (str, int, bool):
        converter.register_structure_hook(kind, _exactly)
    converter.register_structure_hook(float, lambda data, _: float(_number(data)))
    converter.register_structure_hook_func(
        lambda kind: kind is object or kind is Any, lambda data, _: data
    )
    converter.register_structure_hook_func(
        lambda kind: kind == str | tuple[str, ...],
        lambda data, _: data if isinstance(data, str) else tuple(_texts(data)),
    )
    converter.register_structure_hook_func(
        lambda kind: getattr(kind, "__args__", ()) == (str, object),
        lambda data, _: dict(_mapping(data)),
    )
    converter.register_structure_hook(MessageStructure, lambda data, _: _structure(data))
    return converter


def _exactly(data: Any, kind: type) -> Any:
    if type(data) is not kind:
        raise TypeError(f"expected {kind.__name__}, got {type(data).__name__}")
    return data


def _number(data: Any) -> int | float:
    if isinstance(data, bool) or not isinstance(data, int | float):
        raise TypeError(f"expected a number, got {type(data).__name__}")
    return data


def _texts(data: Any) -> list[str]:
    if not isinstance(data, list) or not all(isinstance(one, str) for one in data):
        raise TypeError("expected a string or a list of strings")
    return data


def _mapping(data: Any) -> Mapping[str, object]:
    if not isinstance(data, Mapping):
        raise TypeError(f"expected a mapping, got {type(data).__name__}")
    return data


def _structure(data: Any) -> MessageStructure:
    parts = _mapping(data)
    if parts.keys() != {"schema", "native_type"}:
        raise ValueError(f"expected schema and native_type, got {', '.join(parts) or 'neither'}")
    schema, native_type = parts["schema"], parts["native_type"]
    if not isinstance(schema, Mapping | bool) or not isinstance(native_type, str):
        raise TypeError("expected schema to be a mapping or a boolean and native_type a string")
    return MessageStructure(schema, native_type=native_type)
