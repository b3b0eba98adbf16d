"""Units: published factors, exactly; what is no unit is refused in words."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.meaning.unit_pairs import pairs
from tests.processes import run_python

from uoarm._meaning import Conversion, UnitError, _units, conversion, unit_mistake

PAIRS = list(pairs())


def test_two_hundred_pairs_have_their_published_factors() -> None:
    _units._known.clear()  # what other tests have read
    wrong = []
    for name, other, factor, offset, exact in PAIRS:
        found = conversion(name, other)
        if found is None:
            right = False
        elif exact:
            right = found == Conversion(factor, offset)
        else:
            # As many digits as were published: seven, or the four of a unit of inertia.
            right = abs(found.factor / factor - 1) < (5e-4 if "oz_av" in name else 5e-7)
        if not right:
            wrong.append((name, other, factor, offset, found))
    assert not wrong
    assert len(PAIRS) >= 200
    assert len({pair[:2] for pair in PAIRS}) == len(PAIRS)


@pytest.mark.parametrize(
    ("one", "other"),
    [("rad", "1"), ("deg", "%"), ("Hz", "rad/s"), ("rpm", "Hz"), ("m", "s"), ("m/s", "rad/s"),
     ("kg", "N"), ("Cel", "Cel/s"), ("By", "1"), ("lx", "cd"), ("V", "A")],
)  # fmt: skip
def test_what_measures_something_else_has_no_factor(one: str, other: str) -> None:
    assert conversion(one, other) is None
    assert conversion(other, one) is None


@pytest.mark.parametrize(
    ("unit", "said"),
    [("foo", "'foo' is not known"), ("m//s", "no unit"), ("m/", "no unit"), ("(m", "no unit"),
     ("m)", "no unit"), ("m.s-99", "beyond sense"), ("", "1 to 60"), ("m" * 61, "1 to 60"),
     ("m;s", "stands in none"), ("__import__('os')", "no unit"), (".m", "no unit"),
     ("dB", "not proportional"), ("10*999", "beyond sense"), ("m m", "stands in none"),
     ("0.m", "whole ones"), ("1.5.m", "whole ones"), ("m/0", "whole ones"), ("//s", "no unit"),
     ("{x}//s", "no unit"), ("10*60.10*60", "too much or too little"),
     ("Ym12", "too much or too little")],
)  # fmt: skip
def test_what_is_no_unit_is_said(unit: str, said: str) -> None:
    assert said in unit_mistake(unit)


def test_equal_texts_need_neither_sense_nor_pint() -> None:
    assert conversion("furlongs of beer", "furlongs of beer") == Conversion()


@given(st.sampled_from(PAIRS), st.floats(1e-100, 1e100))
def test_there_and_back_is_the_number_within_an_ulp(
    pair: tuple[str, str, object, object, bool], number: float
) -> None:
    there, back = conversion(pair[0], pair[1]), conversion(pair[1], pair[0])
    assert there is not None
    assert back is not None
    # Exactly, as rationals ...
    assert there.factor * back.factor == 1
    assert there.factor * back.offset + there.offset == 0
    # ... and as floating-point numbers, where the offset does not swallow the digits.
    if not there.offset:
        returned = back.apply(there.apply(number))
        assert abs(returned - number) <= math.ulp(number)


def test_without_pint_units_are_equal_or_refused_and_the_text_says_how_to_get_it() -> None:
    code = """
import sys
sys.modules["pint"] = None
from uoarm._meaning import UnitError, conversion, unit_mistake
assert conversion("m", "m") is not None
assert not unit_mistake("anything")
assert unit_mistake("m//s")
try:
    conversion("m", "cm")
except UnitError as error:
    print(error)
"""
    done = run_python("-c", code, check=True)
    assert "[units]" in done.stdout


def test_a_unit_that_is_not_known_is_an_error_of_its_own() -> None:
    with pytest.raises(UnitError, match="'flugs'"):
        conversion("m", "flugs")


@pytest.fixture(params=["with pint", "without"])
def either_way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "without":
        monkeypatch.setattr(_units, "missing_for_units", lambda: "this needs: pip install pint")


@pytest.mark.usefixtures("either_way")
@pytest.mark.parametrize(
    ("unit", "meant"),
    [
        ("metr", "metre"),
        ("metrs/s", "metre"),
        ("secnd", "second"),
        ("kilogrm", "kilogram"),
        ("radain/s", "radian"),
        ("celcius", "celsius"),
        ("degress", "degree"),
        ("minn", "min"),
        ("Newton.m", "newton"),
    ],
)
def test_a_misspelt_unit_gets_a_near_name(unit: str, meant: str) -> None:
    assert f"did you mean {meant!r}?" in unit_mistake(unit)
    with pytest.raises(UnitError, match=f"did you mean '{meant}'"):
        conversion(unit, "m")


def test_without_pint_no_unit_is_refused_that_pint_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    import pint

    names = [name for name in pint.UnitRegistry()._units if name.isidentifier()]
    names += [f"{name}s" for name in names]
    right = [name for name in names if not unit_mistake(name)]
    monkeypatch.setattr(_units, "missing_for_units", lambda: "this needs: pip install pint")
    assert [name for name in right if unit_mistake(name)] == []
    units = {unit for text, other, *_ in PAIRS for unit in (text, other)}
    assert [unit for unit in units if unit_mistake(unit)] == []
