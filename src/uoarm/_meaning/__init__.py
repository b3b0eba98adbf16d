"""What numbers, octets and structures mean: read from annotations, compared by path, after fit."""

from uoarm._meaning._alike import BUILT_IN, are_alike, name_of_type
from uoarm._meaning._judge import Difference, Meanings, judge, write_places
from uoarm._meaning._units import Conversion, UnitError, conversion, missing_for_units, unit_mistake
from uoarm._meaning._vocabulary import INHERITED, SCALED, VOCABULARY

__all__ = [
    "BUILT_IN",
    "INHERITED",
    "SCALED",
    "VOCABULARY",
    "Conversion",
    "Difference",
    "Meanings",
    "UnitError",
    "are_alike",
    "conversion",
    "judge",
    "missing_for_units",
    "name_of_type",
    "unit_mistake",
    "write_places",
]
