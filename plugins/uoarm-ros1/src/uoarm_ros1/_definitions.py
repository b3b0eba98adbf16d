"""Message definitions of ROS 1: text as it comes in a connection's header, read into records.

A definition is the text of a type, followed by those of the types within it, each after a line of
`=` and one that says `MSG: package/Name`. Nothing of ROS need be installed to read it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

from attrs import frozen

from uoarm.cdr import BASIC, number_schema, ros_unit
from uoarm.model import MessageStructure, closed_object

_Schema: TypeAlias = dict[str, Any]

NUMBERS: Mapping[str, str] = {
    **{name: code for name, code in BASIC.items() if code not in {"", "?"}},
    "byte": "b",  # a name of old, of what has a sign; what is called a char has none
}
"""How `struct` and numpy call the numbers of ROS 1."""

_SEPARATOR = re.compile(r"^={10,}\s*$", re.MULTILINE)
_TYPE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:/([A-Za-z][A-Za-z0-9_]*))?(\[\d*\])?")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_HEADER = "std_msgs/Header"
_MAX_OCTETS = 1 << 20
_MAX_DEPTH = 32
_MAX_FIELDS = 20_000
_MAX_SIZE = 1 << 24


class DefinitionError(ValueError):
    """A definition that cannot be used; the text says which line, and what was expected."""


@frozen(slots=False, eq=False)
class RosRecord:
    """A message type.

    Attributes:
        name: `package/Name`.
        schema: a closed object with every field required, in the order of the definition, which is
            that on the wire.
        md5: the sum by which nodes of ROS 1 know the type.
        definition: the whole text, with that of every type within it.
    """

    name: str
    schema: _Schema
    md5: str
    definition: str

    @cached_property
    def structure(self) -> MessageStructure:
        """Its schema, as of this type."""
        return MessageStructure(self.schema, native_type=self.name)


@frozen(eq=False)
class RosService:
    """A service type: two records, and the one sum of both."""

    name: str
    request: RosRecord
    reply: RosRecord
    md5: str


def _object(name: str, properties: Mapping[str, _Schema], type_: object) -> _Schema:
    return closed_object(properties, x_native_type=name, x_type=type_)


def _counting(schema: _Schema, unit: str | None) -> _Schema:
    """Return a schema whose numbers count a unit, whatever those within it say; None: as it is."""
    if unit is None:
        return schema
    if schema["type"] == "object":
        inner = {name: _counting(member, unit) for name, member in schema["properties"].items()}
        return {**schema, "properties": inner}
    if schema["type"] == "array":
        return {**schema, "items": _counting(schema["items"], unit)}
    return {**schema, "x-unit": unit} if schema["type"] in {"integer", "number"} else schema


def _time(name: str, kind: str) -> _Schema:
    parts = ("secs", "nsecs")
    members = {part: number_schema(kind, NUMBERS[kind], ros_unit(name, part)) for part in parts}
    return _object(name, members, name)


_TIMES = {"time": _time("time", "uint32"), "duration": _time("duration", "int32")}
_PLAIN: Mapping[str, _Schema] = {
    "bool": number_schema("bool", "?"),
    "string": {"type": "string"},
    **{name: number_schema(name, code) for name, code in NUMBERS.items()},
    **_TIMES,
}


@frozen
class _Line:
    """A line of a definition that is no comment: a field, or a constant with its text."""

    type: str
    suffix: str
    name: str
    constant: str | None = None


def parts_of(definition: str, name: str) -> dict[str, str]:
    """Split a whole definition into the texts of its types, the one named first.

    Raises:
        DefinitionError: it is too long, or a part does not say of which type it is.
    """
    if len(definition) > _MAX_OCTETS:
        raise DefinitionError(f"{name}: its definition is longer than {_MAX_OCTETS:,} characters")
    first, *others = _SEPARATOR.split(definition.replace("\r\n", "\n"))
    texts = {name: first}
    for other in others:
        head, _, text = other.lstrip("\n").partition("\n")
        if not head.startswith("MSG: "):
            raise DefinitionError(f"{name}: expected a line `MSG: package/Name`, got {head[:80]!r}")
        texts[head.removeprefix("MSG: ").strip()] = text
    return texts


@lru_cache(maxsize=1024)
def record_of(name: str, definition: str) -> RosRecord:
    """Return the record of a whole definition; the same one each time.

    Raises:
        DefinitionError: the text cannot be read.
    """
    texts = parts_of(definition, name)
    return _Reading(texts.get).record(name)


def service_of(name: str, text: str, find: Callable[[str], str | None]) -> RosService:
    """Return a service of the text of a `.srv` file.

    Args:
        name: `package/Name`.
        text: request and reply, with a line of `---` between them.
        find: returns the text of a message type, None where there is none.

    Raises:
        DefinitionError: the text cannot be read, or a type within it is not found.
    """
    whole, *others = _SEPARATOR.split(text.replace("\r\n", "\n"))
    parts = re.split(r"^---[ \t]*$", whole, flags=re.MULTILINE)
    if len(parts) != 2:  # noqa: PLR2004 - a request and a reply
        raise DefinitionError(f"{name}: expected one line of --- between request and reply")
    beside = {}
    for other in others:
        head, _, inner = other.lstrip("\n").partition("\n")
        beside[head.removeprefix("MSG: ").strip()] = inner
    request, reply = (f"{name}{ending}" for ending in ("Request", "Response"))
    texts = {request: parts[0], reply: parts[1], **beside}
    reading = _Reading(lambda wanted: texts[wanted] if wanted in texts else find(wanted))
    records = reading.record(request), reading.record(reply)
    sums = "".join(reading.sums[part] for part in (request, reply))
    md5 = hashlib.md5(sums.encode(), usedforsecurity=False).hexdigest()
    return RosService(name, records[0], records[1], md5)


class _Reading:
    """The types of one definition, each read once.

    Attributes:
        sums: by type, the text of which its md5sum is taken.
    """

    def __init__(self, find: Callable[[str], str | None]) -> None:
        self._find = find
        self._records: dict[str, RosRecord] = {}
        self._sizes: dict[str, int] = {}
        self._within: dict[str, dict[str, str]] = {}
        self.sums: dict[str, str] = {}

    def record(self, name: str, path: tuple[str, ...] = ()) -> RosRecord:
        """Return a type, and read those within it."""
        if name in self._records:
            return self._records[name]
        if name in path or len(path) > _MAX_DEPTH:
            raise DefinitionError(f"{name} is nested within itself, or more than {_MAX_DEPTH} deep")
        text = self._find(name)
        if text is None:
            outer = f", which {path[-1]} holds," if path else ""
            raise DefinitionError(f"the type {name}{outer} is not defined")
        fields: dict[str, _Schema] = {}
        constants: dict[str, object] = {}
        # The sum is of constants first, then fields, with the sums of types in their places.
        constant_sums, field_sums = [], []
        within: dict[str, str] = {}
        size = 1
        for line in _lines(name, text):
            if line.constant is not None:
                constants[line.name] = _constant(name, line)
                constant_sums.append(f"{line.type} {line.name}={line.constant}")
                continue
            element = _PLAIN.get(line.type)
            if element is None:
                inner = _qualified(line.type, name)
                record = self.record(inner, (*path, name))
                element = record.schema
                field_sums.append(f"{record.md5} {line.name}")
                within |= {inner: self._find(inner) or "", **self._within[inner]}
                size += self._sizes[inner]
            else:
                field_sums.append(f"{line.type}{line.suffix} {line.name}")
                size += 1
            if line.name in fields:
                raise DefinitionError(f"{name} has two fields of one name")
            # A vector that is a velocity counts metres a second, whatever its own type would say.
            schema = _array(name, element, line) if line.suffix else element
            fields[line.name] = _counting(schema, ros_unit(name, line.name))
        if size > _MAX_FIELDS:
            raise DefinitionError(f"{name} has more than {_MAX_FIELDS:,} fields, with those within")
        self.sums[name] = "\n".join((*constant_sums, *field_sums)).strip()
        md5 = hashlib.md5(self.sums[name].encode(), usedforsecurity=False).hexdigest()
        whole = text.rstrip("\n") + "".join(
            f"\n{'=' * 80}\nMSG: {inner}\n{part.rstrip()}" for inner, part in within.items()
        )
        self._within[name], self._sizes[name] = within, size
        schema = _object(name, fields, {"name": name, "hash": md5})
        if constants:
            schema["x-constants"] = constants
        self._records[name] = RosRecord(name, schema, md5, f"{whole}\n")
        return self._records[name]


def _lines(name: str, text: str) -> Iterator[_Line]:
    for number, original in enumerate(text.split("\n"), 1):
        line = original.split("#", 1)[0].strip()
        if not line:
            continue
        kind, _, rest = line.replace("\t", " ").partition(" ")
        found = _TYPE.fullmatch(kind)
        rest = rest.strip()
        constant = None
        if "=" in rest:  # only this makes a constant: a field's name may be in capitals
            rest, _, constant = rest.partition("=")
            if kind == "string":  # all that stands behind the sign, a `#` too
                constant = original.partition("=")[2]
            rest, constant = rest.strip(), constant.strip()
        is_constant_type = kind not in _TIMES and kind in _PLAIN
        if (
            not found
            or not _NAME.fullmatch(rest)
            or (constant is not None and not is_constant_type)
        ):
            text = f"{name}: line {number}: {original[:100]!r} is no field, constant or comment"
            raise DefinitionError(text)
        suffix = found[3] or ""
        yield _Line(kind[: len(kind) - len(suffix)], suffix, rest, constant)


def _qualified(kind: str, within: str) -> str:
    if kind == "Header":
        return _HEADER
    return kind if "/" in kind else f"{within.partition('/')[0]}/{kind}"


def _array(name: str, element: _Schema, line: _Line) -> _Schema:
    schema: _Schema = {"type": "array", "items": element}
    if line.suffix != "[]":
        size = int(line.suffix[1:-1])
        if size > _MAX_SIZE:
            text = f"{name}: an array of {size:,} elements; {_MAX_SIZE:,} are allowed"
            raise DefinitionError(text)
        schema["minItems"] = schema["maxItems"] = size
    if NUMBERS.get(line.type) == "B":
        schema["x-octets"] = True
    return schema


def _constant(name: str, line: _Line) -> object:
    text = line.constant or ""
    try:
        if line.type == "string":
            return text
        if line.type in {"float32", "float64"}:
            return float(text)
        if line.type == "bool":
            return text.lower() == "true" or (text.lower() != "false" and bool(int(text)))
        return int(text) if text.lstrip("+-").isdigit() else int(text, 0)
    except ValueError:
        raise DefinitionError(f"{name}: {line.name}={text[:80]!r} is no {line.type}") from None
