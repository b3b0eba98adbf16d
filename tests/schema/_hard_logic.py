# ruff: noqa: E501 - a table is read best with one pair a line
"""Unions, negation, conditions, references and recursion: pairs of known truth."""

from __future__ import annotations

from tests.schema._hard import (
    ARRAY,
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


def tagged(**branches: Body) -> dict[str, object]:
    return {"oneOf": [closed(kind={"const": tag}, body=body) for tag, body in branches.items()]}


TREE: dict[str, object] = closed(("value",), value=INTEGER, children=array({"$ref": "#"}))
WIDE_TREE: dict[str, object] = closed(("value",), value=NUMBER, children=array({"$ref": "#"}))
CHAIN: dict[str, object] = closed(("value",), value=INTEGER, next={"$ref": "#"})
ENDLESS: dict[str, object] = closed(value=INTEGER, next={"$ref": "#"})
EITHER: dict[str, object] = {
    "$defs": {
        "odd": closed(("n",), n=INTEGER, next={"$ref": "#/$defs/even"}),
        "even": closed(("n",), n=INTEGER, next={"$ref": "#/$defs/odd"}),
    },
    "$ref": "#/$defs/odd",
}

WITHOUT_A: Body = {"type": "object", "not": {"required": ["a"]}}

UNIONS = (
    yes("a union in any order", {"anyOf": [INTEGER, STRING]}, {"anyOf": [STRING, INTEGER]}),
    no("a branch too many", {"anyOf": [INTEGER, STRING, NULL]}, {"anyOf": [STRING, INTEGER]}, None),
    yes("tagged union into more tags", tagged(a=INTEGER, b=STRING), tagged(b=STRING, c=NULL, a=NUMBER)),
    no("tagged union into fewer", tagged(a=INTEGER, b=STRING), tagged(a=INTEGER), {"kind": "b", "body": ""}),
    no("tags swapped", tagged(a=INTEGER, b=STRING), tagged(a=STRING, b=INTEGER), {"kind": "a", "body": 0}),
    no("union of fields is more than the union of records", closed(a={"anyOf": [INTEGER, STRING]}, b={"anyOf": [INTEGER, STRING]}), {"anyOf": [closed(a=INTEGER, b=INTEGER), closed(a=STRING, b=STRING)]}, {"a": 0, "b": ""}),
    yes("union of records within fields of unions", {"anyOf": [closed(a=INTEGER, b=INTEGER), closed(a=STRING, b=STRING)]}, closed(a={"anyOf": [INTEGER, STRING]}, b={"anyOf": [INTEGER, STRING]})),
    yes("split over one field", closed(a={"anyOf": [INTEGER, STRING]}, b=NULL), {"anyOf": [closed(a=INTEGER, b=NULL), closed(a=STRING, b=NULL)]}),
    yes("split over two fields", closed(a=BOOLEAN, b=BOOLEAN), {"anyOf": [closed(a={"const": x}, b={"const": y}) for x in (True, False) for y in (True, False)]}),
    no("split over two fields, one missing", closed(a=BOOLEAN, b=BOOLEAN), {"anyOf": [closed(a={"const": x}, b={"const": y}) for x, y in ((True, True), (True, False), (False, True))]}, {"a": False, "b": False}),
    yes("overlapping covers", closed(a=ints(0, 9), b=ints(0, 9)), {"anyOf": [closed(a=ints(0, 5), b=ints(0, 9)), closed(a=ints(4, 9), b=ints(0, 6)), closed(a=ints(6, 9), b=ints(5, 9))]}),
    no("overlapping covers but one", closed(a=ints(0, 9), b=ints(0, 9)), {"anyOf": [closed(a=ints(0, 5), b=ints(0, 9)), closed(a=ints(4, 9), b=ints(0, 6)), closed(a=ints(7, 9), b=ints(5, 9))]}, {"a": 6, "b": 7}),
    yes("oneOf without overlap is anyOf", {"anyOf": [INTEGER, STRING]}, {"oneOf": [INTEGER, STRING]}),
    no("oneOf refuses the overlap", INTEGER, {"oneOf": [INTEGER, NUMBER]}, 0),
    yes("oneOf of integer and number is the fractions", {"oneOf": [INTEGER, NUMBER]}, {"type": "number", "not": INTEGER}),
    yes("the fractions into oneOf", {"type": "number", "not": INTEGER}, {"oneOf": [INTEGER, NUMBER]}),
    yes("oneOf of ranges", {"oneOf": [ints(0, 10), ints(5, 15)]}, {"anyOf": [ints(0, 4), ints(11, 15)]}),
    yes("ranges into oneOf", {"anyOf": [ints(0, 4), ints(11, 15)]}, {"oneOf": [ints(0, 10), ints(5, 15)]}),
    yes("oneOf of the same twice is empty", {"oneOf": [STRING, STRING]}, False),
    yes("oneOf of three overlapping", {"oneOf": [ints(0, 5), ints(3, 8), ints(5, 9)]}, {"enum": [0, 1, 2, 9]}),
    yes("empty branches do not matter", {"anyOf": [INTEGER, {"type": "integer", "minimum": 1, "maximum": 0}]}, INTEGER),
    yes("allOf of types without overlap", {"allOf": [INTEGER, STRING]}, False),
    yes("allOf of number and integer", {"allOf": [INTEGER, NUMBER]}, INTEGER),
    yes("anyOf beside keywords", {"type": "integer", "anyOf": [{"minimum": 5}, {"maximum": 3}]}, {"not": {"const": 4}}),
)  # fmt: skip

NEGATION = (
    yes("not not", INTEGER, {"not": {"not": INTEGER}}),
    yes("not everything is nothing", {"not": True}, False),
    yes("not nothing is everything", True, {"not": False}),
    yes("not {} is nothing", {"not": {}}, INTEGER),
    yes("de Morgan", {"not": {"anyOf": [INTEGER, STRING]}}, {"allOf": [{"not": INTEGER}, {"not": STRING}]}),
    yes("de Morgan back", {"allOf": [{"not": INTEGER}, {"not": STRING}]}, {"not": {"anyOf": [INTEGER, STRING]}}),
    yes("not required", WITHOUT_A, {"type": "object", "properties": {"a": False}}),
    yes("forbidden into not required", {"type": "object", "properties": {"a": False}}, WITHOUT_A),
    no("not of two required", {"type": "object", "not": {"required": ["a", "b"]}}, {"not": {"required": ["a"]}}, {"a": 0}),
    yes("not a minimum", {"type": "integer", "not": {"minimum": 5}}, {"maximum": 4}),
    yes("not a keyword of another type is nothing", {"type": "string", "not": {"minimum": 5}}, False),
    yes("not a property", {"type": "object", "not": {"properties": {"a": INTEGER}}}, {"required": ["a"]}),
    no("not a property may hold null", {"type": "object", "not": {"properties": {"a": INTEGER}}}, {"properties": {"a": STRING}}, {"a": None}),
    yes("not items", {"type": "array", "not": {"items": INTEGER}}, {"contains": {"not": INTEGER}}),
    yes("not contains", {"type": "array", "not": {"contains": INTEGER}}, {"items": {"not": INTEGER}}),
    yes("items into not contains", array({"not": INTEGER}), {"not": {"contains": INTEGER}}),
    yes("not maxItems", {"type": "array", "not": {"maxItems": 2}}, {"minItems": 3}),
    yes("not a record", {"not": OBJECT}, {"type": ["array", "string", "number", "boolean", "null"]}),
    yes("not an enum", {"type": "boolean", "not": {"enum": [True]}}, {"const": False}),
    yes("the one record of an enum, behind a text", closed(a={"const": 1}), {"enum": ["a", {"a": 1}]}),
    yes("the one list of an enum, behind a record", {"type": "array", "maxItems": 0}, {"enum": [{"a": 1}, []]}),
    yes("not additionalProperties", {"type": "object", "not": {"additionalProperties": False}}, {"minProperties": 1}),
    yes("a record that is not another", {**closed((), a=INTEGER), "not": {"required": ["a"]}}, {"const": {}}),
    yes("not a dependentRequired", {"type": "object", "not": {"dependentRequired": {"a": ["b"]}}}, {"required": ["a"], "properties": {"b": False}}),
    yes("not propertyNames", {"type": "object", "not": {"propertyNames": {"maxLength": 2}}}, {"minProperties": 1}),
    yes("not uniqueItems of booleans", {"type": "array", "items": BOOLEAN, "minItems": 3}, {"not": {"uniqueItems": True}}),
)  # fmt: skip

CONDITIONS = (
    yes("if a tag then its body", tagged(a=INTEGER, b=STRING), {"if": {"properties": {"kind": {"const": "a"}}}, "then": {"properties": {"body": INTEGER}}, "else": {"properties": {"body": STRING}}}),
    no("if the other way round", tagged(a=INTEGER, b=STRING), {"if": {"properties": {"kind": {"const": "a"}}}, "then": {"properties": {"body": STRING}}}, {"kind": "a", "body": 0}),
    yes("then without if is ignored", STRING, {"then": INTEGER, "else": False}),
    yes("if without then and else", STRING, {"if": INTEGER}),
    yes("if as an implication", {"if": INTEGER, "then": {"minimum": 0}}, {"anyOf": [{"not": INTEGER}, {"minimum": 0}]}),
    yes("an implication as if", {"anyOf": [{"not": INTEGER}, {"minimum": 0}]}, {"if": INTEGER, "then": {"minimum": 0}}),
    yes("if true takes then", {"if": True, "then": INTEGER, "else": STRING}, INTEGER),
    yes("if false takes else", {"if": False, "then": INTEGER, "else": STRING}, STRING),
    no("an absent tag satisfies properties", {"type": "object"}, {"if": {"properties": {"kind": {"const": "a"}}}, "then": {"required": ["body"]}}, {}),
    yes("if then false", {"type": "number", "if": INTEGER, "then": False}, {"not": INTEGER}),
)  # fmt: skip

REFERENCES = (
    yes("a reference is its target", {"$defs": {"i": INTEGER}, "$ref": "#/$defs/i"}, INTEGER),
    yes("a chain of references", {"$defs": {"i": {"$ref": "#/$defs/j"}, "j": INTEGER}, "$ref": "#/$defs/i"}, NUMBER),
    yes("an anchor", {"$defs": {"x": {"$anchor": "here", "type": "integer"}}, "$ref": "#here"}, INTEGER),
    yes("keywords beside a reference hold", {"$defs": {"i": INTEGER}, "$ref": "#/$defs/i", "minimum": 0}, ints(0, None)),
    yes("escapes in a pointer", {"$defs": {"a/b~c%d": INTEGER}, "$ref": "#/$defs/a~1b~0c%25d"}, INTEGER),
    yes("a pointer into properties", {"type": "object", "properties": {"a": INTEGER, "b": {"$ref": "#/properties/a"}}}, {"properties": {"b": NUMBER}}),
    yes("a pointer into an array of schemas", {"anyOf": [STRING, {"type": "array", "items": {"$ref": "#/anyOf/0"}}]}, {"anyOf": [STRING, array(STRING)]}),
    yes("a list into itself", CHAIN, CHAIN),
    yes("a tree into itself", TREE, TREE),
    yes("a tree widens", TREE, WIDE_TREE),
    no("a tree narrows", WIDE_TREE, TREE, {"value": 0.5}),
    no("a list is longer than two", CHAIN, closed(("value",), value=INTEGER, next=closed(value=INTEGER)), {"value": 0, "next": {"value": 0, "next": {"value": 0}}}),
    yes("two of a list", closed(("value",), value=INTEGER, next=closed(value=INTEGER)), CHAIN),
    yes("a required recursive field is empty", ENDLESS, False),
    yes("and so in a union", {"anyOf": [STRING, {"$defs": {"e": closed(next={"$ref": "#/anyOf/1/$defs/e"})}, "$ref": "#/anyOf/1/$defs/e"}]}, STRING),
    yes("an endless one within a list", array({"$ref": "#/$defs/e"}) | {"$defs": {"e": closed(next={"$ref": "#/$defs/e"})}}, {"maxItems": 0}),
    no("an endless optional one is not empty", CHAIN, False, {"value": 0}),
    yes("even and odd are one list", EITHER, closed(("n",), n=INTEGER, next={"$ref": "#"})),
    yes("one list is even and odd", closed(("n",), n=INTEGER, next={"$ref": "#"}), EITHER),
    yes("an unrolled list", CHAIN, closed(("value",), value=INTEGER, next=closed(("value",), value=INTEGER, next={"$ref": "#"}))),
    no("an unrolled list that changes", CHAIN, closed(("value",), value=INTEGER, next=closed(("value",), value=ints(0, 9), next={"$ref": "#"})), {"value": 0, "next": {"value": 10}}),
    yes("json itself", {"$defs": {"j": {"anyOf": [NULL, BOOLEAN, NUMBER, STRING, array({"$ref": "#/$defs/j"}), {"type": "object", "additionalProperties": {"$ref": "#/$defs/j"}}]}}, "$ref": "#/$defs/j"}, True),
    yes("everything is json", True, {"$defs": {"j": {"anyOf": [NULL, BOOLEAN, NUMBER, STRING, array({"$ref": "#/$defs/j"}), {"type": "object", "additionalProperties": {"$ref": "#/$defs/j"}}]}}, "$ref": "#/$defs/j"}),
    no("nested arrays of unknown depth", {"$defs": {"n": array({"$ref": "#/$defs/n"})}, "$ref": "#/$defs/n"}, array(array({"maxItems": 0})), [[[[]]]]),
    yes("nested arrays hold arrays", {"$defs": {"n": array({"$ref": "#/$defs/n"})}, "$ref": "#/$defs/n"}, array(ARRAY)),
    yes("a nest that never ends is empty", {"$defs": {"n": array({"$ref": "#/$defs/n"}, 1)}, "$ref": "#/$defs/n"}, False),
    yes("a recursion under not", {"type": "object", "properties": {"a": {"not": {"$ref": "#"}}}, "required": ["a"]}, {"required": ["a"]}),
)  # fmt: skip

PAIRS: tuple[Hard, ...] = (*UNIONS, *NEGATION, *CONDITIONS, *REFERENCES)
