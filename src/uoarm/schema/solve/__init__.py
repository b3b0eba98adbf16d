"""The search for a value that meets some schemas and fails others, and the check of values."""

from uoarm.schema.solve._branch import UNSATISFIABLE, Result, Unknown, Unsatisfiable, Witness
from uoarm.schema.solve._differences import Messages, SchemaDifference, differences
from uoarm.schema.solve._evaluate import (
    Judgements,
    item_rules,
    kinds_of_position,
    member_rules,
    named_rules,
)
from uoarm.schema.solve._search import answer
from uoarm.schema.solve._solver import Solver

__all__ = [
    "UNSATISFIABLE",
    "Judgements",
    "Messages",
    "Result",
    "SchemaDifference",
    "Solver",
    "Unknown",
    "Unsatisfiable",
    "Witness",
    "answer",
    "differences",
    "item_rules",
    "kinds_of_position",
    "member_rules",
    "named_rules",
]
