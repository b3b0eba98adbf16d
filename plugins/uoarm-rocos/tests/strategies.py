"""Arbitrary messages, values and catalogues of the profile."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    BooleanField,
    CallMessage,
    CatalogueMessage,
    CloseMessage,
    DataMessage,
    DescribeMessage,
    DeviceCatalogue,
    Direction,
    ErrorCode,
    ErrorMessage,
    Field,
    Fields,
    HeartbeatMessage,
    IntegerField,
    ListField,
    NamedField,
    NumberField,
    OctetsField,
    OpenMessage,
    ResultMessage,
    StringField,
    StructField,
    WireMessage,
)

names = st.from_regex(r"[A-Za-z_][A-Za-z0-9_.\-]{0,63}", fullmatch=True)
texts = st.text(
    st.characters(
        exclude_categories=["Cs"],
        exclude_characters=[
            *map(chr, range(9)),
            "\x0b",
            "\x0c",
            *map(chr, range(14, 32)),
            "\ufffe",
            "\uffff",
        ],
    ),
    max_size=30,
)
numbers = st.floats(allow_nan=False)
int64 = st.integers(-(2**63), 2**63 - 1)
any_text = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
values: st.SearchStrategy[Any] = st.recursive(
    st.booleans() | int64 | numbers | any_text | st.binary(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(names, inner, max_size=4),
    max_leaves=12,
)
structs = st.dictionaries(names, values, max_size=5)
ids = st.integers(1, 2**32 - 1)
seqs = st.integers(0, 2**32 - 1)


def _ordered(pair: tuple[Any, Any]) -> tuple[Any, Any]:
    low, high = pair
    return pair if None in pair or low <= high else (high, low)


def _string(choices: tuple[str, ...], size: int | None) -> StringField:
    """Return texts among which there is one."""
    longest = max(map(len, choices), default=0)
    return StringField(choices, None if size is None else max(size, longest))


finite = st.none() | st.floats(allow_nan=False, allow_infinity=False)
sizes = st.none() | st.integers(0, 2**32 - 1)
simple: st.SearchStrategy[Field] = st.one_of(
    st.just(BooleanField()),
    st.tuples(int64, int64)
    .map(_ordered)
    .flatmap(lambda pair: st.builds(IntegerField, st.just(pair[0]), st.just(pair[1]), texts)),
    st.tuples(finite, finite)
    .map(_ordered)
    .flatmap(
        lambda pair: st.builds(
            NumberField, st.just(pair[0]), st.just(pair[1]), texts, st.booleans()
        )
    ),
    st.builds(_string, st.lists(texts, max_size=3).map(tuple), sizes),
    st.builds(OctetsField, sizes),
)


def fields_of(inner: st.SearchStrategy[Field]) -> st.SearchStrategy[dict[str, NamedField]]:
    """Return dictionaries of named fields of these types."""
    return st.dictionaries(names, st.builds(NamedField, inner, st.booleans()), max_size=3)


fields: st.SearchStrategy[Field] = st.recursive(
    simple,
    lambda inner: (
        st.builds(StructField, fields_of(inner))
        | st.builds(ListField, inner, st.integers(0, 3), st.none() | st.integers(3, 9))
    ),
    max_leaves=4,
)
members = fields_of(fields)
services = st.builds(Api, names, st.just(ApiKind.SERVICE), members, members, st.none(), texts)
flows = st.builds(
    Api,
    names,
    st.just(ApiKind.FLOW),
    members,
    members.filter(bool),
    st.none() | st.floats(0.001, 1000),
    texts,
)
catalogues = st.builds(
    DeviceCatalogue,
    texts,
    st.lists(services | flows, max_size=3).map(lambda apis: {api.name: api for api in apis}),
    texts,
    st.floats(0.05, 60),
)
messages: st.SearchStrategy[WireMessage] = st.one_of(
    st.builds(DescribeMessage, seqs, ids, st.integers(0, 99)),
    st.builds(CatalogueMessage, seqs, ids, catalogues),
    st.builds(CallMessage, seqs, ids, names, structs),
    st.builds(ResultMessage, seqs, ids, structs),
    st.builds(OpenMessage, seqs, ids, names, st.sampled_from(Direction)),
    st.builds(DataMessage, seqs, ids, structs, st.none() | numbers),
    st.builds(CloseMessage, seqs, ids),
    st.builds(ErrorMessage, seqs, st.integers(0, 2**32 - 1), st.sampled_from(ErrorCode), texts),
    st.builds(HeartbeatMessage, seqs),
)


def fitting(fields: Fields) -> st.SearchStrategy[dict[str, Any]]:
    """Return messages that fit these fields."""
    required = {name: _value(field.type) for name, field in fields.items() if field.required}
    optional = {name: _value(field.type) for name, field in fields.items() if not field.required}
    return st.fixed_dictionaries(required, optional=optional)


def _value(kind: Field) -> st.SearchStrategy[Any]:
    if isinstance(kind, BooleanField):
        return st.booleans()
    if isinstance(kind, IntegerField):
        return st.integers(kind.minimum, kind.maximum)
    if isinstance(kind, NumberField):
        return st.floats(kind.minimum, kind.maximum, allow_nan=False, allow_infinity=False)
    if isinstance(kind, OctetsField):
        return st.binary(max_size=min(20, _most(kind.max_length)))
    if isinstance(kind, ListField):
        most = min(kind.min_items + 2, _most(kind.max_items))
        return st.lists(_value(kind.items), min_size=kind.min_items, max_size=most)
    if isinstance(kind, StructField):
        return fitting(kind.members)
    choices = [choice for choice in kind.choices if len(choice) <= _most(kind.max_length)]
    if kind.choices:
        return st.sampled_from(choices) if choices else st.nothing()
    return st.text(max_size=min(9, _most(kind.max_length)))


def _most(limit: int | None) -> int:
    return 2**32 if limit is None else limit
