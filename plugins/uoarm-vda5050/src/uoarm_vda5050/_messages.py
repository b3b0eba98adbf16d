"""Messages with their header: written, read, and held against a structure."""

from __future__ import annotations

import itertools
import json
import os
import threading
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from attrs import field, frozen
from jsonschema import Draft202012Validator, SchemaError
from uoarm_mqtt.connection import PayloadCodec

from uoarm.bridge import message_check
from uoarm.errors import ConfigurationError, MessageError
from uoarm.model import Budget, Message, MessageStructure, read_json
from uoarm.plugins import expanded, read_octets
from uoarm.schema import newest
from uoarm_vda5050._releases import HEADER, TOPICS, VdaRelease, body_of

HEADER_OCTETS = 320
"""About how many a header has at most, with names of the usual length."""
HEADER_IDS = 2**32
"""How many there are: the counter of a header is one of 32 bits."""

Check = Callable[[Message], object]
"""Raises MessageError for a message that is wrong."""


class Headers:
    """The headers of what is sent to, or by, one vehicle. Thread safe."""

    def __init__(self, release: VdaRelease, manufacturer: str, serial_number: str) -> None:
        self._fixed = {
            "version": release.version,
            "manufacturer": manufacturer,
            "serialNumber": serial_number,
        }
        self._counts: dict[str, itertools.count[int]] = {}
        self._lock = threading.Lock()

    def next(self, topic: str) -> dict[str, Any]:
        """Return the header of the next message on a topic."""
        with self._lock:
            count = next(self._counts.setdefault(topic, itertools.count()))
        return {"headerId": count % HEADER_IDS, "timestamp": _timestamp(), **self._fixed}


def _timestamp() -> str:
    """Return the time as the standard writes it: ISO 8601, UTC, with fractions of a second."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds").replace("+00:00", "Z")


@frozen
class VdaCodec(PayloadCodec):
    """JSON with a header, which is no part of the message unless it is asked for.

    Attributes:
        topic: last level of the topic.
        headers: of what is written; None where nothing is.
        check: of whole messages.
        is_header_kept: whether what is read keeps its header.
    """

    release: VdaRelease = field(kw_only=True)
    topic: str = field(kw_only=True)
    headers: Headers | None = field(default=None, kw_only=True)
    check: Check = field(default=bool, kw_only=True)
    is_header_kept: bool = field(default=False, kw_only=True)

    @classmethod
    def reading(cls, structure: MessageStructure, budget: Budget, **more: Any) -> VdaCodec:
        """Return a codec for a structure."""
        return cls("json", budget, PayloadCodec.of("json", structure, budget).convert, **more)

    def encode(self, message: Message) -> bytes:
        """Return the payload of a message, with the next header.

        Raises:
            MessageError: it is none of this topic, or too large.
        """
        if not isinstance(message, dict):
            text = f"{self.topic}: expected an object, got {type(message).__name__}"
            raise MessageError(text)
        assert self.headers is not None, "what writes has headers"
        whole = {
            **self.headers.next(self.topic),
            **{k: v for k, v in message.items() if k not in HEADER},
        }
        payload = super().encode(whole)
        self.check(whole)
        return payload

    def decode(self, payload: bytes, content_type: str = "") -> Message:
        """Return the message of a payload.

        Raises:
            MessageError: it cannot be read, is of another major version, or has another structure.
        """
        return self.split(payload, content_type)[1]

    def split(self, payload: bytes, content_type: str = "") -> tuple[dict[str, Any], Message]:
        """Return header and message of a payload.

        Raises:
            MessageError: as `decode`.
        """
        whole = super().decode(payload, content_type)
        if not isinstance(whole, dict):
            raise MessageError(f"{self.topic}: expected an object, got {type(whole).__name__}")
        if wrong := self.wrong_version(whole.get("version")):
            raise MessageError(f"{self.topic}: {wrong}")
        self.check(whole)
        header = {key: whole[key] for key in HEADER if key in whole}
        if self.is_header_kept:
            return header, whole
        return header, {key: value for key, value in whole.items() if key not in HEADER}

    def wrong_version(self, version: object) -> str:
        """Say what is wrong with the version in a header, "" where nothing is."""
        if version is None or str(version).partition(".")[0] == self.release.major:
            return ""
        return f"version {str(version)[:20]!r}, while the bridge's `release` is {self.release.name}"


def check_of(schema: Any, topic: str) -> Check:
    """Return what holds whole messages against a schema of the standard, or of the user."""
    # The plugin's own have no header, which would be called unknown beside what is missing.
    properties = {**dict.fromkeys(HEADER, True), **schema["properties"]}
    return message_check(MessageStructure({**schema, "properties": properties}), topic)


_MOST_OCTETS = 1 << 20


class Published:
    """Schemas of whole messages by topic; topics without a file have the plugin's own structure."""

    def __init__(self, release: VdaRelease, schemas: Mapping[str, Any]) -> None:
        self.release, self.schemas = release, schemas

    def body(self, topic: str) -> MessageStructure:
        """Return the structure of a topic's messages without their header."""
        schema = self.schemas.get(topic)
        if schema is None:
            return body_of(topic, self.release.name)
        properties = {k: v for k, v in schema["properties"].items() if k not in HEADER}
        required = [item for item in schema.get("required", ()) if item not in HEADER]
        body = {**schema, "properties": properties, "required": required}
        return MessageStructure(body, native_type=f"vda5050/{topic}/{self.release.name}")

    def whole(self, topic: str) -> Any:
        """Return the schema that whole messages of a topic are held against."""
        schema = self.schemas.get(topic)
        return body_of(topic, self.release.name).schema if schema is None else schema


def read_published(folder: str, release: VdaRelease) -> dict[str, Any]:
    """Read the schemas of a release from a folder: `order.schema` and so on, or `order.json`.

    Raises:
        ConfigurationError: the folder has none, or one of its files is no JSON Schema; the text
            names the file and the line, and says what to do.
    """
    place = expanded(folder)
    found: dict[str, Any] = {}
    for topic in TOPICS:
        for ending in ("schema", "json"):
            file = place / f"{topic}.{ending}"
            if os.path.isfile(file):
                found[topic] = _read(file, release)
                break
    if not found:
        names = ", ".join(f"{topic}.schema" for topic in TOPICS)
        text = f"schemas: the folder {place} has none of the files {names}"
        raise ConfigurationError(f"{text}: name the folder json_schemas of release {release.name}")
    return found


def _read(file: Path, release: VdaRelease) -> Any:
    try:
        schema = newest(_decoded(read_octets(file, _MOST_OCTETS)))
        Draft202012Validator.check_schema(schema)
    except json.JSONDecodeError as error:
        raise ConfigurationError(_no_json(file, error, release)) from None
    except (ValueError, RecursionError, SchemaError) as error:
        report = error.message if isinstance(error, SchemaError) else error
        raise ConfigurationError(f"schemas: {file}: no JSON Schema: {report}") from None
    return schema


def _decoded(octets: bytes) -> dict[str, Any]:
    schema = read_json(octets.decode("utf-8-sig"))
    if not isinstance(schema, dict) or not isinstance(schema.get("properties"), dict):
        text = "it is no schema of an object, for want of `properties`"
        if isinstance(schema, dict) and schema.keys() >= {"type", "headerId"}:
            text += (
                "; its fields stand beside them, as release 2.0.0 published its factsheet. Correct"
                " the file; or remove it, and the plugin's own structure is used instead"
            )
        raise ValueError(text)  # noqa: TRY004 - one error for all
    return schema


def _no_json(file: Path, error: json.JSONDecodeError, release: VdaRelease) -> str:
    line, what = error.lineno, error.msg
    # CPython finds fault with what comes behind the last comma; from 3.13 on with the comma.
    comma = error.doc.rfind(",", 0, error.pos + 1)
    behind = error.doc[comma + 1 :].lstrip()
    if comma >= 0 and error.pos <= len(error.doc) - len(behind) and behind[:1] in {"}", "]"}:
        line = error.doc.count("\n", 0, comma) + 1
        what = f"the comma before {behind[0]!r} must go"
    text = f"schemas: {file}, line {line}: no JSON: {what}."
    if release.name == "3.0":
        text += (
            " Three schemas of release 3.0.0 were published like this (order, factsheet,"
            " visualization)."
        )
    return f"{text} Correct the file; or remove it, and the plugin's own structure is used instead."
