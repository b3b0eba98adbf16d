"""Containment of message structures: every message of a producer is accepted by a consumer.

Stands on its own: it needs nothing else of uoarm.
"""

from uoarm.schema._check import check
from uoarm.schema._errors import SchemaError
from uoarm.schema._explain import CheckBudget, Loss, MismatchReason, Verdict
from uoarm.schema.regex import UnsupportedPatternError, found_in

__all__ = [
    "CheckBudget",
    "Loss",
    "MismatchReason",
    "SchemaError",
    "UnsupportedPatternError",
    "Verdict",
    "check",
    "found_in",
]
