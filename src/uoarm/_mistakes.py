"""What a validator found wrong, in our own words: what was expected, what came, what to write.

They are for any schema; a schema with meanings of its own has words of its own for those. Most
values have no mistake: `certainly_matches` knows that of the keywords that schemas of files and
options use. Of whatever else it is not certain, and the validator is asked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from uoarm._spelling import Speller
from uoarm._support.yaml import Path, clip
from uoarm.errors import UoarmError

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError

E = TypeVar("E", bound=Enum)
Mistake: TypeAlias = "tuple[Path, str, str, bool]"
"""Path, sentence, hint, and whether the key rather than the value is at fault."""
TYPES: Mapping[str, str] = {
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
_SIZES: Mapping[str, tuple[str, str]] = {
    f"{bound}{name}": (words, of)
    for bound, words in (("min", "at least"), ("max", "at most"))
    for name, of in (("Items", "entries"), ("Properties", "keys"), ("Length", "characters"))
}
_UNITS = {"x-max-utf8": "octets (UTF-8)", "x-max-utf16": "code units (UTF-16)"}
_LITERALS = frozenset({str, int, bool, type(None)})
_KINDS: Mapping[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "boolean": (bool,),
    "null": (type(None),),
}
_PLAIN = frozenset({dict, list, str, int, float, bool, type(None)})
_SILENT = frozenset(
    {"$comment", "$defs", "$id", "$schema", "default", "description", "examples", "title"}
)
_DEPTH = 200


def any_of(allowed: Collection[object]) -> str:
    """Write a choice: `a, b or c`; truth values as files have them."""
    words = [str(item).lower() if isinstance(item, bool) else str(item) for item in allowed]
    if len(words) <= 1:
        return words[0] if words else "nothing"
    return f"{', '.join(words[:-1])} or {words[-1]}"


def schema_mistakes(value: object, schema: Any, speller: Speller) -> Iterator[Mistake]:
    """Yield everything by which a value does not match a schema, in our own words.

    What certainly matches, as most does, loads no validator.
    """
    if certainly_matches(value, schema):
        return
    from jsonschema import Draft202012Validator  # noqa: PLC0415 - slow import

    for error in Draft202012Validator(schema).iter_errors(value):
        yield from mistakes(error, speller)


def mistakes(
    error: ValidationError, speller: Speller, write: Callable[[object], str] = clip
) -> Iterator[Mistake]:
    """Put one error of the validator into our own words.

    Args:
        error: of a value.
        speller: guesses what misspelt words were meant to be.
        write: puts a value into words; unless given, one that was read from JSON or YAML.
    """
    path: Path = tuple(error.absolute_path)
    value: Any = error.instance
    expected: Any = error.validator_value
    keyword = str(error.validator)
    rules: Any = error.schema
    if is_about_a_key(error):
        wanted = f"a name {_form(rules)}" if keyword == "pattern" else "another name"
        yield (*path, value), f"expected {wanted}, got {write(value)}", "", True
    elif keyword == "additionalProperties":
        yield from _unknown_keys(path, value, rules.get("properties", {}), speller)
    elif keyword == "required":
        missing = next(key for key in expected if error.message.startswith(repr(key)))
        yield path, f"the key {clip(missing)} is missing", "", False
    elif keyword == "type":
        unit = f", in {rules['x-unit']}" if "x-unit" in rules else ""
        sentence = f"expected {_expected(expected, value)}{unit}, got {write(value)}"
        yield path, sentence, _type_hint(expected, value), False
    elif keyword == "const":
        yield path, f"expected {_choice(expected)}, got {write(value)}", "", False
    elif keyword == "enum":
        sentence = f"expected {any_of([_choice(word) for word in expected])}, got {write(value)}"
        yield path, sentence, near(value, expected, speller), False
    elif keyword == "pattern":
        yield path, f"expected text {_form(rules)}, got {write(value)}", "", False
    elif keyword == "x-nul":
        yield path, f"expected a string without the character NUL, got {write(value)}", "", False
    elif keyword in _UNITS:
        of = _UNITS[keyword]
        yield path, f"expected at most {expected} {of}, got {error.message}", "", False
    elif keyword in _BOUNDS:
        unit = f" {rules['x-unit']}" if "x-unit" in rules else ""
        sentence = f"expected {_BOUNDS[keyword]} {expected}{unit}, got {write(value)}"
        yield path, sentence, "", False
    elif keyword in _SIZES:
        bound, of = _SIZES[keyword]
        yield path, f"expected {bound} {expected} {of}, got {len(value)}", "", False
    elif keyword == "uniqueItems":
        yield path, "the same entry stands here twice", "", False
    elif keyword in {"anyOf", "oneOf"}:
        sentence = f"{write(value)} is none of the {len(expected)} forms allowed"
        if forms := _forms(error, speller, write):
            sentence = f"expected {any_of(forms)}, got {write(value)}"
        yield path, sentence, "", False
    else:
        yield path, f"{keyword}: expected {clip(expected)}, got {write(value)}", "", False


def _forms(error: ValidationError, speller: Speller, write: Callable[[object], str]) -> list[str]:
    """Return what each of several forms expects of a value; none where they are about its parts."""
    wanted: list[str] = []
    forms: Any = error.validator_value
    for number in range(len(forms)):
        inner = [cause for cause in error.context if cause.schema_path[0] == number]
        if len(inner) != 1 or inner[0].absolute_path != error.absolute_path:
            return []
        said = [mistake[1] for mistake in mistakes(inner[0], speller, write)]
        if len(said) != 1:
            return []
        sentence = said[0]
        begin, end = "expected ", f", got {write(error.instance)}"
        if not (sentence.startswith(begin) and sentence.endswith(end)):
            return []
        wanted.append(sentence[len(begin) : -len(end)])
    return wanted


def is_about_a_key(error: ValidationError) -> bool:
    """Whether an error is about the name of a key, by `propertyNames`, and not about a value."""
    steps = list(error.absolute_schema_path)
    return any(
        step == "propertyNames" and before != "properties"
        for before, step in zip(["", *steps], steps, strict=False)
    )


def _unknown_keys(
    path: Path, value: Any, known: Collection[str], speller: Speller
) -> Iterator[Mistake]:
    for key in value:
        if key not in known:
            hint = speller.guess_or_list(key, known, "known keys")
            yield (*path, key), f"unknown key {clip(key)}", hint, True


def near(value: object, allowed: Collection[object], speller: Speller) -> str:
    """Return what may have been meant by a value that is none of the allowed words."""
    if not isinstance(value, str):
        return "write it in quotes" if clip(value) in allowed else ""
    return speller.guess(value, [any_of([item]) for item in allowed if item != value])


def _choice(value: object) -> str:
    """Write what may be written: a word as it is, anything else as in JSON."""
    return value if isinstance(value, str) else clip(value)


def _form(rules: Mapping[str, Any]) -> str:
    """Say what a text is like that matches a pattern, and what may stand in its place."""
    examples, types = rules.get("examples", ()), rules.get("type")
    form = f"such as {examples[0]}" if examples else f"that matches {rules['pattern']}"
    others = [name for name in types if name != "string"] if isinstance(types, list) else []
    return f"{form}, or {_expected(others, None)}" if others else form


def _expected(types: str | list[str], value: object) -> str:
    names = [types] if isinstance(types, str) else types
    if "string" in names and isinstance(value, str):  # which is of another type for this only
        return "text without half of a surrogate pair"
    return " or ".join(TYPES.get(name, name) for name in names)


def _type_hint(expected: str | list[str], value: object) -> str:
    if value is None and expected == "object":
        return "write {} where there is nothing to set"
    if expected == "string" and isinstance(value, int | float):
        return "write it in quotes"
    if expected == "string" and isinstance(value, dict) and len(value) == 1:
        [(key, rest)] = value.items()  # `a: b` is a mapping of YAML, `a:b` a text
        if isinstance(key, str) and isinstance(rest, str):
            return f"write {clip(f'{key}:{rest}')}, without the space"
    if isinstance(value, str) and expected == "array":
        return f"write [{clip(value)}]"
    return ""


def choose(kind: type[E], name: E | str, what: str, error: type[UoarmError]) -> E:
    """Return the member of an enumeration that a program named.

    Args:
        kind: the enumeration, whose values are texts.
        name: a member, or its value.
        what: what is chosen, for the text.
        error: raised for a name that there is not; it lists those there are.
    """
    try:
        return kind(name)
    except ValueError:
        known = [str(item.value) for item in kind]
        hint = Speller().guess(str(name), known).replace('"', "'")
        text = f"{what} {name!r}: expected {any_of(known)}"
        raise error(f"{text}; {hint}" if hint else text) from None


def certainly_matches(value: Any, schema: Any) -> bool:
    """Say whether a value of JSON certainly matches; False: it may not, or that is not known here.

    Args:
        value: made of plain dicts, lists, texts, numbers, booleans and None.
        schema: JSON Schema of draft 2020-12, its references all to `#/$defs/...`.
    """
    try:
        return _Check(schema).matches(value, schema, 0)
    except (TypeError, AttributeError, ValueError, re.error, RecursionError):  # no JSON Schema
        return False


class _Check:
    """One schema, whose references lead into itself."""

    def __init__(self, whole: Any) -> None:
        self._whole = whole

    def matches(self, value: Any, schema: Any, depth: int) -> bool:
        if schema is True:
            return True
        if not isinstance(schema, Mapping) or depth > _DEPTH or value.__class__ not in _PLAIN:
            return False
        for keyword, rule in schema.items():
            if keyword in _SILENT or keyword.startswith("x-"):
                continue
            simple = _SIMPLE.get(keyword)
            if simple is not None:
                if not simple(value, rule):
                    return False
            elif not self._holds(keyword, rule, value, schema, depth + 1):
                return False
        return True

    def _holds(
        self, keyword: str, rule: Any, value: Any, schema: Mapping[str, Any], depth: int
    ) -> bool:
        """Look at the keywords that apply schemas to a value or its parts; no other holds."""
        match keyword:
            case "$ref":
                place = self._whole.get("$defs", {}).get(rule.removeprefix("#/$defs/"))
                return place is not None and self.matches(value, place, depth)
            case "anyOf":
                return any(self.matches(value, branch, depth) for branch in rule)
            case "properties":
                return value.__class__ is not dict or all(
                    self.matches(value[name], part, depth)
                    for name, part in rule.items()
                    if name in value
                )
            case "additionalProperties":
                known = schema.get("properties", {})
                return value.__class__ is not dict or (
                    "patternProperties" not in schema
                    and all(
                        self.matches(item, rule, depth)
                        for name, item in value.items()
                        if name not in known
                    )
                )
            case "propertyNames":
                return value.__class__ is not dict or all(
                    self.matches(name, rule, depth) for name in value
                )
            case "items":
                return value.__class__ is not list or (
                    "prefixItems" not in schema
                    and all(self.matches(item, rule, depth) for item in value)
                )
        return False


def _is_of(value: Any, kinds: str | list[str]) -> bool:
    names = [kinds] if isinstance(kinds, str) else kinds
    return any(value.__class__ in _KINDS.get(name, ()) for name in names)


def _is_one_of(value: Any, allowed: list[Any]) -> bool:
    """Compare by class, too: 1 and True are equal to Python, and not to JSON Schema."""
    return value.__class__ in _LITERALS and any(
        value.__class__ is literal.__class__ and value == literal for literal in allowed
    )


def _are_unique(value: Any, unique: bool) -> bool:  # noqa: FBT001 - as all of them are called
    if value.__class__ is not list or not unique:
        return True
    return all(item.__class__ is str for item in value) and len(set(value)) == len(value)


def _sized(kind: Any) -> tuple[Callable[[Any, int], bool], Callable[[Any, int], bool]]:
    """Return the checks of a least and of a greatest length of values of a class."""
    return (
        lambda value, least: value.__class__ is not kind or len(value) >= least,
        lambda value, most: value.__class__ is not kind or len(value) <= most,
    )


def _bounded(holds: Callable[[Any, Any], bool]) -> Callable[[Any, Any], bool]:
    """Return the check of a bound; what is not a number has none, and NaN is within none."""
    numbers = _KINDS["number"]
    return lambda value, bound: value.__class__ not in numbers or holds(value, bound)


_Rule: TypeAlias = Callable[[Any, Any], bool]


_SIMPLE: Mapping[str, _Rule] = {
    "type": _is_of,
    "enum": _is_one_of,
    "const": lambda value, literal: _is_one_of(value, [literal]),
    "required": lambda value, names: value.__class__ is not dict or value.keys() >= {*names},
    "pattern": lambda value, pattern: (
        value.__class__ is not str or re.search(pattern, value) is not None
    ),
    "uniqueItems": _are_unique,
    "minimum": _bounded(lambda value, bound: value >= bound),
    "maximum": _bounded(lambda value, bound: value <= bound),
    "exclusiveMinimum": _bounded(lambda value, bound: value > bound),
    "exclusiveMaximum": _bounded(lambda value, bound: value < bound),
    **dict(zip(("minLength", "maxLength"), _sized(str), strict=True)),
    **dict(zip(("minItems", "maxItems"), _sized(list), strict=True)),
    **dict(zip(("minProperties", "maxProperties"), _sized(dict), strict=True)),
}
