"""How large messages are when they are written: never more than each is, and what one may have."""

from __future__ import annotations

import base64
import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.schema._hand_schemas import hand_schema
from tests.schema._random_choices import RandomChoices
from tests.structures import closed

from uoarm._adapt import check_edge
from uoarm._meaning import JSON_LIMIT, OCTETS_LIMIT, sizes_of
from uoarm.model import MessageStructure
from uoarm.testing import instances

OCTET = {"type": "integer", "minimum": 0, "maximum": 255}
OCTETS = {"type": "array", "items": OCTET, "x-octets": True}
IMAGE = {
    "type": "object",
    "properties": {
        "data": {**OCTETS, "minItems": 3000, "maxItems": 3000},
        "name": {"type": "string"},
    },
    "required": ["data"],
    "additionalProperties": False,
}


def written(message: Any) -> int:
    def plain(value: Any) -> Any:
        return base64.b64encode(value).decode()

    text = json.dumps(message, ensure_ascii=False, separators=(",", ":"), default=plain)
    return len(text.encode())


@pytest.mark.parametrize(
    ("schema", "least", "most"),
    [
        (True, 1, math.inf),
        ({"type": "null"}, 4, 4),
        ({"type": "boolean"}, 4, 5),
        ({"type": "integer", "minimum": -10, "maximum": 9}, 1, 3),
        ({"type": "integer"}, 1, math.inf),
        ({"type": "string"}, 2, math.inf),
        ({"type": "string", "minLength": 3, "maxLength": 5}, 5, 22),
        ({"type": "string", "maxLength": 5, "x-max-utf8": 7}, 2, 9),
        ({"type": "string", "pattern": "^a*$"}, 2, 2),
        ({"type": "string", "format": "date"}, 2, 2),
        ({"enum": ["é", None]}, 4, 4),
        ({"const": {"a": [1, 2]}}, 11, 11),
        ({"type": "array", "items": {"type": "null"}, "minItems": 2, "maxItems": 3}, 11, 16),
        ({"type": "array", "prefixItems": [{"const": "ab"}], "items": False, "minItems": 1}, 6, 6),
        ({"type": "array"}, 2, math.inf),
        ({"type": "array", "maxItems": 1, "contains": {"type": "null"}}, 2, 2),
        ({"type": "array", "maxItems": 1, "unevaluatedItems": {"type": "null"}}, 2, 2),
        ({**OCTETS, "minItems": 300, "maxItems": 300}, 402, 402),
        ({**OCTETS, "minItems": 1}, 3, math.inf),
        (IMAGE, 4011, math.inf),
        ({"anyOf": [{"type": "null"}, {"const": "abcdef"}]}, 4, 8),
        ({"$ref": "#/$defs/a", "$defs": {"a": {"const": "abc"}}}, 5, 5),
        ({"$ref": "#a", "$defs": {"a": {"$anchor": "a", "const": "abc"}}}, 5, 5),
        ({"$ref": "#/anyOf/1", "anyOf": [True, {"const": "abc"}]}, 5, 5),
        ({"anyOf": [{"$ref": "#"}, {"const": "abc"}]}, 1, 5),
        # As a message of another form of its number: 1, 1e+20, 0 and null.
        ({"const": 1.0}, 1, 3),
        ({"const": 10**20}, 5, 21),
        ({"enum": [{"a": [-0.0, None]}]}, 14, 17),
        # Of a document within it, which has definitions of its own.
        ({"$id": "b", "$ref": "#/$defs/a", "$defs": {"a": {"const": "abc"}}}, 5, 5),
        ({"not": {"const": "abc"}, "anyOf": [{"$id": "b", "$ref": "#/not"}, {"const": 1}]}, 1, 1),
        (
            {"type": "object", "properties": {"a": {"$ref": "#"}}, "additionalProperties": False},
            2,
            2,
        ),
        ({"type": ["integer", "null"], "minimum": 0, "maximum": 9}, 1, 4),
        (closed(a={"type": "null"}), 10, 10),
        ({**closed(a={"type": "null"}), "additionalProperties": True}, 10, math.inf),
        ({**closed(a={"type": "null"}), "patternProperties": {"^b": True}}, 10, math.inf),
    ],
)
def test_what_is_known(schema: Any, least: int, most: float) -> None:
    found = sizes_of(schema, JSON_LIMIT)
    assert found.least == least
    assert found.most >= most if "$ref" in str(schema) else found.most == most


@given(st.data())
def test_no_message_is_smaller_than_the_least(data: st.DataObject) -> None:
    schema = hand_schema(RandomChoices(data.draw(st.integers(0, 10_000))))
    message = data.draw(instances(schema))
    assert written(message) >= sizes_of(schema, JSON_LIMIT).least


@pytest.mark.parametrize(
    ("emitted", "limits", "sentence"),
    [
        (
            IMAGE,
            {JSON_LIMIT: 4010},
            "every message has at least 4,011 octets as JSON, and 4,010 are",
        ),
        (IMAGE, {JSON_LIMIT: 4011}, ""),
        ({"type": "string", "maxLength": 50}, {JSON_LIMIT: 100}, "a message may have about 202"),
        ({"type": "string", "maxLength": 50}, {JSON_LIMIT: 202}, ""),
        ({"type": "string"}, {JSON_LIMIT: 10}, ""),
        ({**OCTETS, "maxItems": 50}, {OCTETS_LIMIT: 49}, "a message may have about 50 octets"),
        (OCTETS, {OCTETS_LIMIT: 49}, ""),
        ({"type": "string", "x-max-utf8": 50}, {OCTETS_LIMIT: 49}, "about 50 octets, and 49"),
    ],
)
def test_what_may_be_too_large_is_refused_and_what_nothing_bounds_is_not(
    emitted: Any, limits: dict[str, int], sentence: str
) -> None:
    verdict = check_edge(MessageStructure(emitted), MessageStructure(limits))
    assert verdict.compatible is (not sentence), verdict
    if sentence:
        assert sentence in verdict.reasons[0].sentence
