"""Containment of message structures: every message of a producer is accepted by a consumer.

Stands on its own: it needs nothing else of uoarm.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from uoarm.schema._check import check
from uoarm.schema._errors import SchemaError
from uoarm.schema._parts import (
    change_parts,
    document_of,
    enclose,
    follow,
    portable,
    property_of,
)
from uoarm.schema._verdict import CheckBudget, Loss, MismatchReason, Verdict

if TYPE_CHECKING:
    from uoarm.schema._newest import newest
    from uoarm.schema.regex import UnsupportedPatternError, found_in

__all__ = [
    "CheckBudget",
    "Loss",
    "MismatchReason",
    "SchemaError",
    "UnsupportedPatternError",
    "Verdict",
    "change_parts",
    "check",
    "document_of",
    "enclose",
    "follow",
    "found_in",
    "newest",
    "portable",
    "property_of",
]

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module = f"uoarm.schema.{'_newest' if name == 'newest' else 'regex'}"
        return getattr(import_module(module), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
