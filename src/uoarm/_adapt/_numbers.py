"""Scale and clamp: the schema of what they make, and the function that makes it.

Numbers are computed as the schema's bounds are: whole ones exactly, others in double precision,
whatever the width of the array that they come in.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

from uoarm._adapt._mapping import (
    Clamp,
    Path,
    Scale,
    Structure,
    UnfitError,
    kind_of,
    within,
    write_path,
)
from uoarm._meaning import INHERITED, SCALED
from uoarm.errors import MessageError

Maker: TypeAlias = Callable[[Any], Any]
_MAX_LEVELS = 12
_WIDTHS = (16, 32, 64)
_INFINITE = (math.inf, -math.inf)


def scaled(
    scale: Scale, source: Structure, schema: Any, path: Path, *, is_last: bool
) -> tuple[Any, Maker]:
    """Return the schema of scaled numbers, or arrays of them, and what makes them.

    What becomes infinite is refused where it is the last: JSON has no such numbers.

    Raises:
        UnfitError: there is something else at that path.
    """

    def change(plain: Mapping[str, Any]) -> tuple[Any, Maker, Maker]:
        is_whole = kind_of(plain) == "integer" and _is_whole(scale.factor, scale.offset)
        ends = dict(zip(("minimum", "maximum"), _range(plain, scale), strict=True))
        bounds = {key: end for key, end in ends.items() if end is not None}
        kept = _kept(plain, "x-nonfinite")
        if "x-unit" in kept:
            kept[SCALED] = (scale.factor, scale.offset)
        made = {"type": "integer" if is_whole else "number", **bounds, **kept}
        return made, *_scalers(scale, write_path(path), is_last=is_last)

    return _of_numbers(change, source, schema, path, "scale and offset need")


def clamped(clamp: Clamp, source: Structure, schema: Any, path: Path) -> tuple[Any, Maker]:
    """Return the schema of clamped numbers, or arrays of them, and what makes them.

    Raises:
        UnfitError: there is something else at that path, or the ends are not of its type.
    """

    def change(plain: Mapping[str, Any]) -> tuple[Any, Maker, Maker]:
        if kind_of(plain) == "integer" and not _is_whole(clamp.low, clamp.high):
            text = "clamp needs integers here, since the field is an integer"
            raise UnfitError(write_path(path), text)
        least, most = _range(plain, Scale())
        low = clamp.low if least is None else min(max(least, clamp.low), clamp.high)
        high = clamp.high if most is None else min(max(most, clamp.low), clamp.high)
        kept = _kept(plain, "x-nonfinite", SCALED)
        made = {"type": kind_of(plain), "minimum": low, "maximum": high, **kept}
        return made, *_clampers(low, high)

    return _of_numbers(change, source, schema, path, "clamp needs")


_Change: TypeAlias = Callable[[Mapping[str, Any]], tuple[Any, Maker, Maker]]


def _of_numbers(
    change: _Change, source: Structure, schema: Any, path: Path, needs: str
) -> tuple[Any, Maker]:
    """Change the numbers of a field, which may be in arrays within arrays."""
    where = write_path(path)
    arrays: list[Mapping[str, Any]] = []
    plain = source.plain(schema, where)
    while kind_of(plain) == "array" and "items" in plain and "prefixItems" not in plain:
        if len(arrays) == _MAX_LEVELS:
            raise UnfitError(where, f"{needs} arrays of at most {_MAX_LEVELS} levels")
        arrays.append(plain)
        plain = source.plain(within(plain, plain["items"]), where)
    if kind_of(plain) not in ("integer", "number"):
        raise UnfitError(where, f"{needs} a number or an array of numbers")
    made, make, make_array = change(plain)
    for array in reversed(arrays):
        made, make = array_of(made, array), _in_array(make, make_array)
    return made, make


def array_of(items: Any, source: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of an array that is made item by item.

    No more than its bounds stays true: not which values it has, or that none is twice.
    """
    bounds = {key: source[key] for key in ("minItems", "maxItems") if key in source}
    return {"type": "array", "items": items, **bounds}


def _in_array(make: Maker, make_array: Maker) -> Maker:
    def apply(value: Any) -> Any:
        if not hasattr(value, "dtype"):
            return [make(item) for item in value]
        changed = make_array(value)
        return apply(value.tolist()) if changed is None else changed

    return apply


def _scalers(scale: Scale, where: str, *, is_last: bool) -> tuple[Maker, Maker]:
    """Return what scales a number, and what scales an array of numpy; None: not exactly."""
    factor, offset = scale.factor, scale.offset
    beyond = f"{where}: a scaled number is beyond those of a float"

    def number(value: Any) -> Any:
        if hasattr(value, "dtype"):  # of numpy, whose own numbers wrap
            value = value.item()
        try:
            made = value * factor + offset
        except OverflowError:
            raise MessageError(beyond) from None
        if is_last and made in _INFINITE and value not in _INFINITE:
            raise MessageError(beyond)
        return made

    def array(value: Any) -> Any:
        kind = value.dtype.kind
        if kind == "f" or (kind in "iu" and isinstance(factor, float)):
            numpy = sys.modules["numpy"]  # whose array it is
            with numpy.errstate(over="ignore"):
                made = value.astype("float64") * float(factor) + float(offset)
            are_numbers = not is_last or numpy.isfinite(made).all()
            if not are_numbers and (numpy.isinf(made) & numpy.isfinite(value)).any():
                raise MessageError(beyond)
            return made
        if kind in "iu" and value.size:
            # By the width first, which needs no look at the numbers.
            for least, most in (_limits(value.dtype), (int(value.min()), int(value.max()))):
                ends = least * factor, most * factor
                sums = (offset, *(end + offset for end in ends)) if _is_whole(offset) else ()
                met = (factor, least, most, *ends, *sums)
                width = next((bits for bits in _WIDTHS if _fit(met, bits)), None)
                if width is not None:
                    return value.astype(f"int{width}") * factor + offset
        return None

    return number, array


def _clampers(low: float, high: float) -> tuple[Maker, Maker]:
    def number(value: Any) -> Any:
        return low if value < low else min(value, high)

    def array(value: Any) -> Any:
        kind = value.dtype.kind
        if kind == "f":
            return value.astype("float64").clip(float(low), float(high))
        if kind in "iu":
            least, most = _limits(value.dtype)
            ends = max(low, least), min(high, most)
            # Else the ends are not of this width, or all would become floats.
            if low <= most and high >= least and _is_whole(*ends):
                return value.clip(*ends)
        return None

    return number, array


def _fit(numbers: Iterable[float], bits: int) -> bool:
    return all(-(2 ** (bits - 1)) <= number < 2 ** (bits - 1) for number in numbers)


def _limits(dtype: Any) -> tuple[int, int]:
    """Return the least and the greatest whole number of a type of numpy."""
    bits = 8 * dtype.itemsize
    return (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if dtype.kind == "i" else (0, 2**bits - 1)


def _is_whole(*numbers: float) -> bool:
    return all(isinstance(number, int) for number in numbers)


def _kept(plain: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: plain[key] for key in (*keys, *INHERITED) if key in plain}


def _range(schema: Mapping[str, Any], scale: Scale) -> tuple[float | None, float | None]:
    """Scale the bounds by the very arithmetic that messages meet: it is monotone, so they hold."""
    low = _ends(schema, "inimum", math.ceil, math.inf, scale)
    high = _ends(schema, "aximum", math.floor, -math.inf, scale)
    if scale.factor < 0:
        low, high = high, low
    return min(low, default=None), max(high, default=None)


def _ends(
    schema: Mapping[str, Any],
    ending: str,
    to_whole: Callable[[float], int],
    inward: float,
    scale: Scale,
) -> list[float]:
    """Scale one bound as a whole number, exactly, and as a float, rounded: messages have either."""
    bound = schema.get(f"m{ending}", schema.get(f"exclusiveM{ending}"))
    if bound is None:
        return []
    try:
        whole = to_whole(bound)
        if kind_of(schema) == "integer":
            bound = whole
        real = float(bound)
        if real != bound and (real < bound) == (inward > 0):
            real = math.nextafter(real, inward)
        made = [number * scale.factor + scale.offset for number in (whole, real)]
        return made if all(map(math.isfinite, made)) else []
    except (OverflowError, ValueError):  # beyond the floats: so are the messages, which are refused
        return []
