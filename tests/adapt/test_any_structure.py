"""Adapters of whatever a structure is: refused, or what they emit is what their schema says."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from tests.schema._reference import Reference
from tests.schema._strategies import Body, schemas

from uoarm._adapt import adapt, parse
from uoarm._adapt._mapping import Structure, UnfitError, leaves, write_path
from uoarm.errors import MessageError
from uoarm.testing._instances import DrawnChoices, find_instance

NUMBERS = st.sampled_from([0, 1, -1, 2, 3, -7, 0.5, -2.5, 1e300, 10**20])


def rules(source: str) -> st.SearchStrategy[Any]:
    """Whatever can be done with what is at a path."""
    ends = st.tuples(NUMBERS, NUMBERS).map(sorted)
    changes = st.fixed_dictionaries(
        {"from": st.just(source)},
        optional={"scale": NUMBERS, "offset": NUMBERS, "clamp": ends, "default": st.just(7)},
    )
    names = dict(
        zip(["a", "b", "ab", "1", "2", "0", "true", "false", "null"], range(9), strict=True)
    )
    named = st.just({"from": source, "enum": names})
    inner = st.sampled_from([{"x": "."}, {".": {"from": ".", "scale": 2}}, {"x": {"const": 1}}])
    each = inner.map(lambda mapping: {"each": source, "map": mapping})
    return st.one_of(st.just(source), changes, named, each)


BOUNDS = st.sampled_from([-3, 0, 0.3, 1, 5, 255, 10**18, 1e308])
numbers = st.fixed_dictionaries(
    {"type": st.sampled_from(["integer", "number", ["integer"], ["number", "null"]])},
    optional={
        "minimum": BOUNDS,
        "maximum": BOUNDS,
        "exclusiveMinimum": BOUNDS,
        "multipleOf": st.just(1),
    },
)
few = st.integers(0, 2)
known = (
    st.just({"enum": [0, 1.0, None, "a"]}) | st.just({"enum": [1, True]}) | st.just({"enum": [[1]]})
)


def arrays(items: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Arrays that say more than what their items are."""
    more = {"minItems": few, "maxItems": few, "uniqueItems": st.booleans(), "contains": items}
    return st.fixed_dictionaries(
        {"type": st.just("array"), "items": items},
        optional={**more, "enum": st.just([[1], [2, 2]])},
    )


def objects(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """What mostly is an object."""
    return st.builds(
        lambda kind, field, required: {
            **({"type": kind} if kind else {}),
            "properties": {"a": field},
            "required": required,
            "maxProperties": 1,
        },
        st.sampled_from(["object", ["object"], ["object", "null"], ""]),
        inner,
        st.sampled_from([["a"], []]),
    )


fields = st.recursive(numbers | known, lambda inner: arrays(inner) | objects(inner), max_leaves=3)
recursive = st.just({"type": "array", "items": {"$ref": "#"}, "maxItems": 2})


@given(schemas | fields | objects(fields) | recursive, st.data())
def test_what_an_adapter_emits_is_what_its_schema_says(producer: Body, data: st.DataObject) -> None:
    paths = [write_path(path) for path, _ in leaves(Structure(producer))]
    mapping = data.draw(
        st.dictionaries(
            st.sampled_from(["a", "b.c"]),
            st.sampled_from([".", *paths]).flatmap(rules),
            min_size=1,
        )
    )
    try:
        adapted = adapt(parse(mapping), producer, {})
    except UnfitError:
        return
    message, is_valid = find_instance(
        producer, DrawnChoices(data.draw), Reference(producer).accepts
    )
    if not is_valid:
        return
    with suppress(MessageError):  # a number that no float can be
        made = adapted.make(message)
        assert Reference(adapted.schema).accepts(made), (adapted.schema, message, made)
