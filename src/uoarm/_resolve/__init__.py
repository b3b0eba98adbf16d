"""Resolution: from a function asked for to a plan that is proven to fit, or to the reasons."""

from uoarm._resolve._candidates import (
    add_candidates,
    carry_candidates,
    keep_candidates,
    without_candidates,
)
from uoarm._resolve._catalogue import (
    EdgeCheck,
    Hold,
    StructureCache,
    StructureCatalogue,
    Structures,
    Unavailable,
)
from uoarm._resolve._discovery import (
    Discovery,
    DiscoveryRounds,
    UndescribedComponents,
    check_availability,
    with_rates,
)
from uoarm._resolve._proofs import Proofs
from uoarm._resolve._resolver import (
    NoPlanError,
    Resolver,
    find_replacement,
    reachable_components,
    reachable_functions,
)

__all__ = [
    "Discovery",
    "DiscoveryRounds",
    "EdgeCheck",
    "Hold",
    "NoPlanError",
    "Proofs",
    "Resolver",
    "StructureCache",
    "StructureCatalogue",
    "Structures",
    "Unavailable",
    "UndescribedComponents",
    "add_candidates",
    "carry_candidates",
    "check_availability",
    "find_replacement",
    "keep_candidates",
    "reachable_components",
    "reachable_functions",
    "with_rates",
    "without_candidates",
]
