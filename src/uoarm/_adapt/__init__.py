"""Adapters: declared in the configuration, checked against both sides, compiled once."""

from uoarm._adapt._adaptation import adapt
from uoarm._adapt._edge import EdgeVerdict, check_edge, transfer
from uoarm._adapt._mapping import MappingError, UnfitError, number_problem, parse

__all__ = [
    "EdgeVerdict",
    "MappingError",
    "UnfitError",
    "adapt",
    "check_edge",
    "number_problem",
    "parse",
    "transfer",
]
