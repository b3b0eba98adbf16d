"""Units of fields: what `x-unit` says, else a unit's name at the end of the field's own."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from attrs import frozen

__all__ = ["Conversion", "conversion", "unit_of"]


@frozen
class Conversion:
    """How a number in one unit becomes one in another: `scale * number + offset`."""

    scale: float
    offset: float

    @property
    def changes(self) -> bool:
        """Whether numbers become others at all."""
        return (self.scale, self.offset) != (1.0, 0.0)


@frozen
class _Unit:
    """A unit of a quantity: `factor * number + offset` in its base unit."""

    quantity: str
    factor: float
    offset: float = 0.0


# By UCUM, with the names that fields and device descriptions use instead.
_TABLE: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "temperature": {
        "K kelvin": (1.0, 0.0),
        "Cel celsius °C degC": (1.0, 273.15),
        "[degF] fahrenheit °F degF": (5 / 9, 459.67 * 5 / 9),
    },
    "angle": {
        "rad radians radian": (1.0, 0.0),
        "deg degrees degree °": (3.141592653589793 / 180, 0.0),
    },
    "angular velocity": {
        "rad/s": (1.0, 0.0),
        "deg/s °/s": (3.141592653589793 / 180, 0.0),
        "{rpm} rpm": (3.141592653589793 / 30, 0.0),
    },
    "length": {
        "m metres meters metre meter": (1.0, 0.0),
        "cm centimetres centimeters": (0.01, 0.0),
        "mm millimetres millimeters": (0.001, 0.0),
        "km kilometres kilometers": (1000.0, 0.0),
        "[ft_i] feet ft": (0.3048, 0.0),
        "[in_i] inches inch": (0.0254, 0.0),
    },
    "speed": {
        "m/s": (1.0, 0.0),
        "km/h kmh": (1 / 3.6, 0.0),
        "[mi_i]/h mph": (0.44704, 0.0),
    },
    "time": {
        "s seconds secs sec": (1.0, 0.0),
        "ms milliseconds millis": (1e-3, 0.0),
        "us µs microseconds micros": (1e-6, 0.0),
        "ns nanoseconds nanosec nanosecs nanos": (1e-9, 0.0),
        "min minutes": (60.0, 0.0),
        "h hours": (3600.0, 0.0),
    },
    "pressure": {
        "Pa pascal": (1.0, 0.0),
        "hPa": (100.0, 0.0),
        "kPa": (1000.0, 0.0),
        "bar": (100_000.0, 0.0),
    },
    "mass": {"kg kilograms": (1.0, 0.0), "g grams": (0.001, 0.0)},
    "voltage": {"V volts": (1.0, 0.0), "mV millivolts": (0.001, 0.0)},
    "current": {"A amperes amps": (1.0, 0.0), "mA milliamps": (0.001, 0.0)},
    "share": {"1": (1.0, 0.0), "% percent": (0.01, 0.0)},
}


def _units() -> Iterator[tuple[str, _Unit]]:
    for quantity, units in _TABLE.items():
        for names, (factor, offset) in units.items():
            for name in names.split():
                yield name, _Unit(quantity, factor, offset)


_UNITS = dict(_units())
# A lone letter, or what means something else as well, is no unit at the end of a name.
_NOT_IN_NAMES = {"1", "A", "K", "V", "bar", "g", "h", "min"}
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def unit_of(name: str, schema: Any) -> str | None:
    """Return the unit of a field, None where nothing says it."""
    if isinstance(schema, Mapping) and isinstance(unit := schema.get("x-unit"), str) and unit:
        return unit
    words = _WORDS.findall(name)
    last = words[-1] if words else ""
    for unit in (last, last.lower()):
        if unit in _UNITS and unit not in _NOT_IN_NAMES and (len(unit) > 1 or len(words) > 1):
            return unit
    return None


def conversion(one: str | None, other: str | None) -> Conversion | None:
    """Return how numbers in a unit become those in another; None: not, or nobody knows."""
    if one == other:
        return Conversion(1.0, 0.0)
    first, second = _UNITS.get(one or ""), _UNITS.get(other or "")
    if first is None or second is None or first.quantity != second.quantity:
        return None
    scale, offset = first.factor / second.factor, (first.offset - second.offset) / second.factor
    return Conversion(float(f"{scale:.12g}"), float(f"{offset:.12g}"))
