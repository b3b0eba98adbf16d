"""Adapters: declared in the configuration, checked against both sides, compiled once."""

from uoarm._adapt._adaptation import Adaptation, adapt
from uoarm._adapt._edge import EdgeVerdict, check_edge, transfer
from uoarm._adapt._mapping import MappingEntry, MappingError, UnfitError, number_problem, parse

__all__ = [
    "Adaptation",
    "EdgeVerdict",
    "MappingEntry",
    "MappingError",
    "UnfitError",
    "adapt",
    "check_edge",
    "number_problem",
    "parse",
    "transfer",
]
