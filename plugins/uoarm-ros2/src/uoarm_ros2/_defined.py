"""Types that are installed nowhere here, from the folders of definitions that a bridge is given."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from attrs import evolve

from uoarm.errors import BridgeError, FailureReason
from uoarm_ros2._middleware import untyped_class
from uoarm_ros2._shape import Field, Listing, Record, Shape, shape_of
from uoarm_ros2._type_hash import type_hash
from uoarm_ros2._types import import_type, of_type, type_mistake
from uoarm_ros2.definitions import Reading

__all__ = ["DefinedTypes", "untyped_record"]


class DefinedTypes:
    """Message types of some folders; what they hold may be installed, and then is the installed.

    A file that cannot be read costs its own types, and those that hold them.

    Raises:
        ConfigurationError: a folder is none, or holds too many files.
    """

    def __init__(self, folders: Iterable[str]) -> None:
        self._lock = threading.Lock()
        self._found: dict[str, type] = {}
        self._reading: Reading | None = None
        for folder in folders:
            self._reading = self._reading or Reading(_installed)
            self._reading.take(Path(folder).expanduser().absolute())
        if self._reading is not None:
            self._reading.leave_out_twice()

    def find(self, name: str) -> type | None:
        """Return a class for a type, None where no folder defines it.

        Raises:
            BridgeError: its file cannot be read, it is defined twice, it holds a type that is
                neither defined nor installed, or too much; with file and line.
        """
        if self._reading is None:
            return None
        with self._lock:
            if name not in self._found:
                try:
                    record = _sound(self._reading, name)
                except ValueError as error:
                    text = f"{of_type(name)}as option definitions has it, cannot be used: {error}"
                    raise BridgeError(text, FailureReason.UNSUPPORTED) from error
                if record is None:
                    return None
                self._found[name] = untyped_record(record).native
            return self._found[name]


def untyped_record(record: Record) -> Record:
    """Return a record with a class of its own, through which serialised messages pass."""
    return _native(record, type_hash(record), {})


def _installed(name: str) -> Record | None:
    """Return the record of a type that is installed."""
    if type_mistake(name):
        return None
    try:
        return shape_of(import_type(name), name)
    except BridgeError as error:
        if error.reason is FailureReason.NOT_FOUND:
            return None
        raise


def _sound(reading: Reading, name: str) -> Record | None:
    """Return the record of a type, None where no folder defines it."""
    if name in reading.unread:
        raise ValueError(reading.unread[name])
    return reading.record(name) if name in reading else None


def _native(record: Record, definition: str, made: dict[str, Record]) -> Record:
    """Return a record with classes of its own throughout; only the outermost needs its hash."""
    if record.name in made:
        return made[record.name]
    fields = tuple(_field(field, made) for field in record.fields)
    slots = tuple(field.attribute for field in fields)
    native: Any = untyped_class(record.name, definition, {"__slots__": slots})
    native.described = Record(record.name, native, fields, record.constants, slots)
    made[record.name] = native.described
    return made[record.name]


def _field(field: Field, made: dict[str, Record]) -> Field:
    shape: Shape = field.shape
    if isinstance(shape, Record):
        shape = _native(shape, "", made)
    elif isinstance(shape, Listing) and isinstance(shape.element, Record):
        shape = evolve(shape, element=_native(shape.element, "", made))
    return evolve(field, attribute=f"_{field.name}", shape=shape)
