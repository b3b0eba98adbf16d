"""How a pair of known truth is written down."""

from __future__ import annotations

from typing import NamedTuple

Body = bool | dict[str, object]

INTEGER: Body = {"type": "integer"}
NUMBER: Body = {"type": "number"}
STRING: Body = {"type": "string"}
BOOLEAN: Body = {"type": "boolean"}
NULL: Body = {"type": "null"}
ARRAY: Body = {"type": "array"}
OBJECT: Body = {"type": "object"}


class Hard(NamedTuple):
    """``witness`` is a value of the producer that the consumer refuses, where not contained."""

    name: str
    producer: Body
    consumer: Body
    contained: bool
    witness: object = None


def yes(name: str, producer: Body, consumer: Body) -> Hard:
    return Hard(name, producer, consumer, contained=True)


def no(name: str, producer: Body, consumer: Body, witness: object) -> Hard:
    return Hard(name, producer, consumer, contained=False, witness=witness)


def ints(low: int | None, high: int | None) -> Body:
    schema: dict[str, object] = {"type": "integer"}
    if low is not None:
        schema["minimum"] = low
    if high is not None:
        schema["maximum"] = high
    return schema


def closed(required: tuple[str, ...] | None = None, /, **properties: Body) -> dict[str, object]:
    """An object with exactly these fields; all required unless ``required`` names them."""
    return {
        "type": "object",
        "properties": dict(properties),
        "required": list(properties if required is None else required),
        "additionalProperties": False,
    }


def array(items: Body, low: int | None = None, high: int | None = None) -> dict[str, object]:
    schema: dict[str, object] = {"type": "array", "items": items}
    if low is not None:
        schema["minItems"] = low
    if high is not None:
        schema["maxItems"] = high
    return schema
