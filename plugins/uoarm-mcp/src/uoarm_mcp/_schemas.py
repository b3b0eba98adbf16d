"""The JSON Schemas of tools: of the structures of a function, and of what every robot has."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import orjson
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Budget, BudgetUse, Message, MessageStructure, closed_object
from uoarm.schema import change_parts, enclose
from uoarm.server.front_end import TEXT_FORM, read_text

APPROVAL = "x-approval"
COUNT = 100
SECONDS = 30.0
_WHOLE = "message"
_HEADER = "x-mcp-header"
_COMBINED = frozenset({"$ref", "$dynamicRef", "allOf", "anyOf", "oneOf", "not", "if"})
_CONDITIONS = frozenset({"not", "if"})  # there a schema that takes more lets less through
_EXACT = 2**53 - 1  # the greatest number of which each whole one below has a form of its own
_BOUNDS = frozenset({"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"})
_DIGITS = "^-?(0|[1-9][0-9]*)$"
_NUMBER = "^(-?(0|[1-9][0-9]*|Infinity)|NaN)$"
_HANDLE = {"type": "string", "minLength": 1, "maxLength": 64}
_NAME = {"type": "string", "minLength": 1, "maxLength": 256}
_ENVELOPE = {
    "type": "object",
    "description": "What may differ from the arguments, where more than one use is asked for.",
    "properties": {
        "ranges": {
            "type": "object",
            "maxProperties": 64,
            "description": "Least and greatest number by the path of a field, such as linear.x.",
            "additionalProperties": {
                "type": "array",
                "items": {"type": "number"},
                "minItems": 2,
                "maxItems": 2,
            },
        },
        "count": {"type": "integer", "minimum": 1, "maximum": 1000},
        "rate": {"type": "number", "exclusiveMinimum": 0, "description": "Times a second."},
    },
    "additionalProperties": False,
}


OWN_INPUTS: Mapping[str, Mapping[str, Any]] = {
    "plan": closed_object(
        {
            "function": _NAME,
            "operation": {
                "enum": ["call", "send", "request"],
                "description": "What is to be done: call a service, send to an input, or receive.",
            },
            "arguments": {"description": "With which; of send and call."},
            "port": {**_NAME, "description": "Of send: the input, where there are several."},
            "envelope": _ENVELOPE,
            "seconds": {
                "type": "number",
                "exclusiveMinimum": 0,
                "maximum": 3600,
                "description": "Within which it is done, from the approval on.",
            },
        },
        ["function"],
    ),
    "status": closed_object({}),
    "explain_failure": closed_object({"function": _NAME, "handle": _HANDLE}, []),
    "discover": closed_object({}),
    "stop": closed_object({}),
    "goal_status": closed_object({"handle": _HANDLE}),
    "wait": closed_object(
        {
            "handle": _HANDLE,
            "seconds": {"type": "number", "minimum": 0, "maximum": SECONDS},
        },
        ["handle"],
    ),
    "cancel": closed_object({"handle": _HANDLE}),
}


class ToolArguments:
    """How the arguments of a tool carry a message of a structure.

    A message that is an object is the arguments themselves, with `x-approval` beside its fields;
    any other one is their field `message`.
    """

    def __init__(self, structure: MessageStructure) -> None:
        schema = plain_schema(structure)
        properties = schema.get("properties", {})
        self._is_whole = not (
            schema.get("type") == "object"
            and not _COMBINED & schema.keys()
            and not any(name.startswith("x-") for name in properties)
        )
        beside = {APPROVAL: {**_HANDLE, "description": "The approval that this is done with."}}
        if self._is_whole:
            self.schema = enclose(
                schema, lambda moved: closed_object({_WHOLE: moved, **beside}, [_WHOLE])
            )
        else:
            self.schema = {**schema, "properties": {**properties, **beside}}

    def split(self, arguments: Mapping[str, Any]) -> tuple[Message, str]:
        """Return the message of a tool's arguments, and the approval, empty where there is none.

        Raises:
            MessageError: they hold no message.
        """
        approval = arguments.get(APPROVAL, "")
        if not isinstance(approval, str) or len(approval) > _HANDLE["maxLength"]:  # type: ignore[operator]
            raise MessageError(f"{APPROVAL}: expected the handle of an approval")
        rest = {name: value for name, value in arguments.items() if name != APPROVAL}
        if not self._is_whole:
            return rest, approval
        if rest.keys() != {_WHOLE}:
            raise MessageError(f"expected the one field {_WHOLE!r}, got {sorted(rest)!r:.200}")
        return rest[_WHOLE], approval

    def join(self, message: Message, approval: str) -> dict[str, Any]:
        """Return the arguments that carry a message, as they are given with an approval."""
        whole = {_WHOLE: message} if self._is_whole else dict(message)
        return {**whole, APPROVAL: approval}


@lru_cache(256)
def tool_arguments(structure: MessageStructure) -> ToolArguments:
    """Return how arguments carry messages of a structure; made once for each."""
    return ToolArguments(structure)


def has_headers(schema: Any) -> bool:
    """Say whether a schema has fields that a client repeats in the headers of its request."""
    if isinstance(schema, Mapping):
        return _HEADER in schema or any(map(has_headers, schema.values()))
    return isinstance(schema, list) and any(map(has_headers, schema))


def plain_schema(structure: MessageStructure) -> dict[str, Any]:
    """Return a structure as it is in JSON text; octets are base64 there."""
    schema = TEXT_FORM.schema(structure.schema)
    if isinstance(schema, bool):
        return {} if schema else {"not": {}}
    # Not by orjson, which has no integer beyond 64 bits, as a bound may be.
    plain: dict[str, Any] = json.loads(json.dumps(schema, default=_plain))
    return plain


def read_input(outputs: tuple[str, ...]) -> dict[str, Any]:
    """Return what a tool that reads a stream takes."""
    properties: dict[str, Any] = {
        "count": {"type": "integer", "minimum": 1, "maximum": COUNT, "default": 1},
        "seconds": {
            "type": "number",
            "minimum": 0,
            "maximum": SECONDS,
            "default": 5,
            "description": "For how long to wait for them.",
        },
        "latest": {
            "type": "boolean",
            "default": True,
            "description": "Whether one that came before counts; false: only those from now on.",
        },
        "picture": {
            "type": "boolean",
            "default": False,
            "description": "Whether pictures are shown, as JPEG.",
        },
        APPROVAL: _HANDLE,
    }
    if len(outputs) > 1:
        properties["output"] = {"enum": list(outputs), "default": outputs[0]}
    return closed_object(properties, [])


def output_schema(structure: MessageStructure | None) -> dict[str, Any]:
    """Return what a tool answers that does something: how it stands, and the result."""
    made: dict[str, Any] = {
        "type": "object",
        "properties": {
            "state": {
                "type": "string",
                "description": "approval-needed, running, or how it ended in the framework's word.",
            },
            "handle": {"type": "string"},
            "summary": {"description": "In the place of a result that is long."},
            "cause": {"type": "string"},
            "approval": {"type": "object"},
            "next": {"type": "string", "description": "What to do next."},
        },
        "required": ["state"],
    }
    if structure is None:
        return made

    def around(moved: dict[str, Any]) -> dict[str, Any]:
        return {**made, "properties": {**made["properties"], "result": moved}}

    return enclose(answer_schema(structure), around)


def read_output(structure: MessageStructure) -> dict[str, Any]:
    """Return what a tool answers that reads a stream."""

    def around(moved: dict[str, Any]) -> dict[str, Any]:
        properties = {
            "messages": {"type": "array", "items": moved},
            "summaries": {"type": "array", "description": "Of messages that are long."},
            "lost": {"type": "integer", "minimum": 0},
            "ended": {"type": "string", "description": "Why no more will come."},
            "state": {"type": "string"},
            "approval": {"type": "object"},
            "next": {"type": "string"},
        }
        return {"type": "object", "properties": properties, "required": ["messages"]}

    return enclose(answer_schema(structure), around)


def answer_schema(structure: MessageStructure) -> dict[str, Any]:
    """Return the JSON Schema of all that is answered for messages of a structure.

    Clients check what a tool answers, after it was done: none may be refused. So a number may be
    the text that stands for it where JSON has none, also where the structure does not mark it.
    """
    schema = structure.schema
    if isinstance(schema, bool):
        return {} if schema else {"not": {}}
    plain: dict[str, Any] = orjson.loads(TEXT_FORM.write(_inside(schema, _widened)))
    return plain


def _widened(schema: dict[str, Any]) -> dict[str, Any]:
    if schema.get("x-octets") is True:
        return {"type": "string", "contentEncoding": "base64", "x-octets": True}
    if "const" in schema or "enum" in schema:
        values = list(schema.get("enum", [schema.get("const")]))
        said = orjson.loads(TEXT_FORM.write(values))
        if said == values:
            return schema
        rest = {name: part for name, part in schema.items() if name not in {"type", "const"}}
        return {**rest, "enum": said}
    kinds = schema.get("type")
    if not {"integer", "number"} & {*([kinds] if isinstance(kinds, str) else kinds or ())}:
        return schema
    low, high = schema.get("minimum"), schema.get("maximum")
    is_exact = low is not None and high is not None and -_EXACT <= low <= high <= _EXACT
    if is_exact and not schema.get("x-nonfinite"):
        return schema
    # What is beyond is a text, so that such a bound of numbers holds of none.
    narrow = {k: part for k, part in schema.items() if k not in _BOUNDS or abs(part) <= _EXACT}
    is_whole = kinds == "integer" or "number" not in kinds  # type: ignore[operator]
    text = {"type": "string", "pattern": _DIGITS if is_whole else _NUMBER}
    return {"anyOf": [narrow, text]}


def _inside(schema: Any, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """Return a schema in which each one within it, and then it, was changed."""
    if not isinstance(schema, Mapping):
        return schema
    return change(change_parts(schema, lambda part: _inside(part, change), but=_CONDITIONS))


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else list(value)


def id_of(text: str, budget: Budget) -> str:
    """Return the id of a request; empty: it is no request.

    Raises:
        ControlMessageError: it is no JSON, or gives a key twice: the SDK reads NaN, and takes the
            last of the two. Or the id is none that a request may have: the SDK reads that as a
            notification, and its client would wait for an answer.
    """
    message = read_text(text, BudgetUse(budget))
    if not isinstance(message, dict) or not message.keys() >= {"id", "method"}:
        return ""
    if type(message["id"]) not in {str, int}:
        raise ControlMessageError("an id is a string or a whole number")
    return str(message["id"])


def check_schema(validator: Draft202012Validator, arguments: Mapping[str, Any]) -> None:
    """Refuse arguments that do not fit; raises MessageError with the field."""
    problem = best_match(validator.iter_errors(arguments))
    if problem is not None:
        path = ".".join(map(str, problem.absolute_path)) or "arguments"
        raise MessageError(f"{path}: {problem.message:.300}")
