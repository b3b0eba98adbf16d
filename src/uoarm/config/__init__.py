"""Configuration files: YAML 1.2 in, a `Robot` or every mistake out."""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred
from uoarm._support.yaml import Position, Problem

if TYPE_CHECKING:
    from uoarm.config._difference import ConfigurationDifference, compare, fed_by, with_code
    from uoarm.config._keeping import is_same, rewrite
    from uoarm.config._load import Report, inspect, is_blank, load, loads, merge
    from uoarm.config._shape import (
        ASSIGN,
        assign,
        completed_schema,
        installation,
        published_schema,
        structure_schema,
    )
    from uoarm.config._suggestion import add_functions, suggest

__all__ = [
    "ASSIGN",
    "ConfigurationDifference",
    "Position",
    "Problem",
    "Report",
    "add_functions",
    "assign",
    "compare",
    "completed_schema",
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

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(
        __name__,
        {
            "_difference": ("ConfigurationDifference", "compare", "fed_by", "with_code"),
            "_keeping": ("is_same", "rewrite"),
            "_load": ("Report", "inspect", "is_blank", "load", "loads", "merge"),
            "_shape": (
                "ASSIGN",
                "assign",
                "completed_schema",
                "installation",
                "published_schema",
                "structure_schema",
            ),
            "_suggestion": ("add_functions", "suggest"),
        },
    )
