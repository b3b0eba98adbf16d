"""What numbers, octets and structures mean: read from annotations, compared by path, after fit."""

from uoarm._meaning._judge import judge
from uoarm._meaning._sizes import JSON_LIMIT, OCTETS_LIMIT, sizes_of
from uoarm._meaning._statements import (
    AROUND,
    INHERITED,
    SCALED,
    MeaningDifference,
    name_of_type,
    said_around,
    write_places,
)
from uoarm._meaning._units import Conversion, UnitError, conversion, missing_for_units, unit_mistake

__all__ = [
    "AROUND",
    "INHERITED",
    "JSON_LIMIT",
    "OCTETS_LIMIT",
    "SCALED",
    "Conversion",
    "MeaningDifference",
    "UnitError",
    "conversion",
    "judge",
    "missing_for_units",
    "name_of_type",
    "said_around",
    "sizes_of",
    "unit_mistake",
    "write_places",
]
