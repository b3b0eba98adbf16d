"""Verdicts: why a message is refused, where, and what is accepted and not kept whole."""

from uoarm.schema.explain._reasons import explain, find_losses
from uoarm.schema.explain._verdict import Budget, Loss, Reason, Verdict

__all__ = ["Budget", "Loss", "Reason", "Verdict", "explain", "find_losses"]
