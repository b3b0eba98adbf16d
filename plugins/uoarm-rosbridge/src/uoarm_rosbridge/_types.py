"""Types of ROS: their names, how rosapi describes them, and what clients send of them.

Messages come by name or, as rosbridge allows, as a list in order, and not always whole.
A type of ROS has three spellings: `std_msgs/msg/String` of topics, `std_msgs/String` of ROS 1 and
of descriptions, `std_msgs/String` with more slashes. Which of them a client takes makes no
difference.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from attrs import frozen

from uoarm.cdr import BASIC, basic_type
from uoarm.errors import MessageError, UsageError
from uoarm.model import Message, MessageStructure
from uoarm.server.front_end import TEXT_FORM, Read, read_message

_MOST = 200
_VARIABLE, _SINGLE = 0, -1
_RULE = "=" * 80
_ROS_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Z][A-Za-z0-9_]*)")
_SHORT_TYPE = re.compile(r"([a-z][a-z0-9_]*)/([A-Z][A-Za-z0-9_]*)")
_REQUEST = re.compile(r"([a-z][a-z0-9_]*/(?:srv|action)/\w+?)_(?:Request|Goal)")
# How the Python of ROS 2, and so rosapi, calls what a message file calls otherwise.
_IN_PYTHON = {
    "bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double",
}  # fmt: skip
_ZEROS = {"bool": "False", "byte": repr(b"\0"), "string": "", "wstring": ""}
_OF_ROSAPI = "rosapi"  # the package of ROS 1, in ROS 2 rosapi_msgs


@frozen
class _Member:
    """A field: the basic type of its elements, or the name of theirs; `length` as rosapi has it."""

    name: str
    kind: str
    length: int
    schema: object


@frozen
class _Record:
    """A message type: what it is called and made of."""

    name: str
    is_ros: bool
    members: tuple[_Member, ...]
    constants: Mapping[str, object]


def type_name(structure: MessageStructure, function: str) -> str:
    """Return the native name of a type, or one made of the function's name."""
    return structure.native_type or f"uoarm/{function}"


def service_type(request: MessageStructure, function: str) -> str:
    """Return the name of the type of a service or an action, whose request or goal this is."""
    name = type_name(request, function)
    found = _REQUEST.fullmatch(name)
    return found[1] if found else name


def check_type(what: str, stated: str, actual: str) -> None:
    """Refuse another type than that of ROS 2; elsewhere clients call types what they like.

    Raises:
        MessageError: it is another one; `what` is the topic, service or action.
    """
    if stated and _ROS_TYPE.fullmatch(actual) and not is_same_type(stated, actual):
        raise MessageError(f"{what} has the type {actual!r}, not {stated!r:.100}")


def is_same_type(one: str, other: str) -> bool:
    """Say whether two names are of one type; ROS 1 clients leave the `/msg` or `/srv` out."""
    if one == other:
        return True
    (package, kind, name), (package_2, kind_2, name_2) = _parts(one), _parts(other)
    same_kind = kind == kind_2 or not (kind and kind_2)
    return bool(package) and same_kind and (package, name) == (package_2, name_2)


class TopicType:
    """The type of a topic of one client: as it stated it, and as it is once that is known.

    Args:
        name: of the topic.
        stated: with the first message about it; empty: nothing.
    """

    def __init__(self, name: str, stated: str) -> None:
        self._topic = f"topic {name!r}"
        self._stated = stated
        self._actual = ""

    def find(self, actual: str) -> None:
        """Take in what it is; raises MessageError as `check_type`."""
        check_type(self._topic, self._stated, actual)
        self._actual = actual

    def check(self, kind: str) -> None:
        """Refuse another type, stated later; raises MessageError."""
        check_type(self._topic, kind, self._actual)
        if kind and self._stated and not is_same_type(kind, self._stated):
            raise MessageError(f"{self._topic} has the type {self._stated!r}, not {kind!r:.100}")


def in_full(name: str, kind: str, ending: str = "") -> str:
    """Return the name of a type of ROS 2 as its packages have it; empty: it is none of this kind.

    Args:
        name: as a client spells it.
        kind: `msg`, `srv` or `action`.
        ending: of the part that is wanted, `_Request` or the like.
    """
    package, stated, own = _parts(name)
    full = f"{package}/{kind}/{own}{ending}"
    return full if stated in {"", kind} and _ROS_TYPE.fullmatch(full) else ""


def typedefs(structure: MessageStructure, function: str) -> list[dict[str, Any]]:
    """Return the definitions of a message type and the types within it, outermost first."""
    return [
        {
            "type": _short(record.name),
            "fieldnames": [member.name for member in record.members],
            "fieldtypes": [_field_type(record, member) for member in record.members],
            "fieldarraylen": [member.length for member in record.members],
            "examples": [_example(member) for member in record.members],
            "constnames": list(record.constants),
            "constvalues": [str(value) for value in record.constants.values()],
        }
        for record in _records(structure, function)
    ]


def full_text(structure: MessageStructure, function: str) -> str:
    """Return a type as the text of a message file and, after rules, of those within it."""
    texts = list[str]()
    for record in _records(structure, function):
        head = f"{_RULE}\nMSG: {_short(record.name)}\n" if texts else ""
        lines = (
            f"{_short(member.kind)}{_brackets(member)} {member.name}\n" for member in record.members
        )
        texts.append(head + "".join(lines))
    return "".join(texts)


def part_within(structure: MessageStructure, name: str) -> MessageStructure | None:
    """Return the structure of a type that a message holds somewhere; None: it holds none."""
    for record in _records(structure, ""):
        for member in record.members:
            if is_same_type(member.kind, name) and isinstance(member.schema, Mapping):
                return MessageStructure(member.schema, native_type=member.kind)
    return None


def _records(structure: MessageStructure, function: str) -> Iterator[_Record]:
    """Yield a message type and those within it, each once, in the order in which rosapi does."""
    waiting: list[tuple[str, object]] = [(type_name(structure, function), structure.schema)]
    seen: set[str] = set()
    while waiting and len(seen) < _MOST:
        name, schema = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        members = tuple(
            _member(f"{name}/{field}", field, inner) for field, inner in _properties(schema).items()
        )
        constants = schema.get("x-constants", {}) if isinstance(schema, Mapping) else {}
        yield _Record(name, _ROS_TYPE.fullmatch(name) is not None, members, constants)
        inner = [(member.kind, member.schema) for member in members if _is_record(member.schema)]
        waiting += reversed(inner)


def _member(place: str, field: str, schema: object) -> _Member:
    if not isinstance(schema, Mapping):
        return _Member(field, place, _SINGLE, schema)
    if schema.get("type") == "array":
        fixed = schema.get("minItems")
        length = fixed if fixed == schema.get("maxItems") and isinstance(fixed, int) else _VARIABLE
        element = _member(place, field, schema.get("items"))
        return _Member(field, element.kind, length, element.schema)
    native = schema.get("x-native-type")
    kind = basic_type(schema) or (native if isinstance(native, str) else place)
    return _Member(field, kind, _SINGLE, schema)


def _field_type(record: _Record, member: _Member) -> str:
    return _IN_PYTHON.get(member.kind, _short(member.kind)) if record.is_ros else member.kind


def _example(member: _Member) -> str:
    if member.length != _SINGLE:
        return "[]"
    if member.kind not in BASIC:
        return "{}"
    schema: Any = member.schema
    if "default" in schema:
        value = schema["default"]
        return repr(bytes([value])) if member.kind == "byte" else str(value)
    return _ZEROS.get(member.kind, "0.0" if member.kind.startswith("float") else "0")


def _brackets(member: _Member) -> str:
    return "" if member.length == _SINGLE else f"[{member.length or ''}]"


def _short(name: str) -> str:
    """Return the name of a type of ROS as rosapi's descriptions and message files have it."""
    found = _ROS_TYPE.fullmatch(name)
    return f"{found[1]}/{found[3]}" if found else name


def _parts(name: str) -> tuple[str, str, str]:
    """Return package, kind and name of a type of ROS; ROS 1 names no kind."""
    plain = "/".join(part for part in name.split("/") if part)
    long, short = _ROS_TYPE.fullmatch(plain), _SHORT_TYPE.fullmatch(plain)
    if long:
        package, kind, own = long.groups()
    elif short:
        package, kind, own = short[1], "", short[2]
    else:
        return "", "", name
    return ("rosapi_msgs" if package == _OF_ROSAPI else package), kind, own


def _is_record(schema: object) -> bool:
    if not isinstance(schema, Mapping):
        return False
    return bool(_properties(schema)) or (
        schema.get("type") == "object"
        and _ROS_TYPE.fullmatch(str(schema.get("x-native-type"))) is not None
    )


def _properties(schema: object) -> Mapping[str, object]:
    found = schema.get("properties") if isinstance(schema, Mapping) else None
    return found if isinstance(found, Mapping) else {}


_MOST_ADDED = 100_000
_TIME = {"secs": "sec", "nsecs": "nanosec"}
# Fields of ROS 1 by their types and the names that ROS 2 has for them; None: it has none.
_OF_ROS_1: Mapping[str, Mapping[str, str | None]] = {
    "builtin_interfaces/msg/Time": _TIME,
    "builtin_interfaces/msg/Duration": _TIME,
    "std_msgs/msg/Header": {"seq": None},
}
_INITIAL: Mapping[object, Message] = {"boolean": False, "integer": 0, "number": 0.0, "string": ""}


def read_arguments(structure: MessageStructure, arguments: Message) -> Message:
    """Return the logical value of a message, a request or a goal.

    A list stands for the fields in their order. A field of a ROS type that is missing has the value
    that ROS gives it, as with rosbridge; what other frameworks require stays required.

    Raises:
        UsageError: the list has more values than there are fields.
        MessageError: a text is not what its place may carry, or too much is left out.
    """
    named = _named(structure.schema, arguments)
    return read_message(TEXT_FORM, structure, _MessageCompletion().filled(structure.schema, named))


def reader_of(what: str, stated: str) -> Read:
    """Return what reads a request after the type that the client states for it was compared.

    Args:
        what: the service or the action, for the error.
        stated: its type, empty: none.
    """

    def read(structure: MessageStructure, arguments: Message) -> Message:
        check_type(what, stated, service_type(structure, ""))
        return read_arguments(structure, arguments)

    return read if stated else read_arguments


def _named(schema: Any, arguments: Message) -> Message:
    if arguments is None:
        return {}
    if isinstance(arguments, list) and isinstance(schema, Mapping):
        names = schema.get("properties")
        if isinstance(names, Mapping):
            if len(arguments) > len(names):
                raise UsageError(f"expected at most {len(names)} arguments, got {len(arguments)}")
            return dict(zip(names, arguments, strict=False))
    return arguments


class _MessageCompletion:
    """One message whose missing fields are added, of which there may be so many."""

    def __init__(self) -> None:
        self._left = _MOST_ADDED

    def filled(self, schema: Any, value: Message) -> Message:
        """Return a value with the fields that are missing in its objects of ROS types."""
        if not isinstance(schema, Mapping):
            return value
        if isinstance(value, dict) and _is_ros_record(schema):
            value = _spelt_as_ros_2(schema, value)
            known = {
                name: self.filled(member, value[name]) if name in value else self._initial(member)
                for name, member in schema["properties"].items()
            }
            return {**known, **{name: item for name, item in value.items() if name not in known}}
        items = schema.get("items")
        if isinstance(value, list) and isinstance(items, Mapping) and _is_ros_record(items):
            return [self.filled(items, item) for item in value]
        return value

    def _initial(self, schema: Any) -> Message:
        """Return the value with which ROS begins a field."""
        self._left -= 1
        if self._left < 0:
            text = f"more than {_MOST_ADDED:,} values are left out; write them"
            raise MessageError(text)
        if not isinstance(schema, Mapping):
            return None
        if "default" in schema:
            return schema["default"]
        if schema.get("type") == "object":
            members = schema.get("properties", {}).items()
            return {name: self._initial(member) for name, member in members}
        if schema.get("type") == "array":
            return [self._initial(schema["items"]) for _ in range(schema.get("minItems", 0))]
        return _INITIAL.get(schema.get("type"))


def _is_ros_record(schema: Mapping[str, Any]) -> bool:
    return schema.get("type") == "object" and "x-native-type" in schema


def _spelt_as_ros_2(schema: Mapping[str, Any], value: Mapping[str, Message]) -> dict[str, Message]:
    """Return a record with the names of ROS 2, without the `seq` of a header, which it has not."""
    names = _OF_ROS_1.get(schema["x-native-type"], {})
    return {
        known: item for name, item in value.items() if (known := names.get(name, name)) is not None
    }
