"""Random message types as ROS, IDL and device XML have them: closed, all required, sized."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uoarm.testing._instances import Choices, chance

if TYPE_CHECKING:
    from collections.abc import Callable

Schema = dict[str, object]

FIELDS = ("header", "stamp", "x", "y", "data", "mode", "name", "ranges", "pose", "id")
_SIZES = ((True, 8), (False, 8), (True, 16), (False, 16), (True, 32), (False, 32), (True, 64),
          (False, 64))  # fmt: skip


def integer_type(bits: int, *, signed: bool) -> Schema:
    low = -(2 ** (bits - 1)) if signed else 0
    return {"type": "integer", "minimum": low, "maximum": low + 2**bits - 1}


def closed(properties: dict[str, object], optional: tuple[str, ...] = ()) -> Schema:
    """An object with exactly these fields, all required but the ``optional``."""
    return {
        "type": "object",
        "properties": properties,
        "required": [name for name in properties if name not in optional],
        "additionalProperties": False,
    }


def robot_schema(choices: Choices, depth: int = 3) -> Schema:
    """A message type: an object at the root."""
    return _message(choices, depth)


def _any(choices: Choices, depth: int) -> Schema:
    makers: list[Callable[[], Schema]] = [
        lambda: _integer(choices),
        lambda: {"type": "number"},
        lambda: {"type": "number", "minimum": choices.integer(-2, 0), "maximum": 1},
        lambda: {"type": "boolean"},
        lambda: {"type": "string"},
        lambda: {"type": "string", "maxLength": choices.item((1, 8, 255))},
        lambda: {"enum": list(choices.item((("idle", "run"), ("idle", "run", "stop"), (0, 1, 2))))},
        lambda: {"type": "string", "pattern": choices.item(("^[a-z]+$", "^[a-z]{2,4}$"))},
    ]
    if depth > 0:
        makers += [
            lambda: _array(choices, depth),
            lambda: _array(choices, depth),
            lambda: _message(choices, depth - 1),
            lambda: _message(choices, depth - 1),
            lambda: _tagged(choices, depth - 1),
            lambda: {"anyOf": [_any(choices, depth - 1), {"type": "null"}]},
        ]
    return choices.item(makers)()


def _integer(choices: Choices) -> Schema:
    signed, bits = choices.item(_SIZES)
    return integer_type(bits, signed=signed)


def _array(choices: Choices, depth: int) -> Schema:
    schema: Schema = {"type": "array", "items": _any(choices, depth - 1)}
    length = choices.item((None, 3, 9, 36))
    if length is not None:
        schema["maxItems"] = length
        if chance(choices, 60):
            schema["minItems"] = length
    return schema


def _message(choices: Choices, depth: int) -> Schema:
    names = [name for name in FIELDS if chance(choices, 30)] or ["data"]
    optional = tuple(name for name in names if chance(choices, 10))
    return closed({name: _any(choices, depth) for name in names}, optional)


def _tagged(choices: Choices, depth: int) -> Schema:
    branches = []
    for tag in ("goal", "cancel", "status")[: choices.integer(2, 3)]:
        body = _message(choices, depth)
        properties = {"kind": {"const": tag}, **_fields(body)}
        branches.append(closed(properties))
    return {choices.item(("oneOf", "anyOf")): branches}


def _fields(message: Schema) -> dict[str, object]:
    properties = message["properties"]
    assert isinstance(properties, dict)
    return properties
