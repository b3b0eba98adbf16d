"""What numbers, octets and structures mean: read from annotations, compared by path, after fit."""

from uoarm._meaning._judge import (
    BUILT_IN,
    INHERITED,
    SCALED,
    VOCABULARY,
    MeaningDifference,
    Meanings,
    are_alike,
    judge,
    name_of_type,
    write_places,
)
from uoarm._meaning._sizes import JSON_LIMIT, OCTETS_LIMIT, sizes_of
from uoarm._meaning._units import Conversion, UnitError, conversion, missing_for_units, unit_mistake

__all__ = [
    "BUILT_IN",
    "INHERITED",
    "JSON_LIMIT",
    "OCTETS_LIMIT",
    "SCALED",
    "VOCABULARY",
    "Conversion",
    "MeaningDifference",
    "Meanings",
    "UnitError",
    "are_alike",
    "conversion",
    "judge",
    "missing_for_units",
    "name_of_type",
    "sizes_of",
    "unit_mistake",
    "write_places",
]
