"""The keywords that say what a structure means; docs/meaning.md is about them."""

from __future__ import annotations

__all__ = ["INHERITED", "SCALED", "VOCABULARY"]

VOCABULARY = ("x-type", "x-unit", "x-quantity", "x-frame", "x-encoding", "x-time")
# What an object or an array says of these holds for all within it that says nothing else.
INHERITED = ("x-unit", "x-quantity", "x-frame", "x-time")
SCALED = "x-scaled"
"""Of what an adapter emits: the factor and the offset that a number has gone through."""
