"""From messages to native objects: one generated function per type, every value checked.

The generated text checks the common case in line. Whatever it cannot take at a glance goes to a
checker; when that fails, the message is walked once more, slowly, to name the field.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import count

from uoarm.errors import MessageError
from uoarm.model import Message
from uoarm_ros2._arrays import taker
from uoarm_ros2._checks import Misfit, checker, shown
from uoarm_ros2._generate import Source
from uoarm_ros2._schema import FLOAT32_MAX, integer_range
from uoarm_ros2._shape import Listing, Record, Scalar, Shape, Text

__all__ = ["writer"]


def writer(record: Record) -> Callable[[Message], object]:
    """Return the function that makes a native object of a message.

    It raises MessageError with the path of the field that is missing, unknown or unfit. Buffers
    are not copied: the native object is good until the message changes.
    """
    build = _builder(record)

    def write(message: Message) -> object:
        try:
            return build(message)
        except (Misfit, KeyError, TypeError, AttributeError) as error:
            raise _explained(record, message, error) from None

    return write


@lru_cache(maxsize=1024)
def _builder(record: Record) -> Callable[[Message], object]:
    source = Source("build", "message")
    root = _record(record, "message", source, count())
    source.line(f"return {root}")
    return source.function()


def _record(record: Record, place: str, source: Source, fresh: count[int]) -> str:
    number = next(fresh)
    native, given, value = f"n{number}", f"m{number}", f"v{number}"
    make = source.constant(record.native.__new__)
    source.line(f"{given} = {place}")
    source.line(f"if len({given}) != {len(record.fields)}: raise KeyError")
    source.line(f"{native} = {make}({source.constant(record.native)})")
    if "_check_fields" in record.slots:
        source.line(f"{native}._check_fields = False")
    for field in record.fields:
        target = f"{native}.{field.attribute}"
        item = f"{given}[{field.name!r}]"
        if isinstance(field.shape, Record):
            source.line(f"{target} = {_record(field.shape, item, source, fresh)}")
        elif isinstance(field.shape, Listing):
            source.line(f"{target} = {source.constant(_listing(field.shape))}({item})")
        else:
            source.line(f"{value} = {item}")
            source.line(f"if {_doubt(field.shape, value)}:")
            source.line(f"{value} = {source.constant(checker(field.shape))}({value})", depth=2)
            source.line(f"{target} = {value}")
    return native


def _doubt(shape: Scalar | Text, value: str) -> str:
    """Return the expression that is true unless the value is plainly fit."""
    if isinstance(shape, Text):
        doubt = f"type({value}) is not str or not {value}.isascii() or '\\0' in {value}"
        return doubt if shape.bound is None else f"{doubt} or len({value}) > {shape.bound}"
    if shape.name == "bool":
        return f"type({value}) is not bool"
    if shape.name == "byte":
        return "True"
    limits = integer_range(shape.name)
    if limits is not None:
        return f"type({value}) is not int or not {limits[0]} <= {value} <= {limits[1]}"
    if shape.name == "float32":
        limit = float(FLOAT32_MAX)
        return f"type({value}) is not float or not {-limit!r} <= {value} <= {limit!r}"
    return f"type({value}) is not float"


def _listing(listing: Listing) -> Callable[[Message], object]:
    if not isinstance(listing.element, Record):
        return taker(listing)
    build, size, fixed = _builder(listing.element), listing.size, listing.fixed

    def take(value: Message) -> object:
        if not isinstance(value, list | tuple):
            raise Misfit(f"expected an array of objects, got {shown(value)}")
        if size is not None and (len(value) != size if fixed else len(value) > size):
            bound = f"{'' if fixed else 'at most '}{size}"
            raise Misfit(f"expected {bound} elements, got {len(value)}")
        return [build(item) for item in value]

    return take


def _explained(record: Record, message: Message, error: Exception) -> MessageError:
    """Return the error that names the field on which the generated function stumbled."""
    found = _fault(record, message, "")
    if found is None:
        return MessageError(f"{record.name}: {type(error).__name__}: {error}")
    path, cause = found
    return MessageError(f"{record.name}: field {path or '(the whole message)'}: {cause}")


def _fault(shape: Shape, value: Message, path: str) -> tuple[str, str] | None:
    if isinstance(shape, Record):
        return _record_fault(shape, value, path)
    try:
        if not isinstance(shape, Listing):
            checker(shape)(value)
        elif not isinstance(shape.element, Record):
            taker(shape)(value)
        else:
            return _elements_fault(shape, shape.element, value, path)
    except Misfit as misfit:
        place, _, cause = str(misfit).partition(" ")
        if place.startswith("["):
            return path + place, cause
        return path, str(misfit)
    return None


def _record_fault(record: Record, value: Message, path: str) -> tuple[str, str] | None:
    if not isinstance(value, Mapping):
        return path, f"expected an object ({record.name}), got {shown(value)}"
    names = [field.name for field in record.fields]
    unknown = sorted(str(name) for name in value if name not in names)
    if unknown:
        place = f"{path}.{unknown[0]}".lstrip(".")
        return place, f"{record.name} has no such field, only {', '.join(names) or 'none'}"
    for field in record.fields:
        place = f"{path}.{field.name}".lstrip(".")
        if field.name not in value:
            return place, "missing; ROS 2 messages carry every field"
        found = _fault(field.shape, value[field.name], place)
        if found is not None:
            return found
    return None


def _elements_fault(
    listing: Listing, element: Record, value: Message, path: str
) -> tuple[str, str] | None:
    if isinstance(value, list | tuple):
        for index, item in enumerate(value):
            found = _record_fault(element, item, f"{path}[{index}]")
            if found is not None:
                return found
    _listing(listing)(value)
    return None
