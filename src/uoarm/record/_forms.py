"""In which form a function's messages stand in a file, and their structure and values read back.

What is a type of ROS 2 is serialised as such, and so is what has octets and a fixed layout, so
that they stay octets. All else is JSON, in which octets are base64, as viewers take them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from attrs import field, frozen

from uoarm import cdr
from uoarm.errors import BridgeError, ControlMessageError, FailureReason, MessageError
from uoarm.model import Budget, BudgetUse, Message, MessageStructure, read_json, write_json
from uoarm.record._reading import FileChannel
from uoarm.schema import change_parts

_ROS_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9_]*")
_WORD = re.compile(r"[A-Za-z0-9]+")
_LARGE = ("uint64", "int64")
_MOST_DEPTH = 64


@frozen(cache_hash=True)
class ChannelForm:
    """How the messages of one channel are written.

    Attributes:
        schema_encoding: `ros2msg` or `jsonschema`.
        message_encoding: `cdr` or `json`.
        encode: returns a message's octets; raises MessageError.
    """

    topic: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    encode: Callable[[Message], bytes] = field(eq=False)
    metadata: Mapping[str, str] = field(factory=dict, hash=False)


def form_of(function: str, structure: MessageStructure, metadata: Mapping[str, str]) -> ChannelForm:
    """Return the form of what a function gives.

    Args:
        function: as it was asked for: `camera`, or `camera.debug` of several outputs.
        structure: of its messages.
        metadata: that its channel has beside the structure.
    """
    topic = "/" + function.replace(".", "/")
    stated = {"schema": structure.schema, "native_type": structure.native_type}
    all_metadata = {
        **metadata,
        "uoarm.function": function,
        "uoarm.structure": json.dumps(stated, separators=(",", ":")),
    }
    is_ros = _ROS_TYPE.fullmatch(structure.native_type) is not None
    if is_ros or _keeps_octets(structure.schema):
        try:
            definition = cdr.definition_of(structure, _type_name(function))
            encode = cdr.Codec(structure).encode
        except MessageError:
            pass  # it has no fixed layout, or names that no message file may have
        else:
            return _cdr_form(topic, definition, encode, all_metadata)
    from uoarm._wire import viewer_schema, write_text  # noqa: PLC0415 - needs an extra

    write = write_text if _has_octets(structure.schema) else _text_writer(write_text)
    schema = viewer_schema(structure.schema).encode()
    name = structure.native_type or function
    return ChannelForm(topic, name, "jsonschema", schema, "json", write, all_metadata)


def _has_octets(schema: object) -> bool:
    return schema is True or _look(schema, 0)[0]


def _text_writer(write: Callable[[Message], bytes]) -> Callable[[Message], bytes]:
    """Return what writes most messages without octets in a quarter of the time, all alike."""
    import orjson  # noqa: PLC0415 - of an extra

    def quick(message: Message) -> bytes:
        try:
            text = orjson.dumps(message, option=orjson.OPT_STRICT_INTEGER)
        except TypeError:
            return write(message)
        return write(message) if b"null" in text else text  # which may stand for NaN

    return quick


def _cdr_form(
    topic: str,
    definition: cdr.RosDefinition,
    encode: Callable[[Message], bytes],
    metadata: Mapping[str, str],
) -> ChannelForm:
    text = definition.text.encode()
    return ChannelForm(topic, definition.name, "ros2msg", text, "cdr", encode, metadata)


def _type_name(function: str) -> str:
    """Return the name of a type of ROS for a function that has none."""
    words = "".join(word[:1].upper() + word[1:] for word in _WORD.findall(function))
    return f"uoarm/msg/{words if words[:1].isalpha() else f'Function{words}'}"


def _keeps_octets(schema: object) -> bool:
    """Say whether a structure has octets, and every number in it a width that nothing exceeds."""
    has_octets, is_bounded = _look(schema, 0)
    return has_octets and is_bounded


def _look(schema: object, depth: int) -> tuple[bool, bool]:
    if not isinstance(schema, Mapping) or depth > _MOST_DEPTH:
        return False, False
    if schema.get("x-octets") is True:
        return True, True
    if schema.get("type") == "integer":
        bounds = schema.get("minimum"), schema.get("maximum")
        native = str(schema.get("x-native-type"))
        return False, None not in bounds or native in _LARGE
    inner = [*schema.get("properties", {}).values()]
    if schema.get("type") == "array":
        inner.append(schema.get("items"))
    looks = [_look(item, depth + 1) for item in inner]
    return any(has for has, _ in looks), all(bounded for _, bounded in looks)


EVENTS_TOPIC = "/uoarm/events"
_TEXT = {"type": "string"}
_EVENT_SCHEMA = {
    "type": "object",
    "title": "what happened in the robot, and to the recording",
    "properties": {
        "number": {"type": "integer", "minimum": 0},
        "time": {"type": "number", "x-unit": "s"},
        "subject": _TEXT,
        "change": _TEXT,
        "cause": _TEXT,
        "function": _TEXT,
        "gap": {"type": "object", "properties": {}},
    },
    "required": ["subject", "change", "cause", "function"],
}


EVENTS = ChannelForm(
    EVENTS_TOPIC, "uoarm.Event", "jsonschema", write_json(_EVENT_SCHEMA).encode(), "json",
    lambda message: write_json(message).encode(),
)  # fmt: skip
"""The channel of events, in every file with other channels of JSON."""

_ROS_EVENT = """uint64 number
float64 time
string subject
string change
string cause
string function
string gap
"""


@lru_cache(maxsize=1)
def ros_events() -> ChannelForm:
    """Return the channel of events in a file of ROS 2 alone, whose readers know nothing else."""
    definition = cdr.RosDefinition("uoarm/msg/Event", _ROS_EVENT)
    write = cdr.Codec(cdr.structure_of_definition(definition)).encode_parts

    def encode(message: Message) -> bytes:
        gap = write_json(message["gap"]) if "gap" in message else ""
        complete = {"number": 0, "time": 0.0, **message, "gap": gap}
        return b"".join(write({name: complete[name] for name in _ROS_EVENT.split()[1::2]}))

    text = definition.text.encode()
    return ChannelForm(EVENTS_TOPIC, definition.name, "ros2msg", text, "cdr", encode)


RECORDED = "x-recorded"
"""Marks a structure of what was recorded: no input that moves something takes it."""

_BUDGET = Budget(octets=268_435_456, elements=5_000_000)
_MOST_SCHEMA = 4 << 20
_OCTETS = {
    "type": "array",
    "items": {"type": "integer", "minimum": 0, "maximum": 255},
    "x-octets": True,
}


@frozen
class ChannelReading:
    """How a channel is read.

    Attributes:
        structure: of its messages; None where the file does not state it, or in a draft of JSON
            Schema that is not known.
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
    definition = cdr.RosDefinition(
        channel.schema_name, channel.schema_data.decode("utf-8", "replace")
    )
    try:
        stated = _stated(channel)
        if kinds == ("cdr", "ros2msg"):
            structure = cdr.structure_of_definition(definition) if stated is None else stated
            return ChannelReading(structure, cdr.deserialiser(structure, budget=_BUDGET))
        if kinds == ("ros1", "ros1msg"):
            structure = cdr.structure_of_definition(definition, is_ros_1=True)
            return ChannelReading(
                structure, cdr.deserialiser(structure, budget=_BUDGET, is_packed=True)
            )
        if channel.encoding == "json" and channel.schema_encoding in {"jsonschema", ""}:
            if stated is None and channel.schema_encoding:
                stated = _structure_of(channel)
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


def _structure_of(channel: FileChannel) -> MessageStructure | None:
    """Return the structure that another program wrote, None where its draft is not known."""
    from uoarm.schema import SchemaError, newest  # noqa: PLC0415 - when first needed

    schema = _parsed(channel.schema_data)
    try:
        schema = newest(schema)
    except SchemaError:
        return None
    return MessageStructure(_logical(_sound(schema)), native_type=channel.schema_name)


def _sound(schema: Any) -> Any:
    """Return a schema of another program's; raises ValueError where it is no JSON Schema."""
    from jsonschema import Draft202012Validator, SchemaError  # noqa: PLC0415 - when first needed

    try:
        Draft202012Validator.check_schema(schema)
    except SchemaError as error:
        place = "/".join(map(str, error.absolute_path))
        raise ValueError(f"it is no JSON Schema: {place}: {error.message:.200}") from None
    except RecursionError:
        raise ValueError("it is nested too deep") from None
    return schema


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
    return change_parts(schema, lambda part: _logical(part, depth + 1))


def _json_reader(
    structure: MessageStructure | None,
) -> Callable[[bytes | memoryview], Message]:
    from uoarm._wire import TEXT_FORM, read_text  # noqa: PLC0415 - needs the extra

    restore = None if structure is None else TEXT_FORM.reader(structure.schema)

    def decode(octets: bytes | memoryview) -> Message:
        try:
            value = read_text(str(octets, "utf-8"), BudgetUse(_BUDGET))
        except (ControlMessageError, UnicodeDecodeError) as error:
            raise MessageError(f"cannot be read: {error}") from error
        return value if restore is None else restore(value)

    return decode
