"""Mistakes of shape: wrong types, unknown and missing keys, by the published JSON Schema."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, TypeAlias

from uoarm.config._document import Document, Path
from uoarm.config._problem import Problem, clip, write_path
from uoarm.config._spelling import Speller

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError
    from jsonschema.protocols import Validator

__all__ = ["ShapeChecker", "published_schema"]

Mistake: TypeAlias = "tuple[Path, str, str, bool]"
"""Path, sentence, hint, and whether the key rather than the value is at fault."""

_TYPES: Mapping[str, str] = {
    "object": "a mapping",
    "array": "a list",
    "string": "text",
    "integer": "a whole number",
    "number": "a number",
    "boolean": "true or false",
    "null": "nothing",
}
_BOUNDS: Mapping[str, str] = {
    "minimum": "at least",
    "maximum": "at most",
    "exclusiveMinimum": "more than",
    "exclusiveMaximum": "less than",
}
_RULE_KINDS = ("from", "const", "each")
_NAME_HINT = "a name has letters, digits, _ and -, begins with a letter or _, 128 at most"


@cache
def published_schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration file, for editors and for this check."""
    text = files("uoarm.config").joinpath("robot.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


class ShapeChecker:
    """Holds a document against the published schema, and its structures against JSON Schema."""

    def __init__(self, document: Document, file: str, speller: Speller) -> None:
        from jsonschema import Draft202012Validator  # noqa: PLC0415 - slow import

        self._document = document
        self._file = file
        self._speller = speller
        self._published: Validator = Draft202012Validator(published_schema())
        self._meta: Validator = Draft202012Validator(Draft202012Validator.META_SCHEMA)
        self._sound: set[str] = set()

    def problems(self) -> Iterator[Problem]:
        """Yield every mistake of shape in the document."""
        value: Any = self._document.value
        for error in self._published.iter_errors(value):
            yield from map(self._problem, self._mistakes(error))

    def structure_problems(self, structure: Any, path: Path) -> Iterator[Problem]:
        """Yield what keeps a declared structure from being a JSON Schema."""
        text = json.dumps(structure, sort_keys=True)
        if text in self._sound:
            return
        try:
            found = list(self._meta.iter_errors(structure))
        except RecursionError:
            yield self._problem((path, "this structure is nested too deeply", "", False))
            return
        if not found:
            self._sound.add(text)
        for error in found:
            for where, sentence, hint, at_key in self._mistakes(error):
                told = f"not a JSON Schema: {sentence}"
                yield self._problem(((*path, *where), told, hint, at_key))

    def _problem(self, mistake: Mistake) -> Problem:
        path, sentence, hint, at_key = mistake
        place = self._document.key_place(path) if at_key else self._document.place(path)
        return Problem(
            place=place, path=write_path(path), sentence=sentence, hint=hint, file=self._file
        )

    def _mistakes(self, error: ValidationError) -> Iterator[Mistake]:
        """Put one error of the validator into our own words."""
        path: Path = tuple(error.absolute_path)
        value: Any = error.instance
        expected: Any = error.validator_value
        keyword = str(error.validator)
        rules: Any = error.schema
        if _is_about_a_key(error):
            yield (*path, value), f"the name {clip(value)} is not allowed", _NAME_HINT, True
        elif keyword == "additionalProperties":
            yield from self._unknown_keys(path, value, rules["properties"])
        elif keyword == "required":
            missing = next(key for key in expected if error.message.startswith(repr(key)))
            yield path, f"the key {clip(missing)} is missing", "", False
        elif keyword == "type":
            sentence = f"expected {_expected(expected)}, got {clip(value)}"
            yield path, sentence, _type_hint(expected, value), False
        elif keyword == "const":
            yield path, f"expected {expected}, got {clip(value)}", "", False
        elif keyword == "enum":
            sentence = f"expected {_any_of(expected)}, got {clip(value)}"
            yield path, sentence, self._near(value, expected), False
        elif keyword in {"pattern", "maxLength"} and "pattern" in rules:
            yield path, f"the name {clip(value)} is not allowed", _NAME_HINT, False
        elif keyword in _BOUNDS:
            sentence = f"expected {_BOUNDS[keyword]} {expected}, got {clip(value)}"
            yield path, sentence, "", False
        elif keyword in {"minItems", "minProperties", "minLength"}:
            yield path, f"expected at least {expected}, got {clip(value)}", "", False
        elif keyword == "uniqueItems":
            yield path, "the same entry stands here twice", "", False
        elif keyword == "anyOf":
            yield from self._no_branch_fits(error, rules.get("x-kinds"), path, value)
        else:
            yield path, f"{keyword}: expected {clip(expected)}, got {clip(value)}", "", False

    def _unknown_keys(self, path: Path, value: Any, known: Collection[str]) -> Iterator[Mistake]:
        for key in value:
            if key not in known:
                hint = self._speller.guess_or_list(key, known, "known keys")
                yield (*path, key), f"unknown key {clip(key)}", hint, True

    def _no_branch_fits(
        self, error: ValidationError, kinds: list[str] | None, path: Path, value: Any
    ) -> Iterator[Mistake]:
        if kinds is None:
            yield self._simple_choice(path, value)
            return
        if not isinstance(value, dict):
            sentence = f"expected a path in the source, or from, const or each; got {clip(value)}"
            yield path, sentence, "", False
            return
        present = [kind for kind in _RULE_KINDS if kind in value]
        if len(present) != 1:
            sentence = f"expected exactly one of from, const and each, got {_keys(value)}"
            yield path, sentence, "", False
            return
        branch = kinds.index(present[0])
        for inner in error.context or ():
            if inner.relative_schema_path[0] == branch:
                yield from self._mistakes(inner)

    def _simple_choice(self, path: Path, value: Any) -> Mistake:
        """The metaschema's one choice: the name of a type, or a list of such names."""
        wrong = value
        if isinstance(value, list):
            wrong = next((one for one in value if one not in _TYPES), value)
        sentence = f"expected {_any_of(_TYPES)}, got {clip(wrong)}"
        return path, sentence, self._near(wrong, _TYPES), False

    def _near(self, value: object, allowed: Collection[object]) -> str:
        if not isinstance(value, str):
            return ""
        return self._speller.guess(value, [str(one) for one in allowed if one != value])


def _expected(types: str | list[str]) -> str:
    names = [types] if isinstance(types, str) else types
    return " or ".join(_TYPES.get(name, name) for name in names)


def _type_hint(expected: str | list[str], value: object) -> str:
    if value is None and expected == "object":
        return "write {} where there is nothing to set"
    if isinstance(value, str) and expected == "array":
        return f"write [{clip(value)}]"
    return ""


def _any_of(allowed: Collection[object]) -> str:
    words = [str(one) for one in allowed]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _keys(value: Mapping[str, object]) -> str:
    return clip(list(value)) if value else "an empty mapping"


def _is_about_a_key(error: ValidationError) -> bool:
    steps = list(error.absolute_schema_path)
    return any(
        step == "propertyNames" and before != "properties"
        for before, step in zip(["", *steps], steps, strict=False)
    )
