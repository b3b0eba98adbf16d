# ruff: noqa: E501 - a table is read best with one pair a line
"""Objects: pairs of known truth."""

from __future__ import annotations

from tests.schema._hard import (
    BOOLEAN,
    INTEGER,
    NULL,
    NUMBER,
    OBJECT,
    STRING,
    Body,
    Hard,
    array,
    closed,
    ints,
    no,
    yes,
)  # fmt: skip

NULLABLE: Body = {"anyOf": [STRING, NULL]}


def record(**more: object) -> Body:
    return {"type": "object", **more}


def patterned(pattern: str, value: Body, **more: object) -> dict[str, object]:
    return {"type": "object", "patternProperties": {pattern: value}, **more}


FIELDS = (
    yes("a field widens", closed(x=ints(0, 9)), closed(x=NUMBER)),
    no("a field narrows", closed(x=NUMBER), closed(x=INTEGER), {"x": 0.5}),
    yes("order of fields", closed(x=INTEGER, y=STRING), closed(y=STRING, x=INTEGER)),
    no("an extra field into a closed consumer", closed(x=INTEGER, y=STRING), closed(x=INTEGER), {"x": 0, "y": ""}),
    yes("an extra field into an open consumer", closed(x=INTEGER, y=STRING), record(properties={"x": INTEGER}, required=["x"])),
    no("a field that nothing fills", closed(x=INTEGER), closed(x=INTEGER, y=INTEGER), {"x": 0}),
    no("a default fills nothing", closed(x=INTEGER), closed(x=INTEGER, y={"type": "integer", "default": 1}), {"x": 0}),
    no("optional into required", closed((), x=INTEGER), closed(x=INTEGER), {}),
    yes("required into optional", closed(x=INTEGER), closed((), x=INTEGER)),
    no("an open producer into a typed optional field", record(), record(properties={"x": INTEGER}), {"x": ""}),
    yes("closed without the optional field", closed(y=STRING), record(properties={"x": INTEGER})),
    no("a renamed field", closed(x=INTEGER), closed(X=INTEGER), {"x": 0}),
    yes("a required impossible field is empty", record(properties={"x": False}, required=["x"]), False),
    yes("an optional impossible field is absent", closed((), x=False), {"const": {}}),
    yes("forbidden fields", record(properties={"x": False}), record(properties={"x": INTEGER})),
    yes("required under additionalProperties false without a property", {"type": "object", "required": ["x"], "additionalProperties": False}, False),
    yes("required alone asks for any value", record(properties={"x": INTEGER}, required=["x"]), record(required=["x"])),
    yes("object keywords spare others", INTEGER, {"required": ["x"], "properties": {"x": False}}),
    yes("nullable from plain", closed(x=STRING), closed(x=NULLABLE)),
    no("plain from nullable", closed(x=NULLABLE), closed(x=STRING), {"x": None}),
    no("absent is not null", closed((), x=STRING), closed(x=NULLABLE), {}),
    yes("type lists as nullable", closed(x=NULLABLE), closed(x={"type": ["string", "null"]})),
    yes("additionalProperties of a type", record(additionalProperties=ints(0, 9)), record(additionalProperties=NUMBER)),
    no("additionalProperties reaches unnamed fields only", record(properties={"x": STRING}, additionalProperties=INTEGER), record(additionalProperties=INTEGER), {"x": ""}),
    yes("map into a record of optional fields", record(additionalProperties=INTEGER), record(properties={"x": NUMBER, "y": NUMBER})),
    yes("names with odd characters", closed(**{"a/b~c": INTEGER, "": NULL}), record(properties={"a/b~c": NUMBER, "": NULL})),
    no("the name __proto__ is a name", closed(__proto__=INTEGER), record(properties={"__proto__": STRING}), {"__proto__": 0}),
    yes("depth of five", closed(a=closed(b=closed(c=closed(d=closed(e=INTEGER))))), closed(a=closed(b=closed(c=closed(d=closed(e=NUMBER)))))),
)  # fmt: skip

PATTERNS = (
    yes("patternProperties widen", patterned("^x", INTEGER), patterned("^x", NUMBER)),
    yes("a wider pattern reaches more", patterned("^x", INTEGER), patterned("^xy", INTEGER)),
    no("a narrower pattern reaches less", patterned("^xy", INTEGER), patterned("^x", INTEGER), {"x": ""}),
    yes("a pattern reaches a named field", patterned("^x", INTEGER, properties={"x": True}), record(properties={"x": INTEGER})),
    yes("both must hold", patterned("^x", ints(0, None), properties={"x": ints(None, 0)}), record(properties={"x": {"const": 0}})),
    yes("pattern and field exclude each other", patterned("^x", INTEGER, properties={"x": STRING}, required=["x"]), False),
    yes("additional is what neither takes", patterned("^x", INTEGER, additionalProperties=False), record(propertyNames={"pattern": "^x"})),
    yes("propertyNames closes", record(propertyNames={"enum": ["x", "y"]}), record(properties={"x": True, "y": True}, additionalProperties=False)),
    yes("closed gives propertyNames", closed((), x=INTEGER, y=INTEGER), record(propertyNames={"maxLength": 1})),
    no("a long name", record(), record(propertyNames={"maxLength": 3}), {"aaaa": 0}),
    yes("propertyNames false is the empty object", record(propertyNames=False), {"const": {}}),
    yes("propertyNames against required", record(propertyNames={"maxLength": 2}, required=["abc"]), False),
    yes("propertyNames without strings", record(propertyNames=INTEGER), {"const": {}}),
    yes("two patterns that cover all names", {"type": "object", "patternProperties": {"^a": INTEGER, "^[^a]": INTEGER, "^$": INTEGER}}, record(additionalProperties=INTEGER)),
    no("two patterns that leave the empty name", {"type": "object", "patternProperties": {"^a": INTEGER, "^[^a]": INTEGER}}, record(additionalProperties=INTEGER), {"": ""}),
    yes("overlapping patterns both hold", {"type": "object", "patternProperties": {"a": ints(0, None), "b": ints(None, 9)}}, patterned("ab", ints(0, 9))),
    yes("a pattern without a match", patterned("[]", False), OBJECT),
    yes("closed by an empty pattern set", record(patternProperties={}, additionalProperties=False), {"maxProperties": 0}),
    yes("pattern false forbids names", patterned("^x", False), record(properties={"x1": INTEGER})),
    yes("pattern false against required", patterned("^x", False, required=["x1"]), False),
    no("patterns are unanchored", patterned("x", INTEGER), patterned("^x", INTEGER, additionalProperties=False), {"ax": 0}),
)  # fmt: skip

COUNTS = (
    yes("required counts", record(required=["a", "b"]), {"minProperties": 2}),
    no("required counts no more", record(required=["a", "b"]), {"minProperties": 3}, {"a": 0, "b": 0}),
    yes("closed bounds the count", closed((), a=INTEGER, b=INTEGER), {"maxProperties": 2}),
    yes("all of closed by minProperties", {**closed((), a=INTEGER, b=INTEGER), "minProperties": 2}, {"required": ["a", "b"]}),
    no("one of closed", {**closed((), a=INTEGER, b=INTEGER), "minProperties": 1}, {"required": ["a"]}, {"b": 0}),
    yes("more than there are names", {**closed((), a=INTEGER, b=INTEGER), "minProperties": 3}, False),
    yes("required over maxProperties", record(required=["a", "b"], maxProperties=1), False),
    yes("counts cross", record(minProperties=2, maxProperties=1), False),
    yes("maxProperties with required closes", record(required=["a"], maxProperties=1), record(propertyNames={"const": "a"})),
    yes("finite names by pattern", {**patterned("^[ab]$", INTEGER, additionalProperties=False), "minProperties": 3}, False),
    no("infinite names by pattern", {**patterned("^[ab]+$", INTEGER, additionalProperties=False), "minProperties": 3}, False, {"a": 0, "b": 0, "aa": 0}),
    yes("finite names by propertyNames", record(propertyNames={"pattern": "^[0-9]$"}), {"maxProperties": 10}),
    no("and not nine", record(propertyNames={"pattern": "^[0-9]$"}), {"maxProperties": 9}, {str(n): 0 for n in range(10)}),
    yes("an impossible field does not count", {**closed((), a=INTEGER, b=False), "minProperties": 2}, False),
    yes("maxProperties 0", record(maxProperties=0), {"const": {}}),
    yes("exactly one of two", {**closed((), a=INTEGER, b=STRING), "minProperties": 1, "maxProperties": 1}, {"oneOf": [closed(a=INTEGER), closed(b=STRING)]}),
)  # fmt: skip

DEPENDENT = (
    yes("dependentRequired with the trigger required", record(required=["a"], dependentRequired={"a": ["b"]}), {"required": ["b"]}),
    no("dependentRequired without it", record(dependentRequired={"a": ["b"]}), {"required": ["b"]}, {}),
    yes("a chain of them", record(required=["a"], dependentRequired={"a": ["b"], "b": ["c"]}), {"required": ["c"]}),
    yes("a dependent that is impossible", record(properties={"b": False}, required=["a"], dependentRequired={"a": ["b"]}), False),
    yes("an absent trigger", closed((), b=INTEGER), record(dependentRequired={"a": ["b"]})),
    no("a trigger alone", closed((), a=INTEGER, b=INTEGER), record(dependentRequired={"a": ["b"]}), {"a": 0}),
    yes("closed with both required", closed(a=INTEGER, b=INTEGER), record(dependentRequired={"a": ["b"]})),
    yes("dependentSchemas", record(required=["a"], dependentSchemas={"a": {"properties": {"b": INTEGER}}}), record(properties={"b": NUMBER})),
    no("dependentSchemas untriggered", record(dependentSchemas={"a": {"properties": {"b": INTEGER}}}), record(properties={"b": NUMBER}), {"b": ""}),
    yes("dependentSchemas false forbids", record(dependentSchemas={"a": False}), record(properties={"a": False})),
    yes("dependentRequired as an implication", record(dependentRequired={"a": ["b"]}), record(anyOf=[{"not": {"required": ["a"]}}, {"required": ["b"]}])),
    yes("and back", record(anyOf=[{"not": {"required": ["a"]}}, {"required": ["b"]}]), record(dependentRequired={"a": ["b"]})),
)  # fmt: skip

UNEVALUATED = (
    yes("unevaluatedProperties closes across allOf", {"allOf": [record(properties={"a": INTEGER}), record(properties={"b": INTEGER})], "unevaluatedProperties": False}, record(propertyNames={"enum": ["a", "b"]})),
    yes("closed into it", closed((), a=INTEGER, b=INTEGER), {"allOf": [record(properties={"a": INTEGER}), record(properties={"b": INTEGER})], "unevaluatedProperties": False}),
    no("additionalProperties does not see allOf", closed(a=INTEGER), {"allOf": [record(properties={"a": INTEGER})], "additionalProperties": False}, {"a": 0}),
    no("a name that no branch evaluated", closed(c=INTEGER), {"allOf": [record(properties={"a": INTEGER})], "unevaluatedProperties": False}, {"c": 0}),
    yes("unevaluatedProperties through a reference", {"$defs": {"base": record(properties={"a": INTEGER})}, "$ref": "#/$defs/base", "unevaluatedProperties": False}, {"maxProperties": 1}),
    yes("base and extension, both required", closed(a=INTEGER, b=STRING), {"$defs": {"base": record(properties={"a": INTEGER}, required=["a"])}, "$ref": "#/$defs/base", "properties": {"b": STRING}, "unevaluatedProperties": False}),
    no("failed branches evaluate nothing", closed(a=STRING), {"type": "object", "anyOf": [{"properties": {"a": INTEGER}}, True], "unevaluatedProperties": False}, {"a": ""}),
    yes("unevaluatedProperties of a type", {"type": "object", "properties": {"a": STRING}, "unevaluatedProperties": INTEGER}, record(additionalProperties={"type": ["string", "integer"]})),
    yes("unevaluated with if", closed(kind={"const": "n"}, n=INTEGER), {"type": "object", "properties": {"kind": STRING}, "if": {"properties": {"kind": {"const": "n"}}}, "then": {"properties": {"n": INTEGER}}, "unevaluatedProperties": False}),
)  # fmt: skip

ROBOT = (
    yes("pose widens float32 to float64", closed(x={"type": "number", "minimum": -3.4028234663852886e38, "maximum": 3.4028234663852886e38}), closed(x={"type": "number", "minimum": -1.7976931348623157e308, "maximum": 1.7976931348623157e308})),
    no("float64 into float32", closed(x={"type": "number", "minimum": -1.7976931348623157e308, "maximum": 1.7976931348623157e308}), closed(x={"type": "number", "minimum": -3.4028234663852886e38, "maximum": 3.4028234663852886e38}), {"x": 1.7976931348623157e308}),
    no("stamp with nanosec missing", closed(stamp=closed(sec=ints(-(2**31), 2**31 - 1))), closed(stamp=closed(sec=ints(-(2**31), 2**31 - 1), nanosec=ints(0, 2**32 - 1))), {"stamp": {"sec": 0}}),
    yes("covariance of 36", closed(covariance=array(NUMBER, 36, 36)), closed(covariance=array(NUMBER))),
    no("covariance of any length", closed(covariance=array(NUMBER)), closed(covariance=array(NUMBER, 36, 36)), {"covariance": []}),
    no("bool is no uint8", closed(ok=BOOLEAN), closed(ok=ints(0, 1)), {"ok": True}),
    no("string is no enum", closed(mode=STRING), closed(mode={"enum": ["a", "b"]}), {"mode": ""}),
    yes("char is a string of one", closed(c={"type": "string", "minLength": 1, "maxLength": 1}), closed(c=STRING)),
)  # fmt: skip

PAIRS: tuple[Hard, ...] = (*FIELDS, *PATTERNS, *COUNTS, *DEPENDENT, *UNEVALUATED, *ROBOT)
