"""ROS message definitions read without ROS: folders of `.msg`, `.srv`, `.action` and `.idl` files.

Structures are the very ones that the bridge describes for the same types where they are installed.
Needs no middleware; for `.idl` files the extra `definitions`, which brings the parser of rosbags.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from ctypes import c_float
from pathlib import Path
from typing import TYPE_CHECKING, Any

from attrs import field, frozen

from uoarm.bridge import install_command, shown, text_of
from uoarm.cdr import BASIC
from uoarm.errors import ConfigurationError
from uoarm.model import MessageStructure
from uoarm_ros2._message_file import (
    ParsedField,
    ParsedMessage,
    ParsedType,
    parse_file,
    require_one_each,
)
from uoarm_ros2._types import (
    EMPTY,
    ArrayType,
    RecordField,
    RecordType,
    ScalarType,
    Shape,
    StringType,
    integer_range,
    structure_of,
)

if TYPE_CHECKING:
    from rosbags.typesys.base import Message

__all__ = ["DefinitionReader", "RosDefinitions", "read_definitions"]

_KINDS = {".msg": "msg", ".srv": "srv", ".action": "action"}
_PARTS = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}
_MAX_FILES = 20_000
_MAX_OCTETS = 1 << 20
_MAX_DEPTH = 32
_MAX_FIELDS = 20_000
_INCLUDE = re.compile(r"^\s*#\s*include\b.*$", re.MULTILINE)


@frozen
class RosDefinitions:
    """What some folders define.

    Attributes:
        structures: by the name of the type: `sensor_msgs/msg/Imu`, `std_srvs/srv/Empty_Request`
            and `_Response`, `tf2_msgs/action/LookupTransform_Goal`, `_Result` and `_Feedback`.
        problems: what could not be read and why, by file or by the name of the type.
    """

    structures: Mapping[str, MessageStructure]
    problems: Mapping[str, str] = field(factory=dict)


def read_definitions(*folders: str | Path) -> RosDefinitions:
    """Read every definition below some folders, `package/msg/Name.msg` and alike.

    Reads files and nothing else. An `.idl` beside another file of the same name, as in installed
    packages, is passed over. Defaults of `.idl` files are not kept: the parser knows none. A type
    that cannot be read is a problem, and so is each that holds it, and no other. Of two definitions
    of one type the later is taken: that of the last folder.

    Raises:
        ConfigurationError: a folder is none, or holds too many files.
    """
    reading = DefinitionReader()
    for folder in folders:
        reading.take(Path(folder))
    return reading.definitions()


def types_of(path: Path) -> tuple[str, ...]:
    """Return the types that a file defines, by its name and its folders."""
    kind = _KINDS.get(path.suffix) or path.parent.name
    if kind not in _PARTS:
        kind = "msg"
    package = path.parent.parent if path.parent.name == kind else path.parent
    return tuple(f"{package.name}/{kind}/{path.stem}{ending}" for ending in _PARTS[kind])


@frozen
class _Part:
    """One message and the file that has it."""

    parsed: ParsedMessage
    path: Path


class DefinitionReader:
    """Definitions that were read, each turned into a record when it is asked for.

    Args:
        elsewhere: returns the record of a type that is taken from elsewhere, None for others.

    Attributes:
        problems: what could not be read and why, by file.
        unread: the same by the names of the types that the files would define.
        twice: the types of which there are two definitions: the files of both.
    """

    def __init__(self, elsewhere: Callable[[str], RecordType | None] = lambda _: None) -> None:
        self._elsewhere = elsewhere
        self._parts: dict[str, _Part] = {}
        self._records: dict[str, RecordType] = {}
        self._sizes: dict[str, int] = {}
        self.problems: dict[str, str] = {}
        self.unread: dict[str, str] = {}
        self.twice: dict[str, tuple[Path, Path]] = {}

    @property
    def names(self) -> list[str]:
        """The types that were read."""
        return list(self._parts)

    def __contains__(self, name: object) -> bool:
        return name in self._parts

    def take(self, folder: Path) -> None:
        """Parse the files of a folder."""
        if not os.path.isdir(folder):
            raise ConfigurationError(f"{folder} is no folder of ROS definitions")
        files = [path for path in sorted(folder.rglob("*")) if path.suffix in {*_KINDS, ".idl"}]
        if len(files) > _MAX_FILES:
            raise ConfigurationError(
                f"{folder} holds {len(files):,} definitions, more than {_MAX_FILES:,}"
            )
        sources = {path.with_suffix("") for path in files if path.suffix != ".idl"}
        for path in files:
            if path.suffix == ".idl" and path.with_suffix("") in sources:
                continue
            try:
                self._take_file(path)
            except ValueError as error:
                self._leave_out(path, str(error))
            except Exception as error:  # noqa: BLE001 - a parser of others, and files of others
                self._leave_out(path, text_of(error))

    def _take_file(self, path: Path) -> None:
        if path.stat().st_size > _MAX_OCTETS:
            raise ValueError(f"more than {_MAX_OCTETS:,} octets")
        if not path.is_file():  # but a pipe, on which this would wait
            raise ValueError("no regular file")
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".idl":
            for message in _idl_parser()(_INCLUDE.sub("", text)).specification():
                known = self._parts.get(message.name)
                self._keep(message.name, known or _Part(_converted(message), path), path)
            return
        names = types_of(path)
        for name, parsed in zip(names, parse_file(text, names), strict=True):
            self._keep(name, _Part(parsed, path), path)

    def _keep(self, name: str, part: _Part, path: Path) -> None:
        before = self._parts.get(name)
        if before is not None:
            self.twice.setdefault(name, (before.path, path))
        self._parts[name] = part
        self.unread.pop(name, None)

    def _leave_out(self, path: Path, why: str) -> None:
        """Note what is wrong with a file; an earlier file does not stand for the types of it."""
        self.problems[str(path)] = why[:500]
        for name in types_of(path):
            self._parts.pop(name, None)
            self.unread[name] = f"{path}: {why[:500]}"

    def leave_out_twice(self) -> None:
        """Take none of two definitions of one type, nor what holds it."""
        for name, (first, second) in self.twice.items():
            self._parts.pop(name, None)
            why = f"it is in {first} and in {second}; name a folder with one of them"
            self.unread.setdefault(name, why)

    def definitions(self) -> RosDefinitions:
        """Return the structures of all that was read."""
        structures: dict[str, MessageStructure] = {}
        problems = dict(self.problems)
        for name in sorted(self._parts):
            try:
                structures[name] = structure_of(self.record(name))
            except (ValueError, KeyError) as error:
                problems[name] = str(error)
        return RosDefinitions(structures, dict(sorted(problems.items())))

    def record(self, name: str, depth: int = 0) -> RecordType:
        """Return a type that the folders define, or what it holds.

        Raises:
            ValueError: it holds a type that is defined nowhere, or too much; with file and line.
        """
        if name in self._records:
            return self._records[name]
        if depth > _MAX_DEPTH:
            raise ValueError(f"{name}: nested more than {_MAX_DEPTH} deep")
        part = self._parts[name]
        fields = tuple(
            RecordField(member.name, self._shape(member, part, depth), _default(member))
            for member in part.parsed.members
            if member.name != EMPTY
        )
        size = 1 + sum(self._size(field.shape) for field in fields)
        if size > _MAX_FIELDS:
            raise ValueError(f"{name} has more than {_MAX_FIELDS:,} fields, those within counted")
        self._sizes[name] = size
        self._records[name] = RecordType(name, object, fields, part.parsed.constants)
        return self._records[name]

    def _shape(self, member: ParsedField, part: _Part, depth: int) -> Shape:
        kind = member.kind
        if isinstance(kind.element, str):
            place = f"{part.path}: line {member.line}" if member.line else str(part.path)
            element: ScalarType | StringType | RecordType = self._nested(kind.element, place, depth)
        else:
            element = kind.element
        return ArrayType(element, kind.size, fixed=kind.fixed) if kind.many else element

    def _nested(self, reference: str, place: str, depth: int) -> RecordType:
        found = self._elsewhere(reference)
        if found is not None:
            self._sizes[reference] = _count(found)
            return found
        if reference in self._parts:
            return self.record(reference, depth + 1)
        if reference in self.unread:
            raise ValueError(f"{place}: {reference} cannot be read: {self.unread[reference]}")
        header = "; ROS 2 spells it std_msgs/Header" if reference.endswith("/Header") else ""
        raise ValueError(
            f"{place}: {reference} is not defined in the folders; add that of its package{header}"
        )

    def _size(self, shape: Shape) -> int:
        if isinstance(shape, ArrayType):
            return self._size(shape.element)
        return self._sizes[shape.name] if isinstance(shape, RecordType) else 1


def _count(shape: Shape) -> int:
    """Return how many fields a shape has, those within counted."""
    if isinstance(shape, ArrayType):
        return _count(shape.element)
    return (
        1 + sum(_count(item.shape) for item in shape.fields) if isinstance(shape, RecordType) else 1
    )


def _idl_parser() -> Any:
    try:
        from rosbags.typesys.idl import IDLParser  # noqa: PLC0415 - of an extra
    except ImportError as error:
        command = install_command("uoarm-ros2", "definitions")
        raise ValueError(
            f".idl files are read with rosbags, which cannot be imported ({error}); install it "
            f"with {command}"
        ) from error
    return IDLParser


def _default(member: ParsedField) -> object:
    """Return a default as the installed types have it: arrays hold what fits into a float32."""
    value = member.default
    if member.kind.element == ScalarType("float32") and isinstance(value, list):
        return [c_float(element).value for element in value]
    return value


def _converted(message: Message) -> ParsedMessage:
    """Return a message of an `.idl` file, whose parser checks no value."""
    require_one_each([field.name for field in message.fields], "field")
    require_one_each([constant.name for constant in message.constants], "constant")
    constants = {
        constant.name: _checked(constant.typ.value, constant.name, constant.value)
        for constant in message.constants
    }
    return ParsedMessage(
        tuple(ParsedField(item.name, _kind(item)) for item in message.fields), constants
    )


def _kind(field: Any) -> ParsedType:
    kind = field.typ
    reference = kind.ref.name
    element: ScalarType | StringType | str
    if isinstance(reference, str):
        element = reference
    elif reference.value in {"string", "wstring"}:
        element = StringType(wide=reference.value == "wstring", bound=kind.str_size or None)
    elif reference.value in BASIC:
        element = ScalarType(reference.value)
    else:
        raise ValueError(f"{field.name} is of type {reference.value}, which ROS 2 does not have")
    cardinality = kind.cardinality.value
    return ParsedType(
        element, cardinality != "scalar", kind.size or None, fixed=cardinality == "array"
    )


def _checked(kind: str, name: str, value: object) -> object:
    """Return the value of a constant, which must be one of its type."""
    limits = integer_range(kind) if kind in BASIC else None
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind.startswith("float") and is_number:
        return float(value)  # type: ignore[arg-type]  # a number
    if limits is not None:
        if is_number and isinstance(value, int) and limits[0] <= value <= limits[1]:
            return value
    elif isinstance(value, bool if kind == "bool" else str):
        return value
    wanted = kind if limits is None else f"{kind}, {limits[0]} to {limits[1]}"
    raise ValueError(f"constant {name}: expected a value of {wanted}, got {shown(value)}")
