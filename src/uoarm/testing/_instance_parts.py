"""From a schema with references and branches to the plain keyword sets that hold at one place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING
from urllib.parse import unquote

from uoarm.testing._choices import chance

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from uoarm.testing._choices import Choices

Keywords = Mapping[str, object]

_MOST_PARTS = 400
_GUESSED_TYPE = {
    "properties": "object",
    "required": "object",
    "patternProperties": "object",
    "additionalProperties": "object",
    "propertyNames": "object",
    "minProperties": "object",
    "maxProperties": "object",
    "dependentRequired": "object",
    "unevaluatedProperties": "object",
    "items": "array",
    "prefixItems": "array",
    "minItems": "array",
    "maxItems": "array",
    "uniqueItems": "array",
    "contains": "array",
    "unevaluatedItems": "array",
    "pattern": "string",
    "minLength": "string",
    "maxLength": "string",
    "x-max-utf8": "string",
    "x-max-utf16": "string",
    "minimum": "number",
    "maximum": "number",
    "exclusiveMinimum": "number",
    "exclusiveMaximum": "number",
    "multipleOf": "number",
}
_TYPES = ("object", "array", "string", "integer", "number", "boolean", "null")


class InstanceDocument:
    """A schema document in which local references are followed."""

    def __init__(self, root: object) -> None:
        self._root = root
        self._anchors = dict(_anchors(root))

    def parts(self, choices: Choices, schemas: Iterable[object]) -> list[Keywords] | None:
        """The keyword sets that ``schemas`` ask for together, one branch of each union chosen.

        None when one of them allows nothing, or when references lead round in a circle.
        """
        waiting = list(schemas)
        found: list[Keywords] = []
        steps = 0
        while waiting:
            schema = waiting.pop()
            steps += 1
            if schema is False or steps > _MOST_PARTS:
                return None
            if isinstance(schema, Mapping):
                found.append(schema)
                waiting.extend(self._implied(choices, schema))
        return found

    def _implied(self, choices: Choices, schema: Keywords) -> Iterator[object]:
        reference = schema.get("$ref")
        if isinstance(reference, str):
            yield self._target(reference)
        all_of = schema.get("allOf")
        if isinstance(all_of, list):
            yield from all_of
        for keyword in ("anyOf", "oneOf"):
            branches = schema.get(keyword)
            if isinstance(branches, list) and branches:
                yield choices.item(branches)
                if keyword == "anyOf" and chance(choices, 15):
                    yield choices.item(branches)
        if "if" in schema:
            if chance(choices, 50):
                yield schema["if"]
                yield schema.get("then", True)
            else:
                yield schema.get("else", True)

    def _target(self, reference: str) -> object:
        fragment = unquote(reference.partition("#")[2])
        if not fragment.startswith("/"):
            return self._anchors.get(fragment, True) if fragment else self._root
        node = self._root
        for step in fragment[1:].split("/"):
            name = step.replace("~1", "/").replace("~0", "~")
            if isinstance(node, Mapping):
                node = node.get(name, True)
            elif isinstance(node, list) and name.isdigit() and int(name) < len(node):
                node = node[int(name)]
            else:
                return True
        return node


def choose_type(choices: Choices, parts: Iterable[Keywords]) -> str | None:
    """One type that every part allows, preferring types which the other keywords speak of."""
    allowed = set(_TYPES)
    spoken: list[str] = []
    for part in parts:
        declared = part.get("type")
        if declared is not None:
            names = {declared} if isinstance(declared, str) else set(_strings(declared))
            if "number" in names:
                names.add("integer")
            allowed &= names
        spoken += [_GUESSED_TYPE[keyword] for keyword in part if keyword in _GUESSED_TYPE]
    likely = [name for name in spoken if name in allowed]
    if likely and chance(choices, 85):
        return choices.item(likely)
    ordered = [name for name in _TYPES if name in allowed]
    return choices.item(ordered) if ordered else None


def _strings(value: object) -> Iterator[str]:
    if isinstance(value, list):
        yield from (name for name in value if isinstance(name, str))


def _anchors(root: object) -> Iterator[tuple[str, object]]:
    waiting = [root]
    while waiting:
        node = waiting.pop()
        if isinstance(node, Mapping):
            anchor = node.get("$anchor")
            if isinstance(anchor, str):
                yield anchor, node
            waiting.extend(node.values())
        elif isinstance(node, list):
            waiting.extend(node)
