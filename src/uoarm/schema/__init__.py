"""Containment of message structures: every message of a producer is accepted by a consumer.

Stands on its own: it needs nothing else of uoarm.
"""

from uoarm.schema._check import check
from uoarm.schema._errors import SchemaError
from uoarm.schema._verdict import Budget, Loss, Reason, Verdict

__all__ = ["Budget", "Loss", "Reason", "SchemaError", "Verdict", "check"]
