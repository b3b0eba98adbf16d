# ruff: noqa: E501 - a table is read best with one pair a line
"""Arrays: pairs of known truth."""

from __future__ import annotations

from tests.schema._hard import (
    ARRAY,
    BOOLEAN,
    INTEGER,
    NULL,
    NUMBER,
    STRING,
    Body,
    Hard,
    array,
    ints,
    no,
    yes,
)  # fmt: skip


def prefix(*items: Body, rest: Body = True, **more: object) -> Body:
    return {"type": "array", "prefixItems": list(items), "items": rest, **more}


def containing(item: Body, low: int | None = None, high: int | None = None, **more: object) -> Body:
    schema: dict[str, object] = {"type": "array", "contains": item, **more}
    if low is not None:
        schema["minContains"] = low
    if high is not None:
        schema["maxContains"] = high
    return schema


UNIQUE: dict[str, object] = {"type": "array", "uniqueItems": True}

PAIRS: tuple[Hard, ...] = (
    yes("items widen", array(ints(0, 9)), array(NUMBER)),
    no("items narrow", array(NUMBER), array(INTEGER), [0.5]),
    yes("the empty array fits any items", array(False), array(STRING)),
    yes("no items is the empty array", array(INTEGER, None, 0), array(STRING)),
    no("one item is enough", array(INTEGER, None, 1), array(STRING), [0]),
    yes("fixed length 3 of a tuple", array(INTEGER, 3, 3), prefix(INTEGER, INTEGER, INTEGER, rest=False)),
    yes("tuple into array", prefix(INTEGER, ints(0, 3), rest=False), array(INTEGER, None, 2)),
    no("a tuple does not ask for its items", prefix(INTEGER, INTEGER, rest=False), {"minItems": 1}, []),
    no("longer than the tuple", array(INTEGER), prefix(INTEGER, rest=False), [0, 0]),
    yes("an impossible place bounds the length", prefix(INTEGER, False), array(INTEGER, None, 1)),
    yes("an impossible place within minItems is empty", prefix(INTEGER, False, minItems=2), False),
    yes("impossible items with minItems", array(False, 1), False),
    no("position matters", prefix(STRING, INTEGER, minItems=2), prefix(INTEGER, STRING), ["", 0]),
    yes("items begin after the prefix", prefix(STRING, rest=INTEGER), prefix(True, rest=NUMBER)),
    no("prefix shorter at the consumer", prefix(STRING, STRING, rest=INTEGER), prefix(True, rest=INTEGER), ["", ""]),
    yes("a million numbers", array(NUMBER, 10**6, 10**6), array(NUMBER, 1)),
    no("a million against a thousand", array(NULL, 10**6, 10**6), array(NULL, None, 1000), [None] * 10**6),
    yes("bounds beyond memory, contained", array(NUMBER, 2**40), array(NUMBER, 2**39)),
    yes("length bounds cross", array(NUMBER, 3, 2), False),
    yes("contains asks for one", containing(INTEGER), {"minItems": 1}),
    no("contains is not items", containing(INTEGER), array(INTEGER), [0, "a"]),
    yes("items and minItems give contains", array(INTEGER, 1), containing(INTEGER)),
    no("items alone give no contains", array(INTEGER), containing(INTEGER), []),
    yes("minContains 0 asks nothing", ARRAY, containing(False, 0)),
    yes("minContains 2 is minItems 2", containing(INTEGER, 2), {"minItems": 2}),
    yes("two of a kind among two", containing(INTEGER, 2, maxItems=2), array(INTEGER, 2, 2)),
    yes("maxContains 0", containing(INTEGER, 0, 0), array({"not": INTEGER})),
    yes("items not of it is maxContains 0", array({"not": INTEGER}), containing(INTEGER, 0, 0)),
    no("maxContains 1", array(INTEGER, None, 2), containing(INTEGER, 0, 1), [0, 0]),
    yes("maxContains by maxItems", array(True, None, 3), containing(INTEGER, 0, 3)),
    yes("contains twice, apart", {"allOf": [containing(INTEGER), containing(STRING)]}, {"minItems": 2}),
    no("contains twice, one may serve both", {"allOf": [containing(ints(0, 5)), containing(ints(5, 9))]}, {"minItems": 2}, [5]),
    yes("more wanted than contained", {"allOf": [containing(NUMBER, 3), containing(INTEGER, 0, 1)]}, containing({"allOf": [NUMBER, {"not": INTEGER}]}, 2)),
    yes("minContains over maxContains", containing(INTEGER, 3, 2), False),
    yes("minContains over maxItems", containing(INTEGER, 3, maxItems=2), False),
    yes("contains nothing", containing(False), False),
    yes("contains anything", containing(True), {"minItems": 1}),
    yes("prefix gives contains", prefix(INTEGER, minItems=1), containing(INTEGER)),
    no("prefix without minItems does not", prefix(INTEGER), containing(INTEGER), []),
    no("contains counts in the prefix too", prefix(INTEGER, rest=STRING, minItems=2), containing(STRING, 2), [0, ""]),
    yes("contains and a prefix of another type", {"type": "array", "prefixItems": [STRING], "contains": INTEGER}, {"minItems": 2}),
    yes("two unique booleans at most", {**UNIQUE, "items": BOOLEAN}, {"maxItems": 2}),
    yes("three unique booleans are impossible", {**UNIQUE, "items": BOOLEAN, "minItems": 3}, False),
    no("two unique booleans are possible", {**UNIQUE, "items": BOOLEAN, "minItems": 2}, False, [True, False]),
    yes("unique null", {**UNIQUE, "items": NULL}, {"enum": [[], [None]]}),
    yes("unique of three values", {**UNIQUE, "items": {"enum": [1, 2, 3]}, "minItems": 4}, False),
    yes("unique counts 1 and 1.0 once", {**UNIQUE, "items": {"enum": [1, 1.0]}, "minItems": 2}, False),
    no("unique counts 1 and True twice", {**UNIQUE, "items": {"enum": [1, True]}, "minItems": 2}, False, [1, True]),
    yes("unique integers in a range", {**UNIQUE, "items": ints(1, 5)}, {"maxItems": 5}),
    yes("unique empties: one array, one object", {**UNIQUE, "items": {"enum": [[], {}]}}, {"maxItems": 2}),
    yes("unique empty arrays", {**UNIQUE, "items": array(False)}, {"maxItems": 1}),
    yes("a single item is unique", array(INTEGER, None, 1), UNIQUE),
    no("two items may be equal", array(INTEGER, None, 2), UNIQUE, [0, 0]),
    yes("unique into not unique", UNIQUE, ARRAY),
    yes("different types are unique", prefix(STRING, INTEGER, rest=False), UNIQUE),
    no("overlapping types are not", prefix(INTEGER, NUMBER, rest=False), UNIQUE, [0, 0]),
    yes("constants at places are unique", prefix({"const": 1}, {"const": 2}, rest=False), UNIQUE),
    yes("equal constants at places", prefix({"const": 1}, {"const": 1}, rest=False, minItems=2, uniqueItems=True), False),
    yes("pigeonhole at places", prefix(BOOLEAN, BOOLEAN, BOOLEAN, minItems=3, uniqueItems=True), False),
    yes("unique and contains a value at most once", {**UNIQUE, "items": INTEGER}, containing({"const": 1}, 0, 1)),
    no("not unique means two alike", {"type": "array", "not": {"uniqueItems": True}}, {"minItems": 3}, [0, 0]),
    yes("not unique has two items", {"type": "array", "not": {"uniqueItems": True}}, {"minItems": 2}),
    yes("uniqueItems false says nothing", ARRAY, {"uniqueItems": False}),
    yes("closed by unevaluatedItems", {"type": "array", "prefixItems": [INTEGER], "unevaluatedItems": False}, array(INTEGER, None, 1)),
    yes("unevaluatedItems sees allOf", {"type": "array", "allOf": [{"prefixItems": [INTEGER]}], "unevaluatedItems": False}, array(INTEGER, None, 1)),
    no("unevaluatedItems of a type", {"type": "array", "prefixItems": [INTEGER], "unevaluatedItems": STRING}, array(INTEGER), [0, ""]),
    yes("nested arrays", array(array(ints(0, 1), 3, 3), 3, 3), array(array(NUMBER))),
    no("a long row", array(array(INTEGER)), array(array(INTEGER, None, 3)), [[0, 0, 0, 0]]),
    yes("array of lengths in a union", array(INTEGER, 1, 3), {"anyOf": [array(INTEGER, 1, 1), array(INTEGER, 2, 2), array(INTEGER, 3, 3)]}),
    no("array of a union is no union of arrays", array({"anyOf": [INTEGER, STRING]}), {"anyOf": [array(INTEGER), array(STRING)]}, [0, ""]),
    yes("union of arrays is array of a union", {"anyOf": [array(INTEGER), array(STRING)]}, array({"anyOf": [INTEGER, STRING]})),
    yes("single items of a union", array({"anyOf": [INTEGER, STRING]}, None, 1), {"anyOf": [array(INTEGER), array(STRING)]}),
    yes("length decides the items", {"anyOf": [array(INTEGER, 2, 2), array(STRING, 3, 3)]}, {"anyOf": [array(INTEGER, None, 2), array(STRING, 3)]}),
    yes("octets of a fixed image row", array(ints(0, 255), 1920, 1920), array(ints(0, 255))),
)  # fmt: skip
