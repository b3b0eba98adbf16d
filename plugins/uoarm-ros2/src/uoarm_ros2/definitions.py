"""ROS message definitions read without ROS: folders of `.msg`, `.srv`, `.action` and `.idl` files.

Structures are the very ones that the bridge describes for the same types where they are installed.
Needs the extra `definitions`, which brings rosbags' parsers; no middleware.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from attrs import field, frozen

from uoarm.bridge import install_command
from uoarm.errors import ConfigurationError
from uoarm.model import MessageStructure
from uoarm_ros2._schema import structure_of
from uoarm_ros2._shape import Field, Listing, Record, Scalar, Shape, Text
from uoarm_ros2._type_hash import EMPTY

if TYPE_CHECKING:
    from rosbags.typesys.base import Constant, Message, Type

__all__ = ["Definitions", "Reading", "read_definitions"]

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
_TEXT = re.compile(r"^[ \t]*(w?)string(?:<=\d+)?(?:\[[^\]]*\])?[ \t]+(\w+)(.*)$", re.MULTILINE)
_INCLUDE = re.compile(r"^\s*#\s*include\b.*$", re.MULTILINE)
_SCALARS = frozenset({"bool", "byte", "float32", "float64"}) | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


@frozen
class Definitions:
    """What some folders define.

    Attributes:
        structures: by the name of the type: `sensor_msgs/msg/Imu`, `std_srvs/srv/Empty_Request`
            and `_Response`, `tf2_msgs/action/LookupTransform_Goal`, `_Result` and `_Feedback`.
        problems: what could not be read and why, by file or by the name of the type.
    """

    structures: Mapping[str, MessageStructure]
    problems: Mapping[str, str] = field(factory=dict)


def read_definitions(*folders: str | Path) -> Definitions:
    """Read every definition below some folders, `package/msg/Name.msg` and alike.

    Reads files and nothing else. An `.idl` beside another file of the same name, as in installed
    packages, is passed over. Defaults of `.idl` files are not kept: the parser knows none. A type
    that cannot be read is a problem, and so is each that holds it. Of two definitions of one type
    the later is taken: that of the last folder.

    Raises:
        ConfigurationError: a folder is none, holds too many files, or the extra is not installed.
    """
    reading = Reading()
    for folder in folders:
        reading.take(Path(folder))
    return reading.definitions()


def types_of(path: Path) -> tuple[str, ...]:
    """Return the types that a file defines, as its name and its folders tell."""
    kind = _KINDS.get(path.suffix) or path.parent.name
    if kind not in _PARTS:
        kind = "msg"
    package = path.parent.parent if path.parent.name == kind else path.parent
    return tuple(f"{package.name}/{kind}/{path.stem}{ending}" for ending in _PARTS[kind])


@frozen
class _Part:
    """One message of a file; `first` is the line of the file before its own first."""

    message: Message
    texts: Mapping[str, tuple[bool, str]]
    path: Path
    first: int = 0
    text: str = ""


class Reading:
    """Definitions that were read, each turned into a record when it is asked for.

    Args:
        elsewhere: returns the record of a type that is taken from elsewhere, None for others.

    Attributes:
        problems: what could not be read and why, by file.
        twice: the types of which there are two definitions: the files of both.
    """

    def __init__(self, elsewhere: Callable[[str], Record | None] = lambda _: None) -> None:
        try:
            from rosbags.typesys.idl import IDLParser  # noqa: PLC0415 - of an extra
            from rosbags.typesys.msg import MSGParser  # noqa: PLC0415 - of an extra
        except ImportError as error:
            command = install_command("uoarm-ros2", "definitions")
            raise ConfigurationError(
                f"ROS definitions are read with rosbags, which cannot be imported ({error}); "
                f"install it with {command}"
            ) from error
        self._parsers: tuple[Callable[[str], Any], Callable[[str], Any]] = (MSGParser, IDLParser)
        self._elsewhere = elsewhere
        self._parts: dict[str, _Part] = {}
        self._records: dict[str, Record] = {}
        self._sizes: dict[str, int] = {}
        self.problems: dict[str, str] = {}
        self.twice: dict[str, tuple[Path, Path]] = {}

    def __contains__(self, name: object) -> bool:
        return name in self._parts

    def take(self, folder: Path) -> None:
        """Parse the files of a folder."""
        if not folder.is_dir():
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
                self.problems[str(path)] = str(error)[:500]
            except Exception as error:  # noqa: BLE001 - a parser of others, and files of others
                self.problems[str(path)] = f"{type(error).__name__}: {error}"[:500]

    def _take_file(self, path: Path) -> None:
        if path.stat().st_size > _MAX_OCTETS:
            raise ValueError(f"more than {_MAX_OCTETS:,} octets")
        text = path.read_text(encoding="utf-8").replace("\r\n", "\n")
        if path.suffix == ".idl":
            for message in self._parsers[1](_INCLUDE.sub("", text)).specification():
                known = self._parts.get(message.name)
                self._keep(message.name, known or _Part(message, {}, path), path)
            return
        parts = re.split(r"^---[ \t]*$", text, flags=re.MULTILINE)
        names = types_of(path)
        if len(parts) != len(names):
            raise ValueError(f"{len(parts)} parts between lines of ---, not {len(names)}")
        first = 0
        for name, part in zip(names, parts, strict=True):
            message, texts = self._parse(name, part, first)
            self._keep(name, _Part(message, texts, path, first, part), path)
            first += part.count("\n")

    def _keep(self, name: str, part: _Part, path: Path) -> None:
        before = self._parts.get(name)
        if before is not None:
            self.twice.setdefault(name, (before.path, path))
        self._parts[name] = part

    def _parse(
        self, name: str, text: str, first: int
    ) -> tuple[Message, Mapping[str, tuple[bool, str]]]:
        """Return a message, and of its texts whether they are wide and what follows their names.

        The parser knows no wide texts and takes text that looks like a number for one.
        """
        texts = {found[2]: (bool(found[1]), found[3].strip()) for found in _TEXT.finditer(text)}
        narrow = _TEXT.sub(lambda found: found[0].replace("wstring", "string", 1), text)
        # The name matters to the parser for types of the same package alone.
        package, _, own = name.split("/")
        whole = f"MSG: {package}/msg/{own}\n{narrow}\n"
        parser = self._parsers[0](whole)
        try:
            (message,) = parser.specification()
        except Exception as error:
            end = parser.message(0).pos
            if end == len(whole):
                raise
            number = whole.count("\n", 0, end)
            line = whole.splitlines()[number].strip()
            raise ValueError(
                f"line {first + number}: {line!r:.100} is no field, constant or comment"
            ) from error
        return message._replace(name=name), texts

    def definitions(self) -> Definitions:
        """Return the structures of all that was read."""
        structures: dict[str, MessageStructure] = {}
        problems = dict(self.problems)
        for name in sorted(self._parts):
            try:
                structures[name] = structure_of(self.record(name))
            except (ValueError, KeyError) as error:
                problems[name] = str(error)
        return Definitions(structures, dict(sorted(problems.items())))

    def record(self, name: str, depth: int = 0) -> Record:
        """Return a type that the folders define, or what it holds.

        Raises:
            ValueError: it holds a type that is defined nowhere, or too much; with file and line.
        """
        if name in self._records:
            return self._records[name]
        if depth > _MAX_DEPTH:
            raise ValueError(f"{name}: nested more than {_MAX_DEPTH} deep")
        part = self._parts[name]
        message, texts = part.message, part.texts
        members = tuple(
            Field(one.name, one.name, self._shape(one.typ, one.name, part, depth), default)
            for one, default in _members(message, texts)
        )
        if len({one.name for one in members}) != len(members):
            raise ValueError(f"{part.path}: {name} has two fields of one name")
        size = 1 + sum(self._size(one.shape) for one in members)
        if size > _MAX_FIELDS:
            raise ValueError(f"{name} has more than {_MAX_FIELDS:,} fields, those within counted")
        constants = {one.name: _constant(one, texts) for one in message.constants}
        self._sizes[name] = size
        self._records[name] = Record(name, object, members, constants, ())
        return self._records[name]

    def _shape(self, kind: Type, name: str, part: _Part, depth: int) -> Shape:
        element = self._element(kind, name, part, depth)
        if kind.cardinality.value == "scalar":
            return element
        return Listing(element, kind.size or None, fixed=kind.cardinality.value == "array")

    def _element(self, kind: Type, name: str, part: _Part, depth: int) -> Scalar | Text | Record:
        reference: Any = kind.ref.name
        if isinstance(reference, str):
            return self._nested(reference, name, part, depth)
        plain = reference.value
        if plain in {"string", "wstring"}:
            wide = plain == "wstring" or part.texts.get(name, (False, ""))[0]
            return Text(wide=wide, bound=kind.str_size or None)
        if plain == "char":
            return Scalar("uint8")
        if plain not in _SCALARS:
            raise ValueError(f"{name} is of type {plain}, which ROS 2 does not have")
        return Scalar(plain)

    def _nested(self, reference: str, name: str, part: _Part, depth: int) -> Record:
        found = self._elsewhere(reference)
        if found is not None:
            self._sizes[reference] = _count(found)
            return found
        if reference not in self._parts:
            raise ValueError(
                f"{_place(part, name)}: {reference} is not defined in the folders; add that of "
                f"its package"
            )
        return self.record(reference, depth + 1)

    def _size(self, shape: Shape) -> int:
        if isinstance(shape, Listing):
            return self._size(shape.element)
        return self._sizes[shape.name] if isinstance(shape, Record) else 1


def _count(shape: Shape) -> int:
    """Return how many fields a shape has, those within counted."""
    if isinstance(shape, Listing):
        return _count(shape.element)
    return 1 + sum(_count(each.shape) for each in shape.fields) if isinstance(shape, Record) else 1


def _place(part: _Part, name: str) -> str:
    """Return the file and the line of a field; of an `.idl` the file alone."""
    wanted = re.compile(rf"\s*[^\s#]+\s+{name}\b")
    lines = enumerate(part.text.splitlines(), 1)
    at = next((number for number, line in lines if wanted.match(line)), 0)
    return f"{part.path}: line {part.first + at}" if at else str(part.path)


def _members(
    message: Message, texts: Mapping[str, tuple[bool, str]]
) -> Iterator[tuple[Any, object]]:
    """Yield the fields of a message and their defaults."""
    for one in message.fields:
        if one.name == EMPTY:
            continue
        reference: Any = one.typ.ref.name
        default: Any = one.value
        if default is not None and not isinstance(reference, str):
            if isinstance(default, list):
                default = [_typed(reference.value, each) for each in default]
                if reference.value == "float32":
                    default = [struct.unpack("f", struct.pack("f", each))[0] for each in default]
            elif one.name in texts:
                default = _unquoted(texts[one.name][1])
            else:
                default = _typed(reference.value, default)
        yield one, default


def _constant(constant: Constant, texts: Mapping[str, tuple[bool, str]]) -> object:
    if constant.name in texts:
        return _unquoted(texts[constant.name][1].removeprefix("=").strip())
    return _typed(constant.typ.value, constant.value)


def _typed(kind: str, value: Any) -> object:
    """Return a value as one of its type: the parser tells integers, numbers and words by looks."""
    if kind in {"float32", "float64"}:
        return float(value)
    if kind == "bool":
        return bool(value)
    return value


def _unquoted(text: str) -> str:
    """Return the text of a default or constant, which may be quoted or have a comment after it."""
    quote = text[:1]
    if quote in {"'", '"'}:
        end = re.match(rf"{quote}((?:\\.|[^\\{quote}])*){quote}", text)
        if end:
            return re.sub(r"\\(.)", r"\1", end[1])
    return text.split("#", 1)[0].strip()
