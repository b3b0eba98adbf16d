"""The standard's own JSON Schemas, from a folder that the user names."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator, SchemaError

from uoarm.errors import ConfigurationError
from uoarm.model import MessageStructure, read_json
from uoarm_vda5050._releases import TOPICS, Release
from uoarm_vda5050._structures import HEADER, body_of

__all__ = ["Published", "read_published"]

_MOST_OCTETS = 1 << 20


class Published:
    """Schemas of whole messages by topic; topics without a file have the plugin's own structure."""

    def __init__(self, release: Release, schemas: Mapping[str, Any]) -> None:
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


def read_published(folder: str, release: Release) -> dict[str, Any]:
    """Read the schemas of a release from a folder: `order.schema` and so on, or `order.json`.

    Raises:
        ConfigurationError: the folder has none, or one of its files is no JSON Schema; the text
            names the file and the line, and says what to do.
    """
    place = Path(folder).expanduser()
    found: dict[str, Any] = {}
    for topic in TOPICS:
        for ending in ("schema", "json"):
            file = place / f"{topic}.{ending}"
            if file.is_file():
                found[topic] = _read(file, release)
                break
    if not found:
        names = ", ".join(f"{topic}.schema" for topic in TOPICS)
        text = f"schemas: the folder {place} has none of the files {names}"
        raise ConfigurationError(f"{text}: name the folder json_schemas of release {release.name}")
    return found


def _read(file: Path, release: Release) -> Any:
    try:
        octets = file.read_bytes()
        schema = _decoded(octets)
        Draft202012Validator.check_schema(schema)
    except json.JSONDecodeError as error:
        raise ConfigurationError(_no_json(file, error, release)) from None
    except (OSError, ValueError, RecursionError, SchemaError) as error:
        report = error.message if isinstance(error, SchemaError) else error
        raise ConfigurationError(f"schemas: {file}: no JSON Schema: {report}") from None
    schema.pop("$schema", None)
    return schema


def _decoded(octets: bytes) -> dict[str, Any]:
    if len(octets) > _MOST_OCTETS:
        raise ValueError(f"{len(octets):,} octets; {_MOST_OCTETS:,} are allowed")
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


def _no_json(file: Path, error: json.JSONDecodeError, release: Release) -> str:
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
