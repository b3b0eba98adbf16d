"""Units: UCUM codes and common names, read by pint, compared and converted exactly.

What UCUM spells otherwise than pint does is listed here. Angles are kept apart from ratios, so that
`rad/s` is not `Hz` and `deg` is not `%`.
"""

from __future__ import annotations

import difflib
import re
import threading
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from fractions import Fraction
from functools import cache, lru_cache
from typing import Any

from attrs import frozen

from uoarm._origin import install_command

_MOST_CHARACTERS = 60
_MOST_POWER = 12
_MOST_KNOWN = 10_000
_MOST_FACTOR = Fraction(10**100)


class UnitError(ValueError):
    """A unit that cannot be read, or not without pint; the text says which and why."""


@frozen
class Conversion:
    """How a number in one unit becomes one in another: `factor * number + offset`, exactly."""

    factor: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)

    @property
    def changes(self) -> bool:
        """Whether numbers become others at all."""
        return self.factor != 1 or self.offset != 0

    @property
    def lines(self) -> dict[str, float]:
        """What a map says of it: `scale` and `offset`, each only where it does something."""
        reports = {"scale": (self.factor, 1), "offset": (self.offset, 0)}
        return {
            name: int(fraction) if fraction.denominator == 1 else float(fraction)
            for name, (fraction, idle) in reports.items()
            if fraction != idle
        }

    def apply(self, number: float) -> float:
        """Return a number in the other unit, rounded once."""
        return float(self.factor * Fraction(number) + self.offset)


@frozen
class _Unit:
    """What a unit comes to: `factor * number + offset` of the base units with their powers."""

    base: tuple[tuple[str, Fraction], ...]
    factor: Fraction
    offset: Fraction = Fraction(0)


# UCUM's codes by their names in pint, where they differ; and names that people write.
_IN_PINT: Mapping[str, str] = {
    "Cel": "degC", "cel": "degC", "°C": "degC", "[degF]": "degF", "°F": "degF", "[degR]": "degR",
    "[degRe]": "degRe", "°": "degree", "'": "arcminute", "''": "arcsecond", "gon": "grade",
    "circ": "turn", "[in_i]": "inch", "[ft_i]": "foot", "[yd_i]": "yard", "[mi_i]": "mile",
    "[nmi_i]": "nautical_mile", "[kn_i]": "knot", "[lb_av]": "pound", "[oz_av]": "ounce",
    "[lbf_av]": "pound_force", "[psi]": "psi", "[g]": "standard_gravity", "[gal_us]": "gallon",
    "[HP]": "horsepower", "[Btu_IT]": "Btu_it", "[ppm]": "ppm", "[ppth]": "permille",
    "[c]": "speed_of_light", "[in_i'Hg]": "inch_Hg", "%": "percent", "mho": "siemens", "b": "barn",
    "st": "stere", "t": "metric_ton", "u": "unified_atomic_mass_unit", "P": "poise", "sb": "stilb",
    "a": "year", "mo": "month", "wk": "week", "d": "day", "ar": "are", "amp": "ampere",
    "amps": "ampere", "gal": "gallon", "Torr": "torr", "mcd": "millicandela",
}  # fmt: skip
# Those that have prefixes. Pint's own Nm is of yarns, its rads of radiation.
_PREFIXED: Mapping[str, str] = {
    "m[Hg]": "meter_of_mercury", "m[H2O]": "meter_of_water", "Ohm": "ohm", "By": "byte",
    "G": "si_gauss", "gauss": "si_gauss", "Nm": "newton_meter", "rads": "radian",
}  # fmt: skip
_EXPRESSIONS: Mapping[str, str] = {
    "rpm": "{rev}/min", "{rpm}": "{rev}/min", "kmh": "km/h", "Ah": "A.h", "mAh": "mA.h",
    "Wh": "W.h", "kWh": "kW.h", "bpm": "{beats}/min", "fps": "{frames}/s", "mps": "m/s",
}  # fmt: skip
# What a misspelt unit may be meant to be, also where pint is not installed: its names and symbols
# without prefixes, those that people use and those that are near to them.
_WORDS = """
A a abampere abcoulomb abfarad abhenry abmho abohm absiemens abvolt amp ampere amu arcdeg arcdegree
arcmin arcminute arcsec arcsecond atm atmosphere B bar barad barie barn barrel barrie baryd barye
bel biot bit Bq Btu By byte C cal calorie candela candle cd Cel celsius circle clausius cmil coulomb
d darcy day dB decibel deg degC degF degK degR degRe degree degreeC degreeF degreeK degreeR degreeRe
drachm dram eV F fahrenheit farad faraday feet feetHg foot ftHg g galileo gallon gon grad grade
gradian grain gram gray Gy H h hbar henry hertz horsepower hour Hz inch inches inchesHg J joule K
kat katal kelvin kilogram kmh knot L l liter litre lm lumen lux lx m meter metre mho micron mil mile
min minim minute mo mol molar mole molec molecule month mph N newton Np Ohm ohm ounce Pa parsec
pascal percent pole pond pound poundal ppm psi rad radian rads rev revolution rod S s sec second
section siemens slinch sqdeg sr statampere statcoulomb statfarad stathenry steradian srd stone
strain Sv T t tesla thou ton tonne Torr torr turn V volt W watt Wb wb weber week wk yard year
carat karat
"""
_NAMES = frozenset(_WORDS.split())
_PREFIX_WORDS = """
Y Z E P T G M k h da d c m u µ n p f a z y Ki Mi Gi Ti yotta zetta exa peta tera giga mega kilo
hecto deca deka deci centi milli micro nano pico femto atto zepto yocto kibi mebi gibi tebi Δ delta_
"""
_PREFIXES = tuple(_PREFIX_WORDS.split())
_NEAR = 0.75
_SHORTEST = 4  # letters; shorter ones are near to too much
# An annotation says nothing in UCUM; but a turn is an angle to its author.
_TURNS = frozenset({"{rev}", "{revolution}", "{revolutions}", "{turn}", "{turns}"})
_TOKEN = re.compile(
    r"(?P<note>\{[^{}]*\})|(?P<operator>\*(?!\*)|[./·()])|(?P<ten>10(?:\*|\^)[+-]?\d+)"
    r"|(?P<number>\d+)|(?P<name>(?:[^\W\d]+(?:\[[^\[\]]+\])?|\[[^\[\]]+\]|''?|%|°[CF]?)_?)"
    r"(?P<power>(?:\^|\*\*)?[+-]?\d+)?"
)
# A point multiplies: 1.5 would be 5.
_DECIMAL = re.compile(r"\d+\.(?!10[*^])\d")
_LOCK = threading.Lock()
_known: dict[str, _Unit] = {}


def conversion(one: str, other: str) -> Conversion | None:
    """Return how numbers in a unit become those in another; None: they measure different things.

    The first two different units of a process cost about a second, in which pint is loaded.

    Raises:
        UnitError: one of them is not known, or pint is not installed.
    """
    if one == other:
        return Conversion()
    first, second = _read(one), _read(other)
    if first.base != second.base:
        return None
    return Conversion(first.factor / second.factor, (first.offset - second.offset) / second.factor)


def unit_mistake(unit: str) -> str:
    """Return what is wrong with a unit; where pint is not installed, with its spelling alone.

    Without pint, a unit that is neither known nor near to one that is passes.
    """
    try:
        if missing_for_units():
            _require_no_misspelling(unit)
        else:
            _read(unit)
    except UnitError as error:
        return str(error)
    return ""


@cache
def missing_for_units() -> str:
    """Return what is not installed, without which units are only equal or not; nothing if it is."""
    try:
        _registry()
    except UnitError as error:
        return str(error)
    return ""


@cache
def _registry() -> Any:
    try:
        import pint  # noqa: PLC0415 - half a second, for those who state units
    except ImportError as error:
        command = install_command("uoarm", "units")
        raise UnitError(f"to compare and convert units this needs: {command}") from error
    registry: Any = pint.UnitRegistry(non_int_type=Fraction)
    # Pint's own has the dimensions of Gaussian units, and fits no tesla.
    registry.define("si_gauss = 1e-4 * tesla")
    registry.define("newton_meter = newton * meter")
    # Pint for CPython 3.10 has neither.
    registry.define("meter_of_water = 9806.65 * pascal")
    registry.define("meter_of_mercury = 133322.387415 * pascal")
    return registry


def _require_no_misspelling(text: str) -> None:
    for name in _powers(text):
        hint = "" if isinstance(name, Fraction) else _near(name)
        if hint:
            raise UnitError(f"the unit {text!r} is not known: nothing is named {name!r}{hint}")


def _near(name: str) -> str:
    """Return which unit a name may be meant to be; nothing where it is known, or near to none."""
    known = _NAMES | _IN_PINT.keys() | _PREFIXED.keys() | _EXPRESSIONS.keys()
    if "_" in name or len(name) < _SHORTEST or _is_in(name, known):
        return ""
    words = sorted(text for text in known if len(text) >= _SHORTEST - 1)
    close = difflib.get_close_matches(name, words, n=1, cutoff=_NEAR)
    return f"; did you mean {close[0]!r}?" if close else ""


def _is_in(name: str, known: Collection[str]) -> bool:
    """Say whether a name is a unit, one with a prefix, or several of it."""
    one = name.removesuffix("s") if len(name) >= _SHORTEST else name
    return any(
        part in known
        for whole in {name, one}
        for prefix in ("", *_PREFIXES)
        if (part := whole.removeprefix(prefix)) != whole or not prefix
    )


def _read(text: str) -> _Unit:
    if missing_for_units():
        _require_no_misspelling(text)
    found = _known.get(text)
    if found is None:
        with _LOCK:  # pint's registry fills itself as it is asked
            found = _unit(text)
        if len(_known) >= _MOST_KNOWN:
            _known.clear()
        _known[text] = found
    return found


def _unit(text: str) -> _Unit:
    powers = _powers(text)
    alone = len(powers) == 1 and next(iter(powers.values())) == 1
    base: Counter[str] = Counter()
    factor, offset = Fraction(1), Fraction(0)
    for name, power in powers.items():
        if isinstance(name, Fraction):
            factor *= name**power
            continue
        one = _atom(name, text)
        factor *= one.factor**power
        for dimension, exponent in one.base:
            base[dimension] += exponent * power  # type: ignore[assignment]
        if alone:
            offset = one.offset
    if not 1 / _MOST_FACTOR < factor < _MOST_FACTOR:
        raise UnitError(f"{text!r} is no unit: it is too much or too little to make sense")
    kept = tuple(sorted((name, Fraction(power)) for name, power in base.items() if power))
    return _Unit(kept, factor, offset)


def _in_pint(name: str) -> str:
    """Return pint's name for a unit, which may have a prefix."""
    for unit, known in _PREFIXED.items():
        prefix = name.removesuffix(unit)
        if prefix != name and (not prefix or prefix in _PREFIXES):
            return f"{prefix}{known}"
    return _IN_PINT.get(name, name)


@lru_cache(maxsize=1_000)
def _atom(name: str, text: str) -> _Unit:
    registry = _registry()
    try:
        known = registry.get_name(_in_pint(name))
        zero, unity, two = (
            registry.Quantity(Fraction(number), known).to_root_units() for number in range(3)
        )
        values = [Fraction(item.magnitude) for item in (zero, unity, two)]
    except Exception as error:  # pint raises whatever its parts do
        if type(error).__name__ == "UndefinedUnitError":
            message = f"the unit {text!r} is not known: nothing is named {name!r}{_near(name)}"
            raise UnitError(message) from None
        raise UnitError(f"the unit {text!r} is not proportional to others") from error
    if values[2] - values[1] != values[1] - values[0]:
        raise UnitError(f"the unit {text!r} is not proportional to others")
    base = tuple((str(part), Fraction(power)) for part, power in zero._units.items())  # noqa: SLF001
    return _Unit(base, values[1] - values[0], values[0])


def _powers(text: str) -> Counter[str | Fraction]:
    """Return the atoms of a unit with their powers, numbers among them.

    Raises:
        UnitError: it is no expression of units.
    """
    written = _EXPRESSIONS.get(text, text).strip()
    if not written or len(written) > _MOST_CHARACTERS:
        raise UnitError(f"a unit has 1 to {_MOST_CHARACTERS} characters, {text[:80]!r} has not")
    found: Counter[str | Fraction] = Counter()
    signs, sign, awaiting = [1], 1, True
    for number, (kind, part, power) in enumerate(_tokens(written, text)):
        if kind == "operator":
            if part == "(":
                if not awaiting:
                    break
                signs.append(signs[-1] * sign)
                sign = 1
            elif part == ")":
                if awaiting or len(signs) == 1:
                    break
                signs.pop()
            elif awaiting and (part != "/" or number):
                break
            else:
                sign, awaiting = (-1 if part == "/" else 1), True
            continue
        if not awaiting and kind != "note":
            break
        awaiting = False
        if kind == "note" and part not in _TURNS:
            continue
        name: str | Fraction = "turn" if kind == "note" else part
        if kind in {"number", "ten"}:
            name = Fraction(int(part) if kind == "number" else 10)
        found[name] += signs[-1] * sign * power
    else:
        if not awaiting and len(signs) == 1:
            return found
    raise UnitError(f"{text!r} is no unit: write it as in UCUM, such as m/s2, Cel or N.m")


def _tokens(written: str, text: str) -> Iterator[tuple[str, str, int]]:
    position = 0
    while position < len(written):
        match = _TOKEN.match(written, position)
        if match is None:
            raise UnitError(f"{text!r} is no unit: {written[position]!r} stands in none")
        kind = next(key for key in ("note", "operator", "ten", "number", "name") if match[key])
        report = match["power"] or "1"
        if kind == "ten":
            report = match["ten"][3:]
        power = int(report.lstrip("^*"))
        if kind == "number" and (int(match[kind]) == 0 or _DECIMAL.match(written, position)):
            raise UnitError(f"{text!r} is no unit: its numbers are whole ones from 1 on")
        if abs(power) > (_MOST_CHARACTERS if kind == "ten" else _MOST_POWER):
            raise UnitError(f"{text!r} is no unit: a power of {power} is beyond sense")
        yield kind, match[kind], power
        position = match.end()
