"""Configuration files: YAML 1.2 in, a `Robot` or every mistake out."""

from uoarm._yaml import Place, Problem
from uoarm.config._assignments import ASSIGN, assign, installation
from uoarm.config._by_need import add_functions
from uoarm.config._code import with_code
from uoarm.config._difference import ConfigurationDifference, compare, fed_by
from uoarm.config._keeping import is_same, rewrite
from uoarm.config._load import Report, inspect, load, loads
from uoarm.config._merging import is_blank, merge
from uoarm.config._shape import published_schema, structure_schema
from uoarm.config._suggestion import suggest

__all__ = [
    "ASSIGN",
    "ConfigurationDifference",
    "Place",
    "Problem",
    "Report",
    "add_functions",
    "assign",
    "compare",
    "fed_by",
    "inspect",
    "installation",
    "is_blank",
    "is_same",
    "load",
    "loads",
    "merge",
    "published_schema",
    "rewrite",
    "structure_schema",
    "suggest",
    "with_code",
]
