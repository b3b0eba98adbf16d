"""How messages of a structure are encoded for viewers, and what viewers send is decoded."""

from __future__ import annotations

import functools
from collections.abc import Callable

import orjson
from attrs import frozen

from uoarm.cdr import definition_of, deserialiser, serialiser
from uoarm.errors import MessageError
from uoarm.model import Budget, BudgetUse, Message, MessageStructure
from uoarm.server.front_end import TEXT_FORM, Read, read_message, read_text
from uoarm_foxglove._protocol import CDR, JSON

__all__ = ["StructureCodec", "codec_of"]

Structure = MessageStructure
_JSON_SCHEMA, _ROS_2 = "jsonschema", "ros2msg"


@frozen
class StructureCodec:
    """An encoding of one structure.

    Attributes:
        encoding: `cdr` or `json`.
        schema_name: the type's name.
        schema_encoding: `ros2msg` or `jsonschema`.
        schema: its text.
        write: makes the octets of a message; raises MessageError where it has no form.
    """

    encoding: str
    schema_name: str
    schema_encoding: str
    schema: str
    write: Callable[[Message], bytes]

    @property
    def stated(self) -> dict[str, str]:
        """How a service's request or reply is announced."""
        return {
            "encoding": self.encoding,
            "schemaName": self.schema_name,
            "schemaEncoding": self.schema_encoding,
            "schema": self.schema,
        }


def codec_of(structure: MessageStructure, name: str) -> StructureCodec:
    """Return the encoding of a structure: CDR where its layout is fixed, as that of ROS, else JSON.

    Args:
        structure: of the messages.
        name: of the type where the structure is of none, `package/msg/Name`.
    """
    try:
        definition = definition_of(structure, name)
        serialise = serialiser(structure)
    except MessageError:
        schema = orjson.dumps(TEXT_FORM.schema(structure.schema)).decode()
        return StructureCodec(
            JSON, structure.native_type or name, _JSON_SCHEMA, schema, TEXT_FORM.write
        )

    def write(message: Message) -> bytes:
        return b"".join(serialise(message))

    return StructureCodec(CDR, definition.name, _ROS_2, definition.text, write)


def read_as(encoding: str, budget: Budget) -> Read:
    """Return what decodes octets of a client by the structure of where they go.

    Raises:
        MessageError: the encoding is not served.
    """
    if encoding not in (CDR, JSON):
        raise MessageError(f"the encoding {encoding!r:.60} is not served: expected cdr or json")
    return functools.partial(_read_cdr if encoding == CDR else _read_json, budget)


def _read_json(budget: Budget, structure: MessageStructure, payload: Message) -> Message:
    assert isinstance(payload, bytes)
    try:
        text = payload.decode()
    except UnicodeDecodeError as error:
        raise MessageError(f"not JSON: {error}") from error
    return read_message(TEXT_FORM, structure, read_text(text, BudgetUse(budget)))


def _read_cdr(budget: Budget, structure: MessageStructure, payload: Message) -> Message:
    assert isinstance(payload, bytes)
    return _deserialiser(structure, budget)(payload)


@functools.lru_cache(maxsize=256)
def _deserialiser(structure: MessageStructure, budget: Budget) -> Callable[[bytes], Message]:
    return deserialiser(structure, budget=budget)
