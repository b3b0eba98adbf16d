"""The functions of a lock as applications see them, with the shapes of their ports."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from attrs import field, frozen

from uoarm._lock import Lock
from uoarm._types._shape import Named, RecordShape, Shape, Shaper, UniqueNames

__all__ = ["FunctionTypes", "RobotTypes", "Root", "read_functions", "write_document"]

# What the modules that are written use themselves.
_RESERVED = frozenset({
    "Any", "Array", "Callable", "Connection", "False", "FunctionName", "Inputs", "Integer",
    "Literal", "Never", "None", "NotRequired", "Number", "Numbers", "Object", "Octets", "Outputs",
    "Promise", "Protocol", "QueuePolicy", "Real", "RecordShape", "Replies", "Requests",
    "RequestOptions", "Robot", "RobotManager", "Stream", "String", "True", "TypeAlias",
    "TypedDict", "TypedRobot", "TypedStream", "Uint8Array", "ValidationMode", "bool", "boolean",
    "bytes", "cast", "dict", "float", "int", "list", "never", "null", "number", "object",
    "overload", "str", "string", "symbol", "type", "typed", "undefined", "unknown",
})  # fmt: skip


@frozen
class Root:
    """The type of one structure: its name, what it is, and the records below it."""

    name: str
    schema: Any
    shape: Shape
    records: tuple[RecordShape, ...]


@frozen
class FunctionTypes:
    """What applications send to a function and get from it: port to the name of the type.

    `refused` says that it has no plan.
    """

    outputs: dict[str, str] = field(factory=dict)
    inputs: dict[str, str] = field(factory=dict)
    request: str = ""
    reply: str = ""
    refused: bool = False

    def names(self, function: str) -> Iterator[tuple[str, str]]:
        """Yield by which names an output may be asked for, and its type."""
        if len(self.outputs) == 1:
            yield function, next(iter(self.outputs.values()))
        for output, kind in self.outputs.items():
            yield f"{function}.{output}", kind


@frozen
class RobotTypes:
    """All functions of a robot, by name, and the types of their structures."""

    functions: dict[str, FunctionTypes]
    roots: tuple[Root, ...]


def read_functions(lock: Lock) -> RobotTypes:
    """Return the functions of a lock, in the order of their names; it does not raise."""
    names = UniqueNames(_RESERVED)
    roots: dict[str, Root] = {}
    functions: dict[str, FunctionTypes] = {}
    for name, locked in sorted(lock.functions.items()):
        if not locked.parts:
            functions[name] = FunctionTypes(refused=True)
            continue
        provider = locked.parts[-1]
        fed = {edge.input for edge in locked.edges if edge.consumer == provider.component}
        function = FunctionTypes()
        single: dict[str, str] = {}
        for port, fingerprint in sorted(provider.ports.items()):
            kind, _, own = port.partition(".")
            if kind == "input" and own in fed:
                continue
            if fingerprint not in roots:
                schema = lock.structure(fingerprint).schema
                wanted = f"{name} {kind} {'' if own == 'default' else own}"
                made = Shaper(schema, wanted, names)
                shape = made.shape
                root = shape.name if isinstance(shape, Named) else names.give(wanted)
                roots[fingerprint] = Root(root, schema, shape, tuple(made.records))
            text = roots[fingerprint].name
            if kind == "output":
                function.outputs[own] = text
            elif kind == "input":
                function.inputs[own] = text
            else:
                single[kind] = text
        functions[name] = FunctionTypes(
            function.outputs, function.inputs, single.get("request", ""), single.get("reply", "")
        )
    return RobotTypes(functions, tuple(roots.values()))


def write_document(robot: RobotTypes) -> str:
    """Return a JSON Schema with the structures below `$defs`, each a document of its own.

    `x-functions` says which function has which.
    """
    taken: set[str] = set()
    definitions: dict[str, Any] = {}
    for root in robot.roots:
        schema = root.schema
        if isinstance(schema, Mapping):
            own = schema.get("$id")
            # With one, `#/…` in it is of itself and not of the whole.
            if not isinstance(own, str) or own in taken:
                own = f"urn:uoarm:{root.name}"
            taken.add(own)
            schema = {**schema, "$id": own}
        definitions[root.name] = schema
    functions = {
        name: {
            **{f"output.{port}": _reference(kind) for port, kind in function.outputs.items()},
            **{f"input.{port}": _reference(kind) for port, kind in function.inputs.items()},
            **({"request": _reference(function.request)} if function.request else {}),
            **({"reply": _reference(function.reply)} if function.reply else {}),
        }
        for name, function in robot.functions.items()
    }
    whole = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$defs": definitions,
        "x-functions": functions,
    }
    return json.dumps(whole, indent=2, sort_keys=True) + "\n"


def _reference(name: str) -> dict[str, str]:
    return {"$ref": f"#/$defs/{name}"}
