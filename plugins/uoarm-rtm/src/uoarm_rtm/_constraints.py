"""What a configuration parameter may be: the constraints and types that components declare.

They stand in configuration sets of their own, `__constraints__`, `__widget__` and `__type__`, by
the parameter's name. OpenRTM's tools keep to them; the components themselves do not.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Mapping

__all__ = ["CONSTRAINTS", "TYPES", "WIDGETS", "doubt", "problem"]

CONSTRAINTS, WIDGETS, TYPES = "__constraints__", "__widget__", "__type__"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_ONE_SIDE = re.compile(rf"x\s*(<=|>=|<|>|==)\s*({_NUMBER})|({_NUMBER})\s*(<=|>=|<|>)\s*x")
_BOTH_SIDES = re.compile(rf"({_NUMBER})\s*(<=|<|>=|>)\s*x\s*(<=|<|>=|>)\s*({_NUMBER})")
_COMPARE: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
}
_WHOLE = re.compile(r"[-+]?\d+")
_WHOLES = {"short", "int", "long", "unsigned short", "unsigned int", "unsigned long"}
_NUMBERS = {"float", "double"}


def problem(value: str, constraint: str, kind: str, widget: str) -> str:
    """Return what is wrong with a parameter's value, or "".

    A constraint or type that is written as nothing we know says nothing. Of a list, separated by
    commas, each element must fit.

    Args:
        value: as it is to be written.
        constraint: such as `0<=x<=150` or `(a,b)`; empty for none.
        kind: type, such as `int` or `vector<double>`; empty where it is not declared.
        widget: such as `slider.10`, which only numbers have, or `text`.
    """
    vector = re.fullmatch(r"(?:std::)?vector<(.*)>", kind.strip().lower())
    kind = vector.group(1).strip() if vector else kind.strip().lower()
    constraint = constraint.strip()
    if constraint.startswith("(") and constraint.endswith(")"):
        words = [word.strip() for word in constraint[1:-1].split(",")]
        given = [word.strip() for word in value.split(",")] if widget == "checkbox" else [value]
        return "" if all(name in words for name in given) else f"expected one of {constraint}"
    tests = [_test(word.strip()) for word in constraint.split(",")] if constraint else []
    numeric = (
        any(tests) or widget.split(".", maxsplit=1)[0] in {"slider", "spin"} or kind in _NUMBERS
    )
    for index, element in enumerate(word.strip() for word in value.split(",")):
        if kind in _WHOLES and not _WHOLE.fullmatch(element):
            return f"expected {kind}, got {element!r}"
        if not numeric:
            continue
        if not re.fullmatch(_NUMBER, element):
            return f"expected a number, got {element!r}"
        test = tests[min(index, len(tests) - 1)] if tests else None
        if test is not None and not test(float(element)):
            return f"expected {constraint}, got {element}"
    return ""


def doubt(value: str, before: Iterable[str]) -> str:
    """Return what is odd about a value where the component declares no type and no constraint.

    One that has a number where the text is none takes its default, without an error (observed);
    but a number and a text that happens to look like one are the same here, so it is no problem.

    Args:
        value: as it was written.
        before: what the parameter was, in each set that has it.
    """
    if _is_numeric(value) or not all(map(_is_numeric, before)):
        return ""
    kept = ", ".join(map(repr, dict.fromkeys(before)))
    return (
        f"{value!r} is no number, which it was ({kept}): the component declares no type, and one "
        "that expects a number takes its default instead, without an error"
    )


def _is_numeric(value: str) -> bool:
    return all(re.fullmatch(_NUMBER, word.strip()) for word in value.split(","))


def _test(constraint: str) -> Callable[[float], bool] | None:
    both = _BOTH_SIDES.fullmatch(constraint)
    if both:
        low, first, second, high = both.groups()
        return lambda x: _COMPARE[first](float(low), x) and _COMPARE[second](x, float(high))
    bound = _ONE_SIDE.fullmatch(constraint)
    if bound is None:
        return None
    after, right, left, before = bound.groups()
    if after:
        return lambda x: _COMPARE[after](x, float(right))
    return lambda x: _COMPARE[before](float(left), x)
