"""Message definitions as recordings hold them: one text, from a structure and to one.

It is the text of a message file and, after rules, of those of the types within it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from attrs import frozen

from uoarm.cdr._layout import (
    BASIC,
    DDS,
    Layout,
    RecordLayout,
    basic_type,
    layout_of,
    number_schema,
)
from uoarm.errors import MessageError
from uoarm.model import MessageStructure, closed_object

_RULE = "=" * 80
_SECTION = re.compile(r"^=+[ \t]*\n(?:MSG|IDL):[ \t]*(\S+)[ \t]*$", re.MULTILINE)
_ROS_TYPE = re.compile(r"([a-zA-Z][a-zA-Z0-9_]*)/(?:msg/)?([A-Z][A-Za-z0-9_]*)")
_FIELD_NAME = re.compile(r"[a-zA-Z][a-zA-Z0-9_]*")
_LINE = re.compile(
    r"(?P<base>[a-zA-Z][a-zA-Z0-9_/]*)(?:<=(?P<text>\d{1,9}))?"
    r"(?P<array>\[(?P<most><=)?(?P<size>\d{1,9})?\])?[ \t]+"
    r"(?P<name>[a-zA-Z][a-zA-Z0-9_]*)[ \t]*(?P<rest>.*)"
)
_MOST_TYPES, _MOST_FIELDS, _DEEPEST = 500, 20_000, 32
_MOST_TEXT = 1 << 20
_OCTETS = frozenset({"uint8", "byte", "char"})
_NAMES_OF_ONE = {"byte": "int8", "char": "uint8"}
_NAMES_OF_TWO = {"char": "uint8"}
_TIMES = {"time": ("uint32", "uint32"), "duration": ("int32", "int32")}


@frozen
class RosDefinition:
    """A message type as a recording states it.

    Attributes:
        name: `package/msg/Name`.
        text: of its message file and, after rules, of those of the types within it.
    """

    name: str
    text: str


def definition_of(structure: MessageStructure, name: str) -> RosDefinition:
    """Return the definition of a structure of a fixed layout, in the words of ROS 2.

    Args:
        structure: of the messages.
        name: of the type, where the structure is of none: `package/msg/Name`.

    Raises:
        MessageError: a message file cannot say it.
    """
    layout = layout_of(structure.schema, DDS)
    if not isinstance(layout, RecordLayout):
        raise MessageError(f"{name} has no fields, as each message file has")
    own = structure.native_type if _is_ros(structure.native_type) else name
    waiting: list[tuple[str, object]] = [(own, structure.schema)]
    layouts: dict[str, Layout] = {own: layout}
    texts: dict[str, str] = {}
    while waiting:
        type_name, schema = waiting.pop(0)
        if type_name in texts:
            continue
        if len(texts) >= _MOST_TYPES or not isinstance(schema, Mapping):
            raise MessageError(f"{type_name} cannot be written as a message file")
        head = f"{_RULE}\nMSG: {_short(type_name)}\n" if texts else ""
        # Viewers take an empty text for one that is missing, but for that of std_msgs/Empty.
        lines = "".join(_lines(type_name, schema, waiting, layouts))
        texts[type_name] = head + (lines or "# no fields\n")
    return RosDefinition(own, "".join(texts.values()))


def _lines(
    type_name: str,
    schema: Mapping[str, Any],
    waiting: list[tuple[str, object]],
    layouts: dict[str, Layout],
) -> Iterator[str]:
    for constant, value in schema.get("x-constants", {}).items():
        kind = {bool: "bool", int: "int64", float: "float64", str: "string"}.get(type(value))
        if kind is not None and _FIELD_NAME.fullmatch(constant) and "\n" not in str(value):
            yield f"{kind} {constant}={value}\n"
    for field, inner in schema.get("properties", {}).items():
        if not _FIELD_NAME.fullmatch(field):
            raise MessageError(f"{type_name}: a message file has no field {field!r:.80}")
        suffix = ""
        element = inner
        if inner.get("type") == "array":
            least, most = inner.get("minItems"), inner.get("maxItems")
            suffix = "[]" if most is None else f"[{most}]" if least == most else f"[<={most}]"
            element = inner.get("items", {})
        kind = basic_type(element)
        if not kind:
            native = element.get("x-native-type", "")
            kind = native if _is_ros(native) else f"{type_name}_{field}"
            layout = layout_of(element, DDS)
            while layouts.setdefault(kind, layout) != layout:  # `a_b` in `c`, and `b` in `c_a`
                kind += "_"
            waiting.append((kind, element))
        elif bound := element.get("x-max-utf8") or element.get("x-max-utf16"):
            kind = f"{kind}<={bound}"
        yield f"{_short(kind)}{suffix} {field}\n"


def structure_of_definition(
    definition: RosDefinition, *, is_ros_1: bool = False
) -> MessageStructure:
    """Return the structure that a definition states: closed objects with every field required.

    Args:
        definition: as a recording holds it.
        is_ros_1: whether it is one of ROS 1.

    Raises:
        MessageError: it cannot be understood; the text says where.
    """
    return _Definitions(definition, is_ros_1=is_ros_1).structure()


class _Definitions:
    """The parts of one text, each read once."""

    def __init__(self, definition: RosDefinition, *, is_ros_1: bool) -> None:
        if len(definition.text) > _MOST_TEXT:
            raise MessageError(f"{definition.name}: its definition has over {_MOST_TEXT:,} letters")
        self._name, self._is_ros_1 = definition.name, is_ros_1
        first, *rest = _SECTION.split(definition.text.replace("\r\n", "\n"))
        self._texts = {_short(definition.name): first}
        for name, text in zip(rest[::2], rest[1::2], strict=True):
            self._texts.setdefault(_short(name), text)
        self._count = 0

    def structure(self) -> MessageStructure:
        schema = self._record(_short(self._name), ())
        return MessageStructure(schema, native_type=self._full(_short(self._name)))

    def _record(self, name: str, path: tuple[str, ...]) -> dict[str, Any]:
        text = self._texts.get(name)
        if text is None and not path:
            raise MessageError(f"{self._name} has no definition")
        if text is None or name in path or len(path) > _DEEPEST:
            holder = path[-1] if path else self._name
            raise MessageError(f"{holder}: {name} is not defined with it, or holds itself")
        properties: dict[str, Any] = {}
        constants: dict[str, Any] = {}
        for line in text.split("\n"):
            content = line.strip()
            if not content or content.startswith("#"):
                continue
            found = _LINE.fullmatch(content)
            if found is None:
                raise MessageError(f"{name}: {content[:80]!r} is no field, constant or comment")
            if found["rest"].startswith("=") and found["array"] is None:
                constants[found["name"]] = _constant(found["base"], found["rest"][1:].strip())
                continue
            self._count += 1
            if self._count > _MOST_FIELDS:
                raise MessageError(f"{self._name} has more than {_MOST_FIELDS:,} fields")
            properties[found["name"]] = self._field(found, name, path)
        schema = _closed(self._full(name), properties)
        return {**schema, "x-constants": constants} if constants else schema

    def _field(self, found: re.Match[str], name: str, path: tuple[str, ...]) -> dict[str, Any]:
        element = self._element(found["base"], name, path)
        if found["text"] is not None:
            unit = "x-max-utf16" if found["base"] == "wstring" else "x-max-utf8"
            element = {**element, "maxLength": int(found["text"]), unit: int(found["text"])}
        if found["array"] is None:
            return element
        schema: dict[str, Any] = {"type": "array", "items": element}
        if found["size"] is not None:
            schema["maxItems"] = int(found["size"])
            if found["most"] is None:
                schema["minItems"] = int(found["size"])
        return {**schema, "x-octets": True} if self._basic(found["base"]) in _OCTETS else schema

    def _basic(self, base: str) -> str:
        return (_NAMES_OF_ONE if self._is_ros_1 else _NAMES_OF_TWO).get(base, base)

    def _element(self, base: str, name: str, path: tuple[str, ...]) -> dict[str, Any]:
        basic = self._basic(base)
        if basic in BASIC:
            return _scalar(basic)
        if self._is_ros_1 and base in _TIMES:
            parts = zip(("secs", "nsecs"), _TIMES[base], strict=True)
            return _closed(base, {part: _scalar(kind) for part, kind in parts})
        if base == "Header" and self._is_ros_1:
            return self._record("std_msgs/Header", (*path, name))
        reference = base if "/" in base else f"{name.partition('/')[0]}/{base}"
        return self._record(_short(reference), (*path, name))

    def _full(self, name: str) -> str:
        return name if self._is_ros_1 else name.replace("/", "/msg/", 1)


def _closed(name: str, properties: Mapping[str, Any]) -> dict[str, Any]:
    return closed_object(properties, x_native_type=name, x_type=name)


def _scalar(basic: str) -> dict[str, Any]:
    if code := BASIC[basic]:
        return number_schema(basic, code)
    return {"type": "string"} if basic == "string" else {"type": "string", "x-native-type": basic}


def _constant(kind: str, text: str) -> object:
    if kind in {"string", "wstring"}:
        return text.strip("\"'")
    plain = text.partition("#")[0].strip()
    if kind == "bool":
        return plain.lower() in {"true", "1"}
    try:
        return float(plain) if kind.startswith("float") else int(plain, 0)
    except ValueError:
        return plain


def _is_ros(name: object) -> bool:
    return isinstance(name, str) and "/msg/" in name and _ROS_TYPE.fullmatch(name) is not None


def _short(name: str) -> str:
    """Return the name of a type without its kind, as message files have it."""
    found = _ROS_TYPE.fullmatch(name)
    return f"{found[1]}/{found[2]}" if found else name
