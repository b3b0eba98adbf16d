"""Options of an endpoint, declared once: a class whose attributes are the options.

    @frozen
    class TopicOptions(EndpointOptions):
        qos: int = option(1, {"enum": [0, 1, 2]}, "how surely messages arrive")
        expiry: float = option(0.0, SECONDS, "after which the broker drops what is sent", unit="s")

`BridgeType(endpoint_options=TopicOptions)` makes the check of the configuration, what an editor
explains, and the values that the bridge gets of it; `options_table` makes the table of a page. A
further option is one more line. A class is the source, not a JSON Schema, since the type checker
then knows what the bridge reads; the schema follows from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, TypeVar

import attrs
from typing_extensions import Self

from uoarm._mistakes import Mistake, schema_mistakes
from uoarm._spelling import Speller
from uoarm._support.yaml import write_path
from uoarm.bridge._border import reading_endpoint
from uoarm.model import Endpoint, Options, Schema

__all__ = ["EndpointOptions", "option", "options_table"]

_OPTION = "uoarm option"
T = TypeVar("T")


def option(
    default: T,
    schema: Mapping[str, Any] | type[EndpointOptions],
    description: str,
    *,
    unit: str = "",
    required: bool = False,
) -> T:
    """Declare one option, as the value of an attribute of a class of `EndpointOptions`.

    Args:
        default: what it is where it is left out; None: nothing.
        schema: JSON Schema of what may be written; or another such class, for an option that is a
            mapping with options of its own.
        description: what it does, in one sentence or less, for editors, tables and people.
        unit: of its number, in UCUM, such as `s`.
        required: whether it must be given where the mapping that it stands in is.
    """
    metadata = {_OPTION: (schema, description, unit, required)}
    made: T = attrs.field(default=default, metadata=metadata)
    return made


class EndpointOptions:
    """The options of one endpoint, checked and complete: what is left out has its default.

    A class of them is an attrs class, `@frozen`, whose attributes are all `option(...)`.
    """

    __slots__ = ()

    @classmethod
    def schema(cls) -> Schema:
        """Return the JSON Schema of a mapping of these options; no others are allowed."""
        kind: Any = cls
        return _schema(kind)

    @classmethod
    def of(cls, options: Options) -> Self:
        """Read options.

        Raises:
            ValueError: they are wrong; the text names every one, what was expected and what came.
        """
        given = dict(options)
        found = schema_mistakes(given, cls.schema(), Speller())
        if wrong := [_sentence(mistake) for mistake in found]:
            raise ValueError("; ".join(wrong))
        made: Self = _made(cls, given)
        return made

    @classmethod
    def of_endpoint(cls, endpoint: Endpoint) -> Self:
        """Read the options of an endpoint.

        Raises:
            BridgeError: with BAD_ENDPOINT, the endpoint and everything that is wrong.
        """
        with reading_endpoint(endpoint):
            return cls.of(endpoint.options)


def options_table(schema: Schema, heading: str = "option") -> str:
    """Return the table of a page, in Markdown, of the options that a schema describes."""
    described: Any = schema
    required = described.get("required", ())
    rows = [f"| {heading} | default | meaning |", "|---|---|---|"]
    for name, known in described.get("properties", {}).items():
        default = "must be given" if name in required else _written(known.get("default"))
        rows.append(f"| `{name}` | {default} | {known.get('description', '')} |")
    return "\n".join(rows)


def _written(default: object) -> str:
    if default is None or default == "":
        return ""
    if isinstance(default, bool):
        return str(default).lower()
    return f"`{default}`" if isinstance(default, str) else f"{default:,}"


def _attributes(kind: Any) -> tuple[attrs.Attribute[Any], ...]:
    attributes: tuple[attrs.Attribute[Any], ...] = attrs.fields(kind)
    return attributes


@cache
def _schema(kind: Any) -> Schema:
    properties: dict[str, Any] = {}
    required: list[str] = []
    for attribute in _attributes(kind):
        schema, description, unit, is_required = attribute.metadata[_OPTION]
        known = dict(schema if isinstance(schema, Mapping) else schema.schema())
        if attribute.default is not None and not is_required:
            known["default"] = attribute.default
        if unit:
            known["x-unit"] = unit
        properties[attribute.name] = {**known, "description": description}
        if is_required:
            required.append(attribute.name)
    closed = {"type": "object", "properties": properties, "additionalProperties": False}
    return {**closed, "required": required} if required else closed


def _made(kind: Any, given: Mapping[str, Any]) -> Any:
    """Return the value of options that were checked: each as it was written, or its default."""
    values = {}
    for attribute in _attributes(kind):
        if attribute.name in given:
            schema, value = attribute.metadata[_OPTION][0], given[attribute.name]
            values[attribute.name] = value if isinstance(schema, Mapping) else _made(schema, value)
    return kind(**values)


def _sentence(mistake: Mistake) -> str:
    path, sentence, hint, _ = mistake
    place = f"option {write_path(path)}: " if path else ""
    return f"{place}{sentence}{f' ({hint})' if hint else ''}"
