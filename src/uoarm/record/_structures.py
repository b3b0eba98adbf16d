"""What a channel of a file gives: its structure, and messages of their octets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from attrs import frozen

from uoarm.cdr import RosDefinition, deserialiser, structure_of_definition
from uoarm.errors import BridgeError, ControlMessageError, FailureReason, MessageError
from uoarm.model import Budget, Message, MessageStructure, Spending, read_json
from uoarm.record._reading import FileChannel

__all__ = ["RECORDED", "ChannelReading", "reading_of"]

RECORDED = "x-recorded"
"""Marks a structure of what was recorded: no input that moves something takes it."""

_BUDGET = Budget(octets=268_435_456, elements=5_000_000)
_MOST_SCHEMA = 4 << 20
_MOST_DEPTH = 64
_MAPS = ("properties", "patternProperties", "$defs", "definitions", "dependentSchemas")
_LISTS = ("prefixItems", "allOf", "anyOf", "oneOf")
_ONES = ("items", "additionalProperties", "contains", "not", "if", "then", "else")
_OCTETS = {
    "type": "array",
    "items": {"type": "integer", "minimum": 0, "maximum": 255},
    "x-octets": True,
}


@frozen
class ChannelReading:
    """How a channel is read.

    Attributes:
        structure: of its messages; None where the file does not state it.
        decode: returns the message that octets stand for; raises MessageError.
    """

    structure: MessageStructure | None
    decode: Callable[[bytes | memoryview], Message]


def reading_of(channel: FileChannel) -> ChannelReading:
    """Return how a channel is read.

    Raises:
        BridgeError: its messages or its schema are of a kind that is not read, or are broken.
    """
    kinds = channel.encoding, channel.schema_encoding
    definition = RosDefinition(channel.schema_name, channel.schema_data.decode("utf-8", "replace"))
    try:
        stated = _stated(channel)
        if kinds == ("cdr", "ros2msg"):
            structure = structure_of_definition(definition) if stated is None else stated
            return ChannelReading(structure, deserialiser(structure, budget=_BUDGET))
        if kinds == ("ros1", "ros1msg"):
            structure = structure_of_definition(definition, is_ros_1=True)
            return ChannelReading(
                structure, deserialiser(structure, budget=_BUDGET, is_packed=True)
            )
        if channel.encoding == "json" and channel.schema_encoding in {"jsonschema", ""}:
            if stated is None and channel.schema_encoding:
                schema = _logical(_parsed(channel.schema_data))
                stated = MessageStructure(schema, native_type=channel.schema_name)
            return ChannelReading(stated, _json_reader(stated))
    except (MessageError, ValueError) as error:
        text = f"channel {channel.topic}: its schema {channel.schema_name!r:.100}: {error}"
        raise BridgeError(text, FailureReason.BAD_MESSAGE) from error
    text = (
        f"channel {channel.topic} has messages as {channel.encoding[:40]!r} with schemas as "
        f"{channel.schema_encoding[:40]!r}: what is read is cdr with ros2msg, ros1 with ros1msg, "
        "and json with jsonschema"
    )
    raise BridgeError(text, FailureReason.UNSUPPORTED)


def _stated(channel: FileChannel) -> MessageStructure | None:
    """Return the structure as uoarm itself wrote it, None for files of others."""
    text = channel.metadata.get("uoarm.structure")
    if text is None:
        return None
    found = _parsed(text.encode())
    if not isinstance(found, Mapping) or not isinstance(found.get("schema"), Mapping | bool):
        raise ValueError("its metadata hold no structure")  # noqa: TRY004 - of a file
    return MessageStructure(found["schema"], native_type=str(found.get("native_type", "")))


def _parsed(text: bytes) -> Any:
    if len(text) > _MOST_SCHEMA:
        raise ValueError(f"it has {len(text):,} octets; {_MOST_SCHEMA:,} are read")
    return read_json(text)


def _logical(schema: Any, depth: int = 0) -> Any:
    """Return the schema of logical values: what is base64 in JSON is octets."""
    if not isinstance(schema, Mapping):
        if isinstance(schema, bool):
            return schema
        raise ValueError("it is no JSON Schema")
    if depth > _MOST_DEPTH:
        raise ValueError(f"it is nested more than {_MOST_DEPTH} levels deep")
    if schema.get("type") == "string" and schema.get("contentEncoding") == "base64":
        return _OCTETS
    made: dict[str, Any] = dict(schema)
    for key in _MAPS:
        if isinstance(found := made.get(key), Mapping):
            made[key] = {name: _logical(item, depth + 1) for name, item in found.items()}
    for key in _LISTS:
        if isinstance(found := made.get(key), list):
            made[key] = [_logical(item, depth + 1) for item in found]
    for key in _ONES:
        if isinstance(found := made.get(key), Mapping):
            made[key] = _logical(found, depth + 1)
    return made


def _json_reader(
    structure: MessageStructure | None,
) -> Callable[[bytes | memoryview], Message]:
    from uoarm._wire import TEXT_FORM, read_text  # noqa: PLC0415 - needs the extra

    restore = None if structure is None else TEXT_FORM.reader(structure.schema)

    def decode(octets: bytes | memoryview) -> Message:
        try:
            value = read_text(str(octets, "utf-8"), Spending(_BUDGET))
        except (ControlMessageError, UnicodeDecodeError) as error:
            raise MessageError(f"cannot be read: {error}") from error
        return value if restore is None else restore(value)

    return decode
