# ruff: noqa: E501 - a table is read best with one pair a line
"""Large and hostile schemas: pairs of known truth, decided within the default budget."""

from __future__ import annotations

from functools import reduce

from tests.schema._hard import (
    BOOLEAN,
    INTEGER,
    NULL,
    NUMBER,
    STRING,
    Body,
    Hard,
    array,
    closed,
    ints,
    no,
    yes,
)  # fmt: skip


def nested(levels: int, leaf: Body) -> Body:
    return reduce(lambda inner, _: closed(a=inner), range(levels), leaf)


def nested_arrays(levels: int, leaf: Body) -> Body:
    return reduce(lambda inner, _: array(inner, 1, 1), range(levels), leaf)


def nested_all_of(levels: int, leaf: Body) -> Body:
    return reduce(lambda inner, _: {"allOf": [inner]}, range(levels), leaf)


def nested_not(levels: int, leaf: Body) -> Body:
    return reduce(lambda inner, _: {"not": inner}, range(levels), leaf)


def deep_value(levels: int, leaf: object) -> object:
    return reduce(lambda inner, _: {"a": inner}, range(levels), leaf)


def wide(fields: int, value: Body) -> dict[str, object]:
    return closed(**{f"field_{n}": value for n in range(fields)})


def any_of(*branches: Body) -> Body:
    return {"anyOf": list(branches)}


def union_fields(fields: int, *branches: Body) -> dict[str, object]:
    return closed((), **{f"f{n}": any_of(*branches) for n in range(fields)})


def tags(count: int, value: Body) -> dict[str, object]:
    return {"oneOf": [closed(kind={"const": f"tag{n}"}, body=value) for n in range(count)]}


def chain_of_references(length: int) -> dict[str, object]:
    defs: dict[str, object] = {f"d{n}": {"$ref": f"#/$defs/d{n + 1}"} for n in range(length)}
    return {"$defs": {**defs, f"d{length}": INTEGER}, "$ref": "#/$defs/d0"}


def doubling(levels: int, leaf: Body) -> dict[str, object]:
    """Each definition names the next one twice: 2^levels leaves when written out."""
    defs: dict[str, object] = {
        f"d{n}": closed(l={"$ref": f"#/$defs/d{n + 1}"}, r={"$ref": f"#/$defs/d{n + 1}"})
        for n in range(levels)
    }
    return {"$defs": {**defs, f"d{levels}": leaf}, "$ref": "#/$defs/d0"}


def pattern(text: str, **more: object) -> dict[str, object]:
    return {"type": "string", "pattern": text, **more}


RECORDS = [{"id": n, "name": f"n{n}", "tags": [n, True]} for n in range(10_000)]
WORDS = [f"word{n}" for n in range(10_000)]

DEPTH = (
    yes("500 levels", nested(500, INTEGER), nested(500, NUMBER)),
    no("500 levels, wrong at the bottom", nested(500, NUMBER), nested(500, INTEGER), deep_value(500, 0.5)),
    yes("500 levels of arrays", nested_arrays(500, INTEGER), nested_arrays(500, NUMBER)),
    yes("500 levels of allOf", nested_all_of(500, INTEGER), NUMBER),
    yes("500 levels of not", nested_not(500, INTEGER), NUMBER),
    yes("501 levels of not", nested_not(501, INTEGER), {"not": {"const": 1}}),
    yes("a chain of 1,000 references", chain_of_references(1000), NUMBER),
    yes("2^60 leaves by references", doubling(60, INTEGER), doubling(60, NUMBER)),
)  # fmt: skip

WIDTH = (
    yes("2,000 fields", wide(2000, INTEGER), wide(2000, NUMBER)),
    no("2,000 fields, the last one missing", wide(1999, NULL), wide(2000, NULL), dict.fromkeys((f"field_{n}" for n in range(1999)), None)),
    yes("20 optional union fields", union_fields(20, INTEGER, STRING), union_fields(20, STRING, NUMBER)),
    no("20 optional union fields, one branch too many", union_fields(20, INTEGER, STRING, NULL), union_fields(20, STRING, NUMBER), {"f0": None}),
    yes("20 optional record fields", union_fields(20, closed(a=INTEGER), closed(b=STRING)), union_fields(20, closed(b=STRING), closed(a=NUMBER))),
    yes("200 tags", tags(200, INTEGER), tags(200, NUMBER)),
    no("201 tags", tags(201, NULL), tags(200, NULL), {"kind": "tag200", "body": None}),
    yes("20 optional booleans against a case split", union_fields(20, BOOLEAN), {"anyOf": [{"required": ["f0"]}, {"properties": {"f0": False}}]}),
    yes("300 ranges cover", ints(0, 2999), {"anyOf": [ints(10 * n, 10 * n + 9) for n in range(300)]}),
    no("300 ranges but one", ints(0, 2999), {"anyOf": [ints(10 * n, 10 * n + 9) for n in range(300) if n != 150]}, 1500),
)  # fmt: skip

ENUMS = (
    yes("10,000 words into strings", {"enum": WORDS}, {"type": "string", "pattern": "^word[0-9]+$"}),
    yes("10,000 words into themselves reversed", {"enum": WORDS}, {"enum": WORDS[::-1]}),
    no("10,000 words without one", {"enum": WORDS}, {"enum": WORDS[:-1]}, "word9999"),
    yes("10,000 records into themselves reversed", {"enum": RECORDS}, {"enum": RECORDS[::-1]}),
    no("10,000 records without one", {"enum": RECORDS}, {"enum": RECORDS[1:]}, {"id": 0, "name": "n0", "tags": [0, True]}),
    yes("10,000 records into a schema", {"enum": RECORDS}, closed(id=ints(0, 9999), name=STRING, tags={"type": "array", "prefixItems": [INTEGER, BOOLEAN], "items": False})),
    yes("10,000 integers into a range", {"enum": list(range(10_000))}, ints(0, 9999)),
    yes("a range into 10,000 integers", ints(0, 9999), {"enum": list(range(10_000))}),
)  # fmt: skip

PATTERNS = (
    yes("nested stars", pattern("^(a*)*$"), pattern("^a*$")),
    yes("alternation that explodes backtrackers", pattern("^(a|a)*$"), pattern("^a*$")),
    yes("wide repeats of one language", pattern("^[a-z]{0,200}$"), pattern("^[a-z]*$")),
    yes("maxLength of 2^31 beside a pattern", pattern("^(ab)*$", maxLength=2**31), pattern("^[ab]*$", maxLength=2**31)),
    yes("a long literal", pattern("^" + "x" * 2_000 + "$"), {"minLength": 2_000, "maxLength": 2_000}),
)  # fmt: skip

HOSTILE = (
    yes("an exponential automaton on itself", pattern("^(a|b)*a(a|b){40}$"), pattern("^(a|b)*a(a|b){40}$")),
    yes("another within its hull", pattern("^(a|b)*a(a|b){40}$"), pattern("^(a|b)*$")),
    yes("a repeat of a thousand by a thousand", pattern("^(a{1000}){1000}$"), {"minLength": 10**6}),
    yes("a counter of 10^9", pattern("^a{1000000000}$"), {"minLength": 10**9}),
    yes("lookahead", pattern("^(?=.*[0-9])[a-z0-9]+$"), pattern("[0-9]")),
    yes("a back reference", pattern("^(a|b)\\1$"), {"enum": ["aa", "bb"]}),
    yes("forty overlapping alternatives, oneOf", {"oneOf": [ints(n, n + 20) for n in range(40)]}, ints(0, 59)),
    yes("a knapsack in multiples", {"allOf": [{"type": "integer", "multipleOf": p} for p in (999983, 999979, 999961, 999959)]}, {"multipleOf": 999983 * 999979 * 999961 * 999959}),
    yes("propositional pigeonhole in fields", closed(**{f"p{n}": ints(0, 3) for n in range(5)}), {"anyOf": [{"properties": {f"p{a}": {"const": h}, f"p{b}": {"const": h}}} for a in range(5) for b in range(a) for h in range(4)]}),
)  # fmt: skip
"""True answers that a budget may cut short: "undecided" is taken as well, a wrong one never."""

PAIRS: tuple[Hard, ...] = (*DEPTH, *WIDTH, *ENUMS, *PATTERNS)
