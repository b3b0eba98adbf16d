"""Messages as JSON text: octets as base64, no number that loses digits or becomes null.

The rule follows proto3's JSON mapping (https://protobuf.dev/programming-guides/json/) where a
value has no exact JSON number: NaN and the infinities are the strings "NaN", "Infinity" and
"-Infinity"; integers beyond 53 bits are decimal strings, so that JavaScript keeps every digit.
Those within 53 bits stay numbers.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping
from typing import Any

import orjson

from uoarm._wire._skeleton import dump_parts
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Message, Spending, scan_json

__all__ = ["SAFE_INTEGER", "read_text", "write_text", "write_text_parts"]

SAFE_INTEGER = 2**53 - 1
_OPTIONS = orjson.OPT_STRICT_INTEGER
_NUMPY = orjson.OPT_SERIALIZE_NUMPY
_PIECE = 8192
_WIDE_KINDS = "iu"
_WIDE_SIZE = 8


def read_text(text: str, spending: Spending) -> Any:
    """Return the value that JSON text stands for.

    Raises:
        ControlMessageError: it is not JSON, or costs more than its budget.
    """
    spending.octets(len(text))  # characters: no more than the octets that the transport counted
    scan_json(text, spending)
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise ControlMessageError(f"not JSON: {error}") from error


def write_text(message: Message) -> bytes:
    """Return a message as JSON text in UTF-8; raises as `write_text_parts`."""
    return b"".join(write_text_parts(message))


def write_text_parts(message: Message) -> list[bytes]:
    """Return a message as JSON text in parts, to be joined with what stands around it.

    Raises:
        MessageError: a value in it has no form in JSON; the text says which type.
    """
    try:
        skeleton, parts = dump_parts(message, _write_other, _OPTIONS)
        if b"null" not in skeleton:
            return parts
    except (TypeError, ValueError):
        pass
    # orjson writes NaN as null and refuses wide integers: then look at what is to be written.
    try:
        return dump_parts(_exact(message), _write_other, _OPTIONS)[1]
    except (TypeError, ValueError, RecursionError) as error:
        raise MessageError(f"the message has no form as JSON text: {error}") from error


def _write_other(value: Any) -> Any:
    """Return what orjson can write in the place of a numeric buffer or a numpy value."""
    if isinstance(value, array):
        return _in_pieces(value, lambda piece: _write_list(piece.tolist()))
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "__array_interface__"):
        return _write_numpy(value)
    raise TypeError(f"a value of type {type(value).__name__}")


def _write_numpy(value: Any) -> Any:
    if value.ndim == 0:
        return _exact(value.item())
    if value.ndim == 1 and value.size > _PIECE:
        return _in_pieces(value, lambda piece: orjson.dumps(_write_numpy(piece), option=_NUMPY))
    wide = value.dtype.kind in _WIDE_KINDS and value.dtype.itemsize == _WIDE_SIZE
    too_wide = wide and value.size and max(-int(value.min()), int(value.max())) > SAFE_INTEGER
    # Some versions of orjson take foreign byte orders for their own.
    if value.dtype.isnative and not too_wide:
        try:
            text = orjson.dumps(value, option=_NUMPY)
        except TypeError:  # a layout or a type that orjson leaves to us
            return _exact(value.tolist())
        if b"null" not in text:
            return orjson.Fragment(text)
    return _exact(value.tolist())


def _in_pieces(numbers: Any, write: Callable[[Any], bytes]) -> orjson.Fragment:
    """Write an array a piece at a time: within one the encoder keeps the interpreter's lock."""
    texts = (
        write(numbers[start : start + _PIECE])[1:-1] for start in range(0, len(numbers), _PIECE)
    )
    return orjson.Fragment(b"[" + b",".join(texts) + b"]")


def _write_list(numbers: list[Any]) -> bytes:
    try:
        text = orjson.dumps(numbers, option=_OPTIONS)
    except TypeError:  # an integer beyond 53 bits
        return orjson.dumps(_exact(numbers))
    return orjson.dumps(_exact(numbers)) if b"null" in text else text


def _exact(value: Any) -> Any:
    """Return a copy in which every number that JSON cannot hold exactly is a string."""
    if isinstance(value, float):
        return value if math.isfinite(value) else _name(value)
    if isinstance(value, bool):
        return value
    if isinstance(value, int):
        return value if -SAFE_INTEGER <= value <= SAFE_INTEGER else str(value)
    if isinstance(value, Mapping):
        return {key: _exact(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_exact(item) for item in value]
    return value


def _name(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    return "Infinity" if value > 0 else "-Infinity"
