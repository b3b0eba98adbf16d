"""Configuration files: YAML 1.2 in, a `Robot` or every mistake out."""

from uoarm._yaml import Place, Problem
from uoarm.config._difference import ConfigurationDifference, compare, fed_by, with_code
from uoarm.config._keeping import is_same, rewrite
from uoarm.config._load import Report, inspect, is_blank, load, loads, merge
from uoarm.config._shape import ASSIGN, assign, installation, published_schema, structure_schema
from uoarm.config._suggestion import add_functions, suggest

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
