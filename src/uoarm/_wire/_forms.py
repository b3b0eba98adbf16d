"""The two forms of a control message on the wire: JSON text, and CBOR in binary frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

from uoarm._wire._binary import join_list, join_map, read_binary, write_binary
from uoarm._wire._text import make_reader, read_text, text_schema, write_text, write_text_parts
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Message, Schema, Spending

__all__ = ["BINARY_FORM", "FORMS", "TEXT_FORM", "Form", "write_or_error"]


class Form(ABC):
    """How messages are written and read; stateless, so one of each serves all clients.

    Attributes:
        name: `json` or `cbor`.
        subprotocol: the WebSocket subprotocol that asks for it.
        text: whether it goes into text frames.
    """

    name: str
    subprotocol: str
    text: bool

    @abstractmethod
    def write(self, message: Message) -> bytes:
        """Return a control message or any value as it goes onto the wire.

        Raises:
            MessageError: it has no form.
        """

    @abstractmethod
    def write_data(
        self, connection: str, number: int, message: Message, *, standing: bool = False
    ) -> bytes:
        """Return one Data message, the same bytes for every client; raises as `write`.

        One that is `standing` came before the client did.
        """

    @abstractmethod
    def list_of(self, parts: Sequence[bytes]) -> bytes:
        """Return a list of values that are written already."""

    @abstractmethod
    def map_of(self, parts: Mapping[str, bytes]) -> bytes:
        """Return a mapping whose values are written already."""

    @abstractmethod
    def read(self, frame: str | bytes, spending: Spending) -> Mapping[str, Any]:
        """Return the fields of a control message, in any thread.

        Raises:
            ControlMessageError: it cannot be read, or costs more than its budget.
        """

    @abstractmethod
    def reader(self, schema: Schema) -> Callable[[Message], Message] | None:
        """Return what turns a message as it was read into its logical value; None: nothing."""

    @abstractmethod
    def schema(self, schema: Schema) -> Schema:
        """Return the schema of messages in this form."""


@final
class _TextForm(Form):
    name, subprotocol, text = "json", "uoarm.v1.json", True

    def write(self, message: Message) -> bytes:
        return write_text(message)

    def write_data(
        self, connection: str, number: int, message: Message, *, standing: bool = False
    ) -> bytes:
        head = f'{{"op":"Data","type":"{connection}","x-number":{number},'
        head += '"x-standing":true,"jsonMessage":' if standing else '"jsonMessage":'
        return b"".join((head.encode(), *write_text_parts(message), b"}"))

    def list_of(self, parts: Sequence[bytes]) -> bytes:
        return b"[" + b",".join(parts) + b"]"

    def map_of(self, parts: Mapping[str, bytes]) -> bytes:
        pieces = [b"{"]
        for name, part in parts.items():
            pieces += (b"" if len(pieces) == 1 else b",", write_text(name), b":", part)
        return b"".join((*pieces, b"}"))

    def read(self, frame: str | bytes, spending: Spending) -> Mapping[str, Any]:
        if isinstance(frame, bytes):
            raise ControlMessageError(
                f"a binary frame: expected JSON text; offer {BINARY_FORM.subprotocol} for CBOR"
            )
        return _fields(read_text(frame, spending))

    def reader(self, schema: Schema) -> Callable[[Message], Message] | None:
        return make_reader(schema)

    def schema(self, schema: Schema) -> Schema:
        return text_schema(schema)


@final
class _BinaryForm(Form):
    name, subprotocol, text = "cbor", "uoarm.v1.cbor", False

    def write(self, message: Message) -> bytes:
        return write_binary(message)

    def write_data(
        self, connection: str, number: int, message: Message, *, standing: bool = False
    ) -> bytes:
        head = {"op": "Data", "type": connection, "x-number": number}
        head |= {"x-standing": True} if standing else {}
        return write_binary({**head, "jsonMessage": message})

    def list_of(self, parts: Sequence[bytes]) -> bytes:
        return join_list(parts)

    def map_of(self, parts: Mapping[str, bytes]) -> bytes:
        return join_map(parts)

    def read(self, frame: str | bytes, spending: Spending) -> Mapping[str, Any]:
        if isinstance(frame, str):
            raise ControlMessageError(
                f"a text frame: expected CBOR; offer {TEXT_FORM.subprotocol} for JSON"
            )
        return _fields(read_binary(frame, spending))

    def reader(self, schema: Schema) -> None:
        del schema

    def schema(self, schema: Schema) -> Schema:
        return schema


def _fields(value: Any) -> Mapping[str, Any]:
    if isinstance(value, dict):
        return value
    raise ControlMessageError(f"expected an object, got {type(value).__name__}")


def write_or_error(form: Form, reply: Mapping[str, Any]) -> bytes:
    """Return an answer on the wire; where its message has no form, an Error that says so."""
    try:
        return form.write(reply)
    except MessageError as error:
        reports = {"code": "message", "text": str(error)}
        return form.write({**reply, "op": "Error", "jsonMessage": reports})


TEXT_FORM: Form = _TextForm()
BINARY_FORM: Form = _BinaryForm()
FORMS: Mapping[str, Form] = {form.subprotocol: form for form in (TEXT_FORM, BINARY_FORM)}
