"""Messages to payloads and back, within a budget."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from typing import Any

from attrs import frozen

from uoarm.bridge import foreign, text_of
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import (
    Budget,
    BudgetUse,
    Message,
    MessageStructure,
    Schema,
    octets_of,
    plain_copy,
    read_json,
    scan_json,
)
from uoarm.schema import document_of, enclose, follow

Convert = Callable[[Any], Any]

_OCTET = {"type": "integer", "minimum": 0, "maximum": 255}
STRUCTURES = {
    "octets": MessageStructure({"type": "array", "items": _OCTET, "x-octets": True}),
    "text": MessageStructure({"type": "string"}),
}
"""The structures of contents that have but one."""

CONTENT_TYPES = {
    "json": "application/json",
    "octets": "application/octet-stream",
    "text": "text/plain; charset=utf-8",
}


@frozen
class PayloadCodec:
    """How the messages of one port are written.

    Attributes:
        content: json, octets or text.
        budget: what one message may cost, on either way.
        convert: makes of JSON what the structure means: octets of base64, 7 of 7.0 where an
            integer is wanted; None where nothing is to be done.
    """

    content: str
    budget: Budget
    convert: Convert | None = None

    @classmethod
    def of(cls, content: str, structure: MessageStructure, budget: Budget) -> PayloadCodec:
        """Return the codec for what has a structure."""
        convert = _Reading(structure.schema).of(structure.schema) if content == "json" else None
        return cls(content, budget, convert)

    def encode(self, message: Message) -> bytes:
        """Return the payload of a message.

        Raises:
            MessageError: it has none of this content, or too large a one.
        """
        try:
            payload = foreign(self._encode, message)
        except Exception as error:  # of a value's own methods, say
            text = f"no content {self.content!r} of MQTT: {text_of(error)}"
            raise MessageError(text) from error
        if len(payload) > self.budget.octets:
            allowed = f"{self.budget.octets:,} are allowed (max_octets)"
            raise MessageError(f"the payload has {len(payload):,} octets; {allowed}")
        return payload

    def decode(self, payload: bytes, content_type: str = "") -> Message:
        """Return the message of a payload.

        Raises:
            MessageError: it cannot be read, or costs more than the budget.
        """
        try:
            return self._decode(payload, content_type)
        except (ControlMessageError, TypeError, ValueError, RecursionError) as error:
            text = text_of(error)
            raise MessageError(f"a payload of {len(payload):,} octets: {text}") from error

    def _encode(self, message: Message) -> bytes:
        if self.content == "octets":
            if isinstance(message, str) or not hasattr(message, "__iter__"):
                raise TypeError(f"expected octets, got {type(message).__name__}")
            return octets_of(message)
        if self.content == "text":
            if not isinstance(message, str):
                raise TypeError(f"expected a text, got {type(message).__name__}")
            return message.encode()
        values, separators = plain_copy(message), (",", ":")
        text = json.dumps(
            values, ensure_ascii=False, allow_nan=False, separators=separators, default=self._plain
        )
        return text.encode()

    def _plain(self, value: Any) -> Any:
        """What JSON has no form for: octets are texts in base64, arrays are lists."""
        if isinstance(value, bytes | bytearray | memoryview):
            return base64.b64encode(octets_of(value)).decode("ascii")
        if callable(listed := getattr(value, "tolist", None)):
            count = getattr(value, "size", 0)  # its values repeat, perhaps
            if count > self.budget.octets:
                raise ValueError(f"an array of {count:,} elements is longer than any payload")
            return plain_copy(listed())
        raise TypeError(f"a {type(value).__name__} has no form in JSON")

    def _decode(self, payload: bytes, content_type: str) -> Message:
        spending = BudgetUse(self.budget)
        spending.octets(len(payload))
        if self.content == "octets":
            return payload
        text = payload.decode()
        if self.content == "text":
            return text
        if content_type and "json" not in content_type.lower():
            raise ValueError(f"its content type is {content_type[:80]!r}, expected JSON")
        scan_json(text, spending)
        value = read_json(text)
        return value if self.convert is None else self.convert(value)


class _Reading:
    """Compiles what is to be done with JSON of a structure, once for each channel.

    Follows properties, items and references within the schema; where alternatives are, values
    stay as JSON has them.
    """

    def __init__(self, root: Schema) -> None:
        self._root = root
        self._references: dict[str, list[Convert | None]] = {}

    def of(self, schema: Any) -> Convert | None:
        """Return what is to be done with a value of a schema, None for nothing."""
        if not isinstance(schema, Mapping):
            return None
        if document_of(schema, self._root) is not self._root:
            return _Reading(schema).of(schema)
        if isinstance(place := schema.get("$ref"), str):
            return self._referred(place)
        kind = schema.get("type")
        if schema.get("x-octets"):
            return _octets
        if kind == "integer":
            return _integer
        if kind == "array":
            return self._list(schema)
        if kind == "object":
            return self._object(schema)
        return None

    def _list(self, schema: Mapping[str, Any]) -> Convert | None:
        first = [self.of(item) for item in schema.get("prefixItems", ())]
        rest = self.of(schema.get("items"))
        if rest is None and not any(first):
            return None

        def convert(value: Any) -> Any:
            if not isinstance(value, list):
                return value
            converts = [*first[: len(value)], *[rest] * (len(value) - len(first))]
            return [
                item if convert is None else convert(item)
                for convert, item in zip(converts, value, strict=True)
            ]

        return convert

    def _object(self, schema: Mapping[str, Any]) -> Convert | None:
        named = {name: self.of(inner) for name, inner in schema.get("properties", {}).items()}
        members = {name: do for name, do in named.items() if do is not None}
        other = self.of(schema.get("additionalProperties"))
        if not members and other is None:
            return None

        def convert(value: Any) -> Any:
            if not isinstance(value, dict):
                return value
            for name, member in value.items():
                do = members.get(name) if name in named else other
                if do is not None:
                    value[name] = do(member)
            return value

        return convert

    def _referred(self, place: str) -> Convert | None:
        if place not in self._references:
            known = self._references[place] = []  # a schema may refer to itself
            known.append(self.of(follow(self._root, place)))
        known = self._references[place]
        if known:
            return known[0]
        return lambda value: value if known[0] is None else known[0](value)


def _octets(value: Any) -> Any:
    """Octets are base64; a list of numbers is taken as well."""
    if isinstance(value, str):
        padding = "" if value.endswith("=") else "=" * (-len(value) % 4)  # many leave it out
        return base64.b64decode(value + padding, validate=True)
    return bytes(value) if isinstance(value, list) else value


def _integer(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


def limits_of(content: str, octets: int) -> dict[str, object]:
    """Return the keywords that hold of all messages of a content that are sent.

    Args:
        content: json, octets or text.
        octets: that a payload may have.
    """
    if content == "json":
        return {"x-max-json": octets, "x-nonfinite": False}
    return {"x-max-octets": octets}


def with_topic(inner: MessageStructure) -> MessageStructure:
    """Return the structure of messages that say on which topic they came."""

    def around(schema: Any) -> dict[str, Any]:
        both = {"topic": {"type": "string"}, "message": schema}
        closed = {"required": [*both], "additionalProperties": False}
        return {"type": "object", "properties": both, **closed}

    return MessageStructure(enclose(inner.schema, around))
