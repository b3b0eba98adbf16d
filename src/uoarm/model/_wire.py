"""Model values to JSON-ready data and back."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from enum import Enum
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, TypeVar, cast

import attrs

from uoarm.model._message import MessageStructure
from uoarm.model._plan import Reason, Rejection

if TYPE_CHECKING:
    from cattrs import Converter

__all__ = ["from_json", "to_json"]

T = TypeVar("T")

_MAX_CAUSES = 50
_MAX_DEPTH = 200
_SHOWN = 5
_LEAVES = frozenset({str, int, float, bool, type(None)})
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
    import cattrs  # noqa: PLC0415 - slow import

    if _is_deeper(data, _MAX_DEPTH):
        raise ValueError(f"{kind.__name__}: nested more than {_MAX_DEPTH} levels deep")
    try:
        return _converter().structure(data, kind)
    except cattrs.BaseValidationError as error:
        reports = cattrs.transform_error(error, format_exception=_say)
        more = f"; and {len(reports) - _SHOWN} more" if len(reports) > _SHOWN else ""
        raise ValueError(f"{kind.__name__}: {'; '.join(reports[:_SHOWN])}{more}") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"{kind.__name__}: {_say(error, kind)}") from error


def _plain(value: Any, causes: int) -> Any:
    # Most values of an endpoint or a structure are these: the rest asks much longer.
    kind = type(value)
    if kind in _LEAVES:
        return value
    if kind is dict:
        return {str(key): _plain(item, causes) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, MessageStructure):
        return {"schema": _plain(value.schema, causes), "native_type": value.native_type}
    if isinstance(value, Rejection):
        causes -= 1
        if causes <= 0 and value.because_of:
            value = attrs.evolve(value, reasons=(*value.reasons, _CUT), because_of=())
    names = _field_names(cast(Hashable, kind))
    if names is not None:
        return {name: _plain(getattr(value, name), causes) for name in names}
    if isinstance(value, Mapping):
        return {str(key): _plain(item, causes) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item, causes) for item in value]
    return value


@lru_cache(maxsize=256)
def _field_names(kind: type) -> tuple[str, ...] | None:
    """Return the names of an attrs class' fields, None for any other class."""
    return tuple(field.name for field in attrs.fields(kind)) if attrs.has(kind) else None


@cache
def _converter() -> Converter:
    """Take nothing for what it is not: no number for text, no text for a number."""
    import cattrs  # noqa: PLC0415 - slow import

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
    if not isinstance(data, list) or not all(isinstance(item, str) for item in data):
        raise TypeError("expected a string or a list of strings")
    return data


def _say(error: BaseException, kind: type | None) -> str:
    """One error of the converter as a sentence."""
    from cattrs import ForbiddenExtraKeysError  # noqa: PLC0415 - slow import

    if isinstance(error, ForbiddenExtraKeysError):
        return f"unknown fields {', '.join(sorted(error.extra_fields))}"
    if isinstance(error, KeyError):
        return f"the field {error} is missing"
    if isinstance(error, AttributeError):
        return f"expected the fields of {getattr(kind, '__name__', 'an object')}"
    return str(error)


def _is_deeper(data: Any, limit: int) -> bool:
    waiting: list[tuple[Any, int]] = [(data, 1)]
    while waiting:
        value, depth = waiting.pop()
        if isinstance(value, Mapping | list):
            if depth > limit:
                return True
            inner = value.values() if isinstance(value, Mapping) else value
            waiting.extend((item, depth + 1) for item in inner)
    return False


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
