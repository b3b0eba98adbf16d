"""Where types come from: installed packages, folders of definitions, nodes that describe them.

A description is what `type_description_interfaces/srv/GetTypeDescription` replies, as a message.
It comes from another process: names are checked before they reach generated code, and sizes before
work.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any

from attrs import define, evolve, field

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Message
from uoarm.plugins import expanded
from uoarm_ros2._middleware import Peer, untyped_class
from uoarm_ros2._options import TF_MESSAGE
from uoarm_ros2._types import (
    BOUNDED_TEXTS,
    EMPTY,
    KINDS,
    NESTED,
    SCALARS,
    TEXTS,
    ArrayType,
    RecordField,
    RecordType,
    ScalarType,
    Shape,
    StringType,
    import_type,
    of_type,
    shape_of,
    type_hash,
    type_mistake,
)
from uoarm_ros2.definitions import DefinitionReader

_FIELD = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,254}")
_MOST_TYPES = 256
_MOST_FIELDS = 4096
_MOST_DEPTH = 32


def described_type(description: Message, name: str, definition: str) -> type:
    """Return a class for a type of which there is only a description.

    Args:
        description: a `TypeDescription` as a message.
        name: of the type that was asked for.
        definition: the hash of its definition.

    Raises:
        BridgeError: the description is none of this type, or is more than is taken.
    """
    reading = _DescriptionReader(description, name)
    return _untyped(reading.record(name, 0), definition)


class _DescriptionReader:
    """One description; the types that it refers to are read where they are used."""

    def __init__(self, description: Message, name: str) -> None:
        self._name = name
        referenced = description["referenced_type_descriptions"]
        if len(referenced) > _MOST_TYPES:
            raise self._refused(f"it refers to {len(referenced)} types, more than {_MOST_TYPES}")
        own = description["type_description"]
        self._types = {item["type_name"]: item["fields"] for item in (*referenced, own)}
        self._left = _MOST_FIELDS

    def record(self, name: str, depth: int) -> RecordType:
        """Return the shape of one of the types."""
        fields = self._types.get(name)
        if fields is None:
            raise self._refused(f"{name} is not in it")
        if type_mistake(name):
            raise self._refused(type_mistake(name))
        if depth > _MOST_DEPTH:
            raise self._refused(f"nested more than {_MOST_DEPTH} deep")
        self._left -= len(fields)
        if self._left < 0:
            raise self._refused(f"more than {_MOST_FIELDS} fields")
        read = tuple(self._field(field, depth) for field in fields if field["name"] != EMPTY)
        if len({field.name for field in read}) != len(read):
            raise self._refused(f"{name} has two fields of one name")
        return RecordType(name, object, read, {})

    def _field(self, field: Mapping[str, Any], depth: int) -> RecordField:
        name = field["name"]
        if not _FIELD.fullmatch(name):
            raise self._refused(f"a field is called {name!r:.60}")
        return RecordField(name, self._shape(field["type"], depth))

    def _shape(self, kind: Mapping[str, Any], depth: int) -> Shape:
        many, number = divmod(kind["type_id"] - 1, KINDS)
        element = self._element(number + 1, kind, depth)
        if many == 0:
            return element
        if many == 1:
            return ArrayType(element, kind["capacity"], fixed=True)
        return ArrayType(element, kind["capacity"] if many == 2 else None)  # noqa: PLR2004 - bounded

    def _element(
        self, number: int, kind: Mapping[str, Any], depth: int
    ) -> ScalarType | StringType | RecordType:
        if number == NESTED:
            return self.record(kind["nested_type_name"], depth + 1)
        if number in TEXTS:
            bound = kind["string_capacity"] if number in BOUNDED_TEXTS else None
            return StringType(wide=TEXTS[number], bound=bound)
        if number in SCALARS:
            return ScalarType(SCALARS[number])
        raise self._refused(f"there is a field of the type number {kind['type_id']}")

    def _refused(self, why: str) -> BridgeError:
        text = f"the description of {self._name} that its node gives cannot be used: {why}"
        return BridgeError(text, FailureReason.UNSUPPORTED)


class DefinedTypes:
    """Message types of some folders; what they hold may be installed, and then is the installed.

    A file that cannot be read costs its own types, and those that hold them.

    Raises:
        ConfigurationError: a folder is none, or holds too many files.
    """

    def __init__(self, folders: Iterable[str]) -> None:
        self._lock = threading.Lock()
        self._found: dict[str, type] = {}
        self._reading: DefinitionReader | None = None
        for folder in folders:
            self._reading = self._reading or DefinitionReader(_installed)
            self._reading.take(expanded(folder).absolute())
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
                self._found[name] = untyped(record)
            return self._found[name]


def untyped(record: RecordType) -> type:
    """Return a class for a record, through which serialised messages pass."""
    return _untyped(record, type_hash(record))


def _untyped(record: RecordType, definition: str) -> type:
    native: Any = untyped_class(record.name, definition, {})
    native.described = evolve(record, native=native)
    made: type = native
    return made


def _installed(name: str) -> RecordType | None:
    """Return the record of a type that is installed."""
    if type_mistake(name):
        return None
    try:
        return shape_of(import_type(name), name)
    except BridgeError as error:
        if error.reason is FailureReason.NOT_FOUND:
            return None
        raise


def _sound(reading: DefinitionReader, name: str) -> RecordType | None:
    """Return the record of a type, None where no folder defines it."""
    if name in reading.unread:
        raise ValueError(reading.unread[name])
    return reading.record(name) if name in reading else None


DESCRIPTION_SERVICE = "type_description_interfaces/srv/GetTypeDescription"
_MOST_KEPT = 4_096
_TRANSFORM = "geometry_msgs/msg/TransformStamped"


@cache  # what a class is made of is never given back
def tf_message() -> type:
    """Return the class for `tf2_msgs/msg/TFMessage`, which no index of packages has."""
    element = shape_of(import_type(_TRANSFORM), _TRANSFORM)
    field = RecordField("transforms", ArrayType(element))
    return untyped(RecordType(TF_MESSAGE, object, (field,), {}))


@define(eq=False, slots=False)
class TypeFinder:
    """Finds the classes of message types; what nodes described is kept by its hash.

    Args:
        ask: asks the node of a full name for the description of a type; raises BridgeError.
        defined: what the folders of the bridge define.
    """

    _ask: Callable[[str, Message], Message]
    _peers: Callable[[str], Iterable[Peer]]
    _defined: DefinedTypes
    _lock: threading.Lock = field(factory=threading.Lock, init=False)
    _described: dict[tuple[str, str], type] = field(factory=dict, init=False)

    def find(self, name: str, topic: str) -> type:
        """Return the class of a type that a topic carries; blocks while nodes are asked.

        Raises:
            BridgeError: its package is not installed, no folder defines it whole, and no node on
                the topic describes it.
        """
        try:
            return import_type(name)
        except BridgeError as error:
            if error.reason is not FailureReason.NOT_FOUND:
                raise
            missing = error
        defined = self._defined.find(name)
        if defined is not None:
            return defined
        if name == TF_MESSAGE:
            return tf_message()
        asked: list[str] = []
        for peer in self._peers(topic):
            if peer.type != name or not peer.definition:
                continue
            key = name, peer.definition
            with self._lock:
                known = self._described.get(key)
            if known is not None:
                return known
            try:
                self._require_room()
                made = self._from(peer)
            except BridgeError as error:
                asked.append(f"{peer.node} does not describe it ({error})")
                continue
            with self._lock:
                return self._described.setdefault(key, made)
        why = "; ".join(asked) or "no node on its topic describes it"
        text = f"{missing}; {why}; option definitions takes folders of .msg files"
        raise BridgeError(text, FailureReason.NOT_FOUND) from missing

    def _require_room(self) -> None:
        """Raise BridgeError where no more types are kept: what a class is made of stays for good.

        So none is forgotten in favour of another.
        """
        with self._lock:
            if len(self._described) >= _MOST_KEPT:
                text = f"{_MOST_KEPT} types are known from nodes already, which is the most"
                raise BridgeError(text, FailureReason.REFUSED)

    def _from(self, peer: Peer) -> type:
        request = {
            "type_name": peer.type,
            "type_hash": peer.definition,
            "include_type_sources": False,
        }
        reply = self._ask(peer.node, request)
        if not reply["successful"]:
            text = f"it says {reply['failure_reason']!r:.200}"
            raise BridgeError(text, FailureReason.REFUSED)
        return described_type(reply["type_description"], peer.type, peer.definition)
