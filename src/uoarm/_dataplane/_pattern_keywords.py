"""Keywords with patterns, read as the containment check reads them.

That is by ECMA-262 and in linear time, so that what was proven of two structures holds for their
messages. Patterns that it does not read (looks behind, references back) are Python's, and so are
those that `unevaluatedProperties` sees.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError

from uoarm.schema import UnsupportedPatternError, found_in

__all__ = ["PATTERN_KEYWORDS"]

Errors: TypeAlias = Iterator[ValidationError]


def _pattern(_: Draft202012Validator, pattern: str, instance: Any, __: object) -> Errors:
    if isinstance(instance, str) and not _found(pattern, instance):
        yield ValidationError("of another pattern")


def _pattern_properties(
    validator: Draft202012Validator, rules: Mapping[str, Any], instance: Any, _: object
) -> Errors:
    if isinstance(instance, Mapping):
        for pattern, rule in rules.items():
            for name in instance:
                if _found(pattern, name):
                    yield from validator.descend(instance[name], rule, name, pattern)


def _additional_properties(
    validator: Draft202012Validator, rule: Any, instance: Any, whole: Mapping[str, Any]
) -> Errors:
    if not isinstance(instance, Mapping):
        return
    patterns = whole.get("patternProperties", ())
    known = whole.get("properties", {})
    for name in instance:
        if name in known or any(_found(pattern, name) for pattern in patterns):
            continue
        if rule is False:
            yield ValidationError("unknown field", path=(name,))
        else:
            yield from validator.descend(instance[name], rule, name)


def _found(pattern: str, text: str) -> bool:
    try:
        return found_in(pattern, text)
    except UnsupportedPatternError:
        return re.search(pattern, text) is not None


PATTERN_KEYWORDS = {
    "pattern": _pattern,
    "patternProperties": _pattern_properties,
    "additionalProperties": _additional_properties,
}
