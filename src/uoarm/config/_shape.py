"""Mistakes of shape: wrong types, unknown and missing keys, by the published JSON Schema."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from uoarm.config._problem import Problem, did_you_mean

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError

    from uoarm.config._yaml import Document, Path

__all__ = ["published_schema", "shape_problems", "write_path"]

_SHOWN = 60
_TYPES = {
    "object": "a mapping",
    "array": "a list",
    "string": "a string",
    "integer": "a whole number",
    "number": "a number",
    "boolean": "true or false",
}


@cache
def published_schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration file, for editors and for this check."""
    text = files("uoarm.config").joinpath("robot.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def shape_problems(document: Document, file: str) -> Iterator[Problem]:
    """Yield every mistake of shape with its place."""
    from jsonschema import Draft202012Validator  # noqa: PLC0415 - slow import

    for error in Draft202012Validator(published_schema()).iter_errors(document.value):
        yield from _problems_of(error, document, file)


def write_path(path: Path) -> str:
    """Write a path as `$.functions.camera.components[0]`."""
    return "$" + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)


def _problems_of(error: ValidationError, document: Document, file: str) -> Iterator[Problem]:
    path: Path = tuple(error.absolute_path)
    value: Any = error.instance
    schema: Any = error.schema
    expected: Any = error.validator_value

    def problem(at: Path, sentence: str, hint: str = "") -> Problem:
        return Problem(
            place=document.place(at), path=write_path(at), sentence=sentence, hint=hint, file=file
        )

    if error.validator == "additionalProperties":
        known = schema["properties"]
        for key in value:
            if key not in known:
                hint = did_you_mean(key, known) or f"known keys: {', '.join(known)}"
                yield problem((*path, key), f"unknown key {key!r}", hint)
    elif error.validator == "required":
        missing = next(
            key for key in schema["required"] if f"{key!r} is a required" in error.message
        )
        yield problem(path, f"the key {missing!r} is missing")
    elif error.validator == "type":
        yield problem(path, f"expected {_expected(expected)}, got {_show(value)}")
    elif error.validator == "enum":
        allowed = ", ".join(str(one) for one in expected)
        yield problem(
            path,
            f"expected one of {allowed}, got {_show(value)}",
            did_you_mean(str(value), expected),
        )
    elif error.validator == "const":
        yield problem(path, f"expected {expected}, got {_show(value)}")
    elif "propertyNames" in error.absolute_schema_path:
        sentence = f"the name {value!r} is not allowed"
        yield problem((*path, value), sentence, "letters, digits, _ and -, not a digit first")
    elif error.validator == "pattern":
        yield problem(
            path,
            f"the name {value!r} is not allowed",
            "letters, digits, _ and -, not a digit first",
        )
    elif error.validator in {"minItems", "minProperties", "minLength"}:
        yield problem(path, f"expected at least one entry, got {_show(value)}")
    else:
        yield problem(path, f"{error.message[:200]}")


def _expected(types: str | list[str]) -> str:
    names = [types] if isinstance(types, str) else types
    return " or ".join(_TYPES.get(name, name) for name in names)


def _show(value: object) -> str:
    if value is None:
        return "nothing"
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
