"""Resolution: from a function asked for to a plan that is proven to fit, or to the reasons."""

from uoarm._resolve._candidates import add_candidates, keep_candidates, without_candidates
from uoarm._resolve._catalogue import (
    EdgeCheck,
    Hold,
    StructureCache,
    StructureCatalogue,
    Structures,
    Unavailable,
)
from uoarm._resolve._discovery import Discovery, check_availability, with_rates
from uoarm._resolve._proofs import Proofs
from uoarm._resolve._resolver import NoPlanError, Resolver

__all__ = [
    "Discovery",
    "EdgeCheck",
    "Hold",
    "NoPlanError",
    "Proofs",
    "Resolver",
    "StructureCache",
    "StructureCatalogue",
    "Structures",
    "Unavailable",
    "add_candidates",
    "check_availability",
    "keep_candidates",
    "with_rates",
    "without_candidates",
]
