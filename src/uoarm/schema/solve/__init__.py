"""The search for a value that meets some schemas and fails others, and the check of values."""

from uoarm.schema.solve._evaluate import (
    Judgements,
    item_rules,
    kinds_of_position,
    member_rules,
    named_rules,
)
from uoarm.schema.solve._results import Found, Result, Unknown
from uoarm.schema.solve._search import answer
from uoarm.schema.solve._solver import Solver

__all__ = [
    "Found",
    "Judgements",
    "Result",
    "Solver",
    "Unknown",
    "answer",
    "item_rules",
    "kinds_of_position",
    "member_rules",
    "named_rules",
]
