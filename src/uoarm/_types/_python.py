"""Functions as a Python module: a TypedDict for each object, and a manager by function names."""

from __future__ import annotations

import keyword
from collections.abc import Iterator, Sequence

from uoarm._types._shape import (
    Array,
    Literals,
    Plain,
    RecordReference,
    RecordShape,
    RobotTypes,
    Shape,
    Table,
    Union,
    notes_of,
)

_HEAD = '''"""The messages of a robot's functions; made by `uoarm types --python`, not to be edited.

An array of numbers may come as a numeric buffer, and `Octets` as any buffer of octets.
"""

# ruff: noqa
from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Protocol, cast, overload

from typing_extensions import Never, NotRequired, TypeAlias, TypedDict
from uoarm import Connection, QueuePolicy, RobotManager, ValidationMode
from uoarm.local import Octets
'''
_TAIL = '''

def typed(robot: RobotManager) -> TypedRobot:
    """Return a manager as what checkers of types know by the names of its functions."""
    return cast("TypedRobot", robot)
'''
_PLAIN = {
    "any": "Any", "never": "Never", "null": "None", "boolean": "bool", "integer": "int",
    "wide": "int", "number": "float", "string": "str", "octets": "Octets",
}  # fmt: skip
# A member of such a name would hide the type from the members after it.
_HIDING = {
    "Any", "Literal", "Never", "NotRequired", "Octets", "bool", "bytes", "dict", "float", "int",
    "list", "str",
}  # fmt: skip


def write_python(robot: RobotTypes) -> str:
    """Return the module: the same text for the same functions."""
    records = [record for root in robot.roots for record in root.records]
    hiding = _HIDING | {record.name for record in records}
    lines = [_HEAD]
    lines.append(f"FunctionName: TypeAlias = {_literal([*robot.functions]) or 'Never'}")
    for record in records:
        lines += ["", "", *_record(record, hiding)]
    lines += ["", ""]
    for root in robot.roots:
        if root.shape != RecordReference(root.name):
            text = f"{root.name}: TypeAlias = {_type(root.shape)}"
            lines.append(text + _comment(notes_of(root.shape)))
    lines += ["", "", *_robot(robot)]
    return "\n".join(lines) + "\n" + _TAIL


def _record(record: RecordShape, hiding: set[str]) -> Iterator[str]:
    plain = all(
        key.isascii() and key.isidentifier() and not keyword.iskeyword(key)
        and not key.startswith("__") and key not in hiding
        for key in record.members
    )  # fmt: skip
    if plain:
        yield f"class {record.name}(TypedDict):" + _comment([record.note])
        for key, (shape, required) in record.members.items():
            yield f"    {key}: {_member(shape, required=required)}" + _comment(notes_of(shape))
        if not record.members:
            yield "    pass"
        return
    yield f"{record.name} = TypedDict(" + _comment([record.note])
    yield f'    "{record.name}",'
    yield "    {"
    for key, (shape, required) in record.members.items():
        text = _member(shape, required=required)
        yield f"        {key!a}: {text!a}," + _comment(notes_of(shape))
    yield "    },"
    yield ")"


def _member(shape: Shape, *, required: bool) -> str:
    return _type(shape) if required else f"NotRequired[{_type(shape)}]"


def _type(shape: Shape) -> str:
    match shape:
        case Plain():
            return _PLAIN[shape.kind]
        case Literals():
            return _literal(shape.values)
        case Array():
            return f"list[{_type(shape.items)}]"
        case Table():
            return f"dict[str, {_type(shape.values)}]"
        case Union():
            return " | ".join(dict.fromkeys(_type(part) for part in shape.parts))
        case RecordReference():
            return shape.name


def _literal(values: Sequence[str | int | bool | None]) -> str:
    return f"Literal[{', '.join(ascii(value) for value in values)}]" if values else ""


def _comment(notes: Iterator[str] | list[str]) -> str:
    reports = [note for note in dict.fromkeys(notes) if note]
    return f"  # {'; '.join(reports)}" if reports else ""


def _robot(robot: RobotTypes) -> Iterator[str]:
    yield "class TypedRobot(Protocol):"
    yield '    """What `RobotManager` does, by the names of the functions."""'
    requests: list[list[str]] = []
    calls: list[list[str]] = []
    for name, function in robot.functions.items():
        kinds: dict[str, list[str]] = {}
        for asked, kind in function.names(name):
            kinds.setdefault(kind, []).append(asked)
        if not function.outputs and not function.request and not function.refused:
            kinds["Never"] = [name]  # it only takes messages
        for kind, asked_names in kinds.items():
            requests.append([
                "    def request(",
                f"        self, name: {_literal(asked_names)}, *,",
                "        validate: ValidationMode | str = ..., queue: QueuePolicy | None = ...,",
                f"        on_message: Callable[[{kind}], None] | None = ...,",
                f"        timeout: float = ...) -> Connection[{kind}]: ...",
            ])  # fmt: skip
        if function.request and function.reply:
            calls.append([
                "    def call(",
                f"        self, name: {_literal([name])}, message: {function.request}, *,",
                f"        timeout: float = ...) -> {function.reply}: ...",
            ])  # fmt: skip
    for several in (requests, calls):
        for item in several:
            if len(several) > 1:
                yield "    @overload"
            yield from item
