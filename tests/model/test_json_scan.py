"""What JSON text would cost is found before it is parsed."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.errors import ControlMessageError
from uoarm.model import Budget, BudgetUse, scan_json

# Texts that look like structure, and the escapes that could hide where they end.
TEXTS = st.text('[]{},:"\\/ua0\u00e9', max_size=6)
MESSAGES = st.recursive(
    st.none() | st.integers() | TEXTS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4),
    max_leaves=20,
)


def cost(message: object) -> tuple[int, int]:
    """Return the elements of a message, an empty list or object counted twice, and its depth."""
    if not isinstance(message, list | dict):
        return 1, 0
    inner = list(message.values()) if isinstance(message, dict) else message
    costs = [cost(item) for item in inner]
    names = len(inner) if isinstance(message, dict) else 0
    elements = 1 + (sum(number for number, _ in costs) + names if inner else 1)
    return elements, 1 + max((depth for _, depth in costs), default=0)


@given(MESSAGES, st.booleans())
def test_exactly_what_there_is_must_be_allowed(message: object, ascii_only: bool) -> None:
    text = json.dumps(message, ensure_ascii=ascii_only)
    elements, depth = cost(message)
    scan_json(text, BudgetUse(Budget(elements=elements, depth=max(depth, 1))))
    if elements > 1:
        with pytest.raises(ControlMessageError, match="more than"):
            scan_json(text, BudgetUse(Budget(elements=elements - 1)))
    if depth > 1:
        with pytest.raises(ControlMessageError, match=f"{depth - 1} levels"):
            scan_json(text, BudgetUse(Budget(depth=depth - 1)))


@given(st.text('[]{},:"\\a\ud800', max_size=12), st.integers(1, 6), st.integers(1, 6))
def test_no_text_hides_what_the_parser_would_make(text: str, elements: int, depth: int) -> None:
    budget = Budget(elements=elements, depth=depth)
    try:
        message = json.loads(text)
    except ValueError:
        message = None
    try:
        scan_json(text, BudgetUse(budget))
    except ControlMessageError:
        return
    counted, levels = cost(message)
    assert counted <= elements
    assert levels <= depth


def test_what_was_spent_stays_spent() -> None:
    spending = BudgetUse(Budget(elements=10))
    scan_json("[1,2,3]", spending)
    assert spending.elements == 4 + 1 - 1
    with pytest.raises(ControlMessageError, match="more than 10 values"):
        scan_json("[1,2,3,4,5,6]", spending)
