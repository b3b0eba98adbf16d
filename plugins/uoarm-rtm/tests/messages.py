"""Hypothesis strategies for messages of any IDL shape."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st
from uoarm_rtm._shape import (
    INTEGERS,
    IdlEnum,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    IdlUnion,
    Shape,
)

from uoarm.cdr import SWITCH


def messages(shape: Shape) -> st.SearchStrategy[Any]:
    """Return messages of a shape: numbers from the whole range, arrays short."""
    if isinstance(shape, IdlStruct):
        return st.fixed_dictionaries({field.name: messages(field.shape) for field in shape.fields})
    if isinstance(shape, IdlSequence):
        most = shape.size if shape.size is not None and (shape.fixed or shape.size < 4) else 4
        least = shape.size if shape.fixed and shape.size else 0
        lists = st.lists(messages(shape.element), min_size=least, max_size=most)
        return lists.map(bytes) if shape.element == IdlScalar("octet") else lists
    if isinstance(shape, IdlUnion):
        return st.one_of([_variant(shape, index) for index in range(len(shape.variants))])
    if isinstance(shape, IdlEnum):
        return st.sampled_from(shape.labels)
    if isinstance(shape, IdlString):
        # A bound counts the characters on the wire.
        last = None if shape.bound is None else 127
        alphabet = st.characters(
            max_codepoint=last, exclude_characters="\0", exclude_categories=["Cs"]
        )
        most = 6 if shape.bound is None else min(shape.bound, 6)
        return st.text(alphabet, max_size=most)
    return _scalar(shape.name)


def _scalar(name: str) -> st.SearchStrategy[Any]:
    if name in INTEGERS:
        return st.integers(*INTEGERS[name])
    if name == "boolean":
        return st.booleans()
    if name == "char":
        return st.characters(max_codepoint=255)
    if name == "wchar":
        return st.characters(max_codepoint=0xFFFF, exclude_categories=["Cs"])
    return st.floats(width=32 if name == "float" else 64)


def _variant(choice: IdlUnion, index: int) -> st.SearchStrategy[Any]:
    variant = choice.variants[index]
    if variant.labels:
        labels = st.sampled_from(variant.labels)
    else:
        named = {label for item in choice.variants for label in item.labels}
        labels = messages(choice.by).filter(lambda label: label not in named)
    return st.fixed_dictionaries({SWITCH: labels, variant.name: messages(variant.shape)})
