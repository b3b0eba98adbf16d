"""The protocol without I/O: frames read and written, and how the messages in them are encoded."""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Collection, Mapping
from enum import Enum
from typing import Any, TypeAlias, TypeVar

import orjson
from attrs import frozen

from uoarm import cdr
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Budget, BudgetUse, Message, MessageStructure
from uoarm.server.front_end import TEXT_FORM, Read, read_message, read_text, viewer_schema

JSON, CDR = "json", "cdr"
_MESSAGE, _CALL = 1, 2  # of both sides; a server's 2 is the time, which nothing here sends
_SERVICE_RESPONSE = 3
_pack_message = struct.Struct("<BIQ").pack
_read_number = struct.Struct("<I").unpack_from
_CALL_HEAD = struct.Struct("<BIII")
_LONGEST_ENCODING = 32
_LONGEST_TEXT = 200
T = TypeVar("T")
_MOST_NUMBER = 2**32 - 1


class StatusLevel(Enum):
    """How grave a status message is."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@frozen
class PublishedFrame:
    """A message of a client to one of its own channels."""

    channel: int
    payload: bytes


@frozen
class ServiceRequest:
    """A call of a service."""

    service: int
    call: int
    encoding: str
    payload: bytes


ClientFrame: TypeAlias = "PublishedFrame | ServiceRequest | Mapping[str, Any]"


def read_frame(frame: str | bytes, spending: BudgetUse) -> ClientFrame:
    """Return what a client sent: the fields of a text, or one of the two binary messages.

    Raises:
        ControlMessageError: it is none of these, or costs more than its budget.
    """
    if isinstance(frame, str):
        fields = read_text(frame, spending)
        if not isinstance(fields, dict):
            raise ControlMessageError(f"expected an object with 'op', got {type(fields).__name__}")
        return fields
    spending.octets(len(frame))
    if len(frame) >= 5 and frame[0] == _MESSAGE:  # noqa: PLR2004 - the operation and a number
        return PublishedFrame(_read_number(frame, 1)[0], frame[5:])
    if len(frame) >= _CALL_HEAD.size and frame[0] == _CALL:
        _, service, call, length = _CALL_HEAD.unpack_from(frame)
        start = _CALL_HEAD.size
        if length > min(_LONGEST_ENCODING, len(frame) - start):
            # None that is served: whose call it is is known, and it is answered as one.
            return ServiceRequest(service, call, f"of {length:,} octets", b"")
        encoding = frame[start : start + length].decode(errors="replace")
        return ServiceRequest(service, call, encoding, frame[start + length :])
    first = f"begins with {frame[0]}" if frame else "is empty"
    raise ControlMessageError(
        f"a binary message of {len(frame):,} octets {first}; expected 1 (a message: the number of "
        "a channel, then its octets) or 2 (a service call)"
    )


def message_data(subscription: int, nanoseconds: int, payload: bytes) -> bytes:
    """Return one message of a subscription.

    Args:
        subscription: the number that the client gave it.
        nanoseconds: when the server had it, since 1970.
        payload: the message in the channel's encoding.
    """
    return _pack_message(_MESSAGE, subscription, nanoseconds) + payload


def service_response(request: ServiceRequest, encoding: str, payload: bytes) -> bytes:
    """Return the answer to a call, whose octets are of an encoding."""
    name = encoding.encode()
    head = _CALL_HEAD.pack(_SERVICE_RESPONSE, request.service, request.call, len(name))
    return head + name + payload


def write(op: str, **fields: object) -> bytes:
    """Return one text message of the server."""
    return orjson.dumps({"op": op, **fields})


def list_of(fields: Mapping[str, Any], name: str, kind: type[T]) -> list[T]:
    """Return a list of objects (dict), numbers (int) or texts (str) that a message must have.

    Raises:
        ControlMessageError: it does not.
    """
    found = fields.get(name)
    if not isinstance(found, list) or any(type(item) is not kind for item in found):
        items = "objects" if kind is dict else "texts" if kind is str else "numbers"
        raise ControlMessageError(f"{name}: expected a list of {items}")
    return found


def number_of(fields: object, name: str, known: Collection[int] | None = None) -> int:
    """Return a number of an object, or that number itself, which may have to be a known one.

    Raises:
        ControlMessageError: there is none, or another.
    """
    found = fields.get(name) if isinstance(fields, dict) else fields
    if isinstance(found, bool) or not isinstance(found, int) or not 0 <= found <= _MOST_NUMBER:
        raise ControlMessageError(f"{name}: expected a number from 0 to {_MOST_NUMBER}")
    if known is not None and found not in known:
        raise ControlMessageError(f"{name}: there is no {found}")
    return found


def text_of(fields: object, name: str) -> str:
    """Return a text of an object.

    Raises:
        ControlMessageError: there is none, or it is too long.
    """
    found = fields.get(name) if isinstance(fields, dict) else None
    if not isinstance(found, str) or len(found) > _LONGEST_TEXT:
        raise ControlMessageError(f"{name}: expected a text of at most {_LONGEST_TEXT} characters")
    return found


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
        definition = cdr.definition_of(structure, name)
        serialise = cdr.serialiser(structure)
    except MessageError:
        schema = viewer_schema(structure.schema)
        return StructureCodec(
            JSON, structure.native_type or name, _JSON_SCHEMA, schema, TEXT_FORM.write
        )

    def write(message: Message) -> bytes:
        return b"".join(serialise(message))

    return StructureCodec(CDR, definition.name, _ROS_2, definition.text, write)


def read_as(encoding: str, budget: Budget, stated: str = "") -> Read:
    """Return what decodes octets of a client by the structure of where they go.

    Args:
        encoding: of the octets.
        budget: what one message may cost.
        stated: the type that the client says they are of; empty: it says none.

    Raises:
        MessageError: the encoding is not served.
    """
    if encoding not in (CDR, JSON):
        raise MessageError(f"the encoding {encoding!r:.60} is not served: expected cdr or json")
    if encoding == JSON:
        return functools.partial(_read_json, budget)
    return functools.partial(_read_cdr, budget, stated)


def _read_json(budget: Budget, structure: MessageStructure, payload: Message) -> Message:
    assert isinstance(payload, bytes)
    try:
        text = payload.decode()
    except UnicodeDecodeError as error:
        raise MessageError(f"not JSON: {error}") from error
    return read_message(TEXT_FORM, structure, read_text(text, BudgetUse(budget)))


def _read_cdr(
    budget: Budget, stated: str, structure: MessageStructure, payload: Message
) -> Message:
    assert isinstance(payload, bytes)
    return _deserialiser(structure, budget, stated)(payload)


@functools.lru_cache(maxsize=256)
def _deserialiser(
    structure: MessageStructure, budget: Budget, stated: str
) -> Callable[[bytes], Message]:
    own = structure.native_type
    # In CDR nothing else distinguishes a float from an integer, a velocity from a position.
    if (
        "/msg/" in own
        and "/" in stated
        and stated.replace("/msg/", "/") != own.replace("/msg/", "/")
    ):
        raise MessageError(f"expected a message of {own}, got one of {stated}")
    return cdr.deserialiser(structure, budget=budget)
