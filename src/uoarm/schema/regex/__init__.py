"""Regular expressions of ECMA-262 as automata: reading them, and finding texts that meet them."""

from uoarm.schema.regex._nfa import MalformedPatternError, UnsupportedPatternError
from uoarm.schema.regex._parser import compile_pattern, is_disputed
from uoarm.schema.regex._text_search import TooLong, shortest_word
from uoarm.schema.regex._walker import CodeUnits, found_in, walker_of

__all__ = [
    "CodeUnits",
    "MalformedPatternError",
    "TooLong",
    "UnsupportedPatternError",
    "compile_pattern",
    "found_in",
    "is_disputed",
    "shortest_word",
    "walker_of",
]
