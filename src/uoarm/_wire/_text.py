"""Messages as JSON text: octets as base64, no number that loses digits or becomes null.

The rule follows proto3's JSON mapping (https://protobuf.dev/programming-guides/json/) where a
value has no exact JSON number: NaN and the infinities are the strings "NaN", "Infinity" and
"-Infinity"; integers beyond 53 bits are decimal strings, so that JavaScript keeps every digit.
Those within 53 bits stay numbers.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Mapping
from typing import Any

import orjson
from pybase64 import b64encode

from uoarm._raised import contained, sentence_of
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import (
    MOST_OCTETS,
    Budget,
    BudgetUse,
    Message,
    count_names,
    items_of,
    plain_copy,
    read_json,
    scan_json,
)

# No JSON text holds this character as it is: in a string it is written as an escape.
_GAP = b"\0"
_PLACE = orjson.Fragment(b'"' + _GAP + b'"')
SAFE_INTEGER = 2**53 - 1
_OPTIONS = orjson.OPT_STRICT_INTEGER
_NUMPY = orjson.OPT_SERIALIZE_NUMPY
_PIECE = 8192
_AS_ZEROS = bytes.maketrans(b"123456789", b"000000000")
_RUN = re.compile(b"0+")
_WIDE_KINDS = "iu"
_WIDE_SIZE = 8


def dump_parts(
    message: Any, other: Callable[[Any], Any], option: int = 0
) -> tuple[bytes, list[bytes]]:
    """Return the skeleton of a message and the parts of its whole text, to be joined.

    Args:
        message: what to write.
        other: returns what the encoder can write for anything but octets.
        option: of orjson.

    Raises:
        TypeError: a value in it has no form.
    """
    octets: list[bytes] = []
    left = MOST_OCTETS

    def write(value: Any) -> Any:
        nonlocal left
        left -= buffer_octets(value)
        if left < 0:
            raise ValueError(f"its arrays have more than {MOST_OCTETS:,} octets")
        if is_octets(value):
            octets.append(b64encode(_in_one_piece(value)))
            return _PLACE
        return other(value)

    skeleton = orjson.dumps(message, default=write, option=option)
    if not octets:
        return skeleton, [skeleton]
    pieces = skeleton.split(_GAP)
    parts = [pieces[0]]
    for text, piece in zip(octets, pieces[1:], strict=True):
        parts += (text, piece)
    return skeleton, parts


def buffer_octets(value: Any) -> int:
    """Return what a buffer stands for: one of numpy may repeat a few octets without an end."""
    count: int = getattr(value, "nbytes", 0)
    return count or (len(value) if isinstance(value, bytes | bytearray) else 0)


def is_octets(value: Any) -> bool:
    """Say whether a value stands for octets: a buffer of bytes in one dimension."""
    if isinstance(value, bytes | bytearray | memoryview):
        return True
    return hasattr(value, "__array_interface__") and value.dtype == "uint8" and value.ndim == 1


def _in_one_piece(value: Any) -> Any:
    view = memoryview(value)
    return value if view.c_contiguous else view.tobytes()


_LAST_ID = re.compile(r'"id"\s*:\s*"([^"\\]+)"\s*}\s*\Z')
_LONGEST_ID = 200
_WIDE, _BELOW = b"0" * 20, b"-" + b"0" * 19


def read_text(text: str, spending: BudgetUse) -> Any:
    """Return the value that JSON text stands for; whole numbers are exact, of any size.

    Raises:
        ControlMessageError: it is not JSON, costs more than its budget, or gives a key twice in
            one object, of which readers of JSON take the one or the other.
    """
    spending.octets(len(text))  # characters: no more than the octets that the transport counted
    scan_json(text, spending)
    try:
        # orjson makes floats of integers beyond 64 bits.
        value = read_json(text) if _has_wide(text) else orjson.loads(text)
        if not _are_names_unique(text, value):
            read_json(text)  # which names the key
    except ValueError as error:
        raise ControlMessageError(f"not JSON: {error}") from error
    return value


def last_id(text: str) -> str | None:
    """Return the `id` with which a message ends that cannot be read; None: it ends otherwise."""
    found = _LAST_ID.search(text, max(0, len(text) - _LONGEST_ID))
    return found and found[1]


def _has_wide(text: str) -> bool:
    """Say whether there may be a whole number beyond 64 bits: 20 digits, or 19 below zero.

    What stands behind a point is none; what stands in a text is taken for one, which harms only
    the time.
    """
    digits = text.encode("utf-8", "surrogatepass").translate(_AS_ZEROS)
    if _BELOW in digits:
        return True
    place = digits.find(_WIDE)
    while place >= 0:
        if digits[place - 1 : place] != b".":
            return True
        run = _RUN.match(digits, place)
        place = digits.find(_WIDE, place if run is None else run.end())
    return False


def _are_names_unique(text: str, value: Any) -> bool:
    """Say whether no object of JSON text has a name twice, by how many there are.

    Lists are looked into only while there are objects that were not seen.
    """
    objects, colons = text.count("{"), text.count(":")  # within texts, too: there are no more
    names = 0
    waiting = [value]
    while waiting and objects:
        item = waiting.pop()
        if item.__class__ is dict:
            objects -= 1
            names += len(item)
            item = item.values()
        waiting += [part for part in item if part.__class__ is dict or part.__class__ is list]
    return names == colons or names == count_names(text)


def write_text(message: Message) -> bytes:
    """Return a message as JSON text in UTF-8; raises as `write_text_parts`."""
    return b"".join(write_text_parts(message))


def write_text_parts(message: Message, most: Budget | None = None) -> list[bytes]:
    """Return a message as JSON text in parts, to be joined with what stands around it.

    Args:
        message: what to write.
        most: what it may be; None: anything.

    Raises:
        MessageError: a value in it has no form in JSON, and the text says which type; or it is
            more than it may be.
    """
    try:
        try:
            skeleton, parts = dump_parts(message, _write_other, _OPTIONS)
        except (TypeError, ValueError):
            skeleton = b"null"
        # orjson writes NaN as null and refuses wide integers: then look at what is to be written.
        if b"null" in skeleton:
            skeleton, parts = dump_parts(_exact(message), _write_other, _OPTIONS)
        octets = sum(map(len, parts))
        if most is not None and octets > min(most.octets, most.elements):
            spending = BudgetUse(most)
            spending.octets(octets)
            if len(skeleton) > most.elements:
                scan_json(skeleton.decode(), spending)
    except BaseException as error:  # of a value's own methods, or of one that changes meanwhile
        why = sentence_of(contained(error))
        raise MessageError(f"the message has no form as JSON text: {why}") from error
    return parts


def _write_other(value: Any) -> Any:
    """Return what orjson can write in the place of a numeric buffer or a numpy value."""
    if isinstance(value, array):
        return _in_pieces(value, lambda piece: _write_list(piece.tolist()))
    if isinstance(value, Mapping):
        return items_of(value)
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
    return plain_copy(value, _exact_number)


def _exact_number(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else _name(value)
    if isinstance(value, bool):
        return value
    if isinstance(value, int):
        return value if -SAFE_INTEGER <= value <= SAFE_INTEGER else str(value)
    return value


def _name(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    return "Infinity" if value > 0 else "-Infinity"
