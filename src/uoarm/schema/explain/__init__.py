"""Verdicts: why a message is refused, where, and what is accepted and not kept whole."""

from uoarm.schema.explain._reasons import explain, find_losses
from uoarm.schema.explain._verdict import CheckBudget, Loss, MismatchReason, Verdict

__all__ = ["CheckBudget", "Loss", "MismatchReason", "Verdict", "explain", "find_losses"]
