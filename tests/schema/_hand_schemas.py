"""Random schemas of the kind people write, and worse: every keyword, few names, small numbers.

The vocabulary is small on purpose, so that two of them meet often enough to be worth comparing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tests.schema._patterns import SAMPLES

from uoarm.testing._instances import Choices, chance

Schema = dict[str, object]
Inner = Callable[[], Schema | bool]

NAMES = ("a", "b", "c", "x-a")
_SCALARS: Sequence[object] = (
    None, True, False, 0, 1, 2, -1, 1.0, 0.5, "", "a", "b", "ab", [], [1], [True], {}, {"a": 1},
)  # fmt: skip
KINDS = ("object", "array", "string", "integer", "number", "boolean", "null")
_NUMBERS = (0, 1, 2, 3, -1, 1.5, 10)
_STEPS = (1, 2, 3, 0.5, 0.1, 1.5)


def hand_schema(choices: Choices, depth: int = 3) -> Schema | bool:
    """One schema; references only to ``#/$defs/...``, which the root carries."""
    defs = {}
    if depth > 1 and chance(choices, 20):
        recursive = chance(choices, 30)
        defs = {"d": _schema(choices, depth - 1, here=False, below=recursive)}
    body = _schema(choices, depth, here=bool(defs), below=bool(defs))
    return {**body, "$defs": defs} if defs and isinstance(body, dict) else body


def _schema(choices: Choices, depth: int, *, here: bool, below: bool) -> Schema | bool:
    """``here`` and ``below``: whether a reference may stand in place, and inside of values.

    A reference in place within its own target would go round for ever.
    """
    if chance(choices, 8):
        return choices.item((True, False))
    if here and chance(choices, 25):
        return {"$ref": "#/$defs/d"}
    in_place: Inner = lambda: _schema(choices, depth - 1, here=here, below=below)  # noqa: E731 - one line that each writer takes
    inside: Inner = lambda: _schema(choices, depth - 1, here=below, below=below)  # noqa: E731 - one line that each writer takes
    if depth > 0 and chance(choices, 35):
        return logic(choices, in_place)
    kind = choices.item(KINDS if depth > 0 else KINDS[2:])
    schema = WRITERS[kind](choices, inside)
    if kind == "object" and chance(choices, 8):
        schema["dependentSchemas"] = {choices.item(NAMES): in_place()}
    if chance(choices, 80):
        schema = {"type": kind, **schema}
    if chance(choices, 8):
        schema["type"] = [kind, choices.item([name for name in KINDS if name != kind])]
    if depth > 0 and chance(choices, 12):
        schema.update(logic(choices, in_place))
    return schema


def logic(choices: Choices, inner: Inner) -> Schema:
    keyword = choices.item(("anyOf", "allOf", "oneOf", "not", "if", "anyOf", "enum", "const"))
    if keyword == "not":
        return {"not": inner()}
    if keyword == "if":
        return {"if": inner(), "then": inner(), "else": inner()}
    if keyword == "const":
        return {"const": choices.item(_SCALARS)}
    if keyword == "enum":
        return {"enum": [choices.item(_SCALARS) for _ in range(choices.integer(1, 4))]}
    return {keyword: [inner() for _ in range(choices.integer(1, 3))]}


def _number(choices: Choices, _: object) -> Schema:
    schema: Schema = {}
    if chance(choices, 50):
        schema[choices.item(("minimum", "exclusiveMinimum"))] = choices.item(_NUMBERS)
    if chance(choices, 50):
        schema[choices.item(("maximum", "exclusiveMaximum"))] = choices.item(_NUMBERS)
    if chance(choices, 30):
        schema["multipleOf"] = choices.item(_STEPS)
    return schema


def _string(choices: Choices, _: object) -> Schema:
    schema: Schema = {}
    if chance(choices, 40):
        schema["minLength"] = choices.integer(0, 3)
    if chance(choices, 40):
        schema["maxLength"] = choices.integer(0, 4)
    if chance(choices, 50):
        schema["pattern"] = choices.item(tuple(SAMPLES))
    return schema


def _array(choices: Choices, inner: Inner) -> Schema:
    schema: Schema = {}
    if chance(choices, 35):
        schema["prefixItems"] = [inner() for _ in range(choices.integer(1, 2))]
    if chance(choices, 60):
        schema["items"] = inner()
    if chance(choices, 35):
        schema["minItems"] = choices.integer(0, 3)
    if chance(choices, 35):
        schema["maxItems"] = choices.integer(0, 3)
    if chance(choices, 20):
        schema["uniqueItems"] = choices.item((True, True, False))
    if chance(choices, 20):
        schema["contains"] = inner()
        if chance(choices, 50):
            schema["minContains"] = choices.integer(0, 2)
        if chance(choices, 50):
            schema["maxContains"] = choices.integer(0, 2)
    if chance(choices, 8):
        schema["unevaluatedItems"] = inner()
    return schema


def _object(choices: Choices, inner: Inner) -> Schema:
    schema: Schema = {}
    if chance(choices, 80):
        names = [name for name in NAMES if chance(choices, 45)]
        schema["properties"] = {name: inner() for name in names}
    if chance(choices, 50):
        schema["required"] = [name for name in NAMES if chance(choices, 35)]
    if chance(choices, 45):
        schema["additionalProperties"] = False if chance(choices, 60) else inner()
    if chance(choices, 20):
        schema["patternProperties"] = {choices.item(tuple(SAMPLES)): inner()}
    if chance(choices, 10):
        schema["propertyNames"] = _string(choices, None)
    if chance(choices, 15):
        schema["minProperties"] = choices.integer(0, 3)
    if chance(choices, 15):
        schema["maxProperties"] = choices.integer(0, 3)
    if chance(choices, 10):
        schema["dependentRequired"] = {choices.item(NAMES): [choices.item(NAMES)]}
    if chance(choices, 8):
        schema["unevaluatedProperties"] = False if chance(choices, 60) else inner()
    return schema


WRITERS: dict[str, Callable[[Choices, Inner], Schema]] = {
    "object": _object,
    "array": _array,
    "string": _string,
    "integer": _number,
    "number": _number,
    "boolean": lambda *_: {},
    "null": lambda *_: {},
}
