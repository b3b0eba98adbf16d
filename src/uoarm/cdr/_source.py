"""The text of one generated function, with what is known of the place that each line is about.

When a line fails, its number says which member of the message it was about: nothing is counted or
kept while messages pass, and no second, slow reader is needed to name what did not fit.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Any, TypeAlias

from attrs import frozen

from uoarm._raised import foreign, text_of
from uoarm.cdr._layout import Encoding
from uoarm.cdr._values import UnfitValue

WHOLE = 8
"""What is known of the position where a message begins: it is a multiple of the greatest number."""

_PLACES = "_places_of_lines"


class Index(str):
    """The name of the variable that counts the elements of an array, as part of a path."""

    __slots__ = ()


Path: TypeAlias = "tuple[str, ...]"


@frozen
class PlaceCheck:
    """What says whether a variable has a value that fits, once a line has failed."""

    path: Path
    variable: str
    check: Callable[[Any], Any]


class SourceText:
    """One function, line by line.

    Nothing of a message ever enters the text: names of members come in as quoted literals,
    everything else as a constant.

    While the text is written, `modulus` and `rest` say what is known of the position at that
    place, counted from behind the header: it is `rest` more than a multiple of `modulus`.

    Attributes:
        path: of the value that the next line is about.
        checks: of what may be wrong with that line.
        depth: of the next line's block.
    """

    def __init__(self, head: str, encoding: Encoding, modulus: int) -> None:
        self._is_aligned = encoding.is_aligned
        self._lines = [head]
        self._places: list[tuple[Path, tuple[PlaceCheck, ...]]] = [((), ())]
        self._constants: dict[str, Any] = {_PLACES: self._places}
        self._names = 0
        self.path: Path = ()
        self.checks: tuple[PlaceCheck, ...] = ()
        self.depth = 1
        self.modulus = modulus
        self.rest = 0

    def line(self, text: str, *checks: PlaceCheck) -> None:
        self._lines.append(" " * self.depth + text)
        self._places.append((self.path, (*self.checks, *checks)))

    def variable(self) -> str:
        """Return a variable's name that is not in use."""
        self._names += 1
        return f"v{self._names}"

    def constant(self, value: object) -> str:
        """Return a name by which the function's text may refer to a value."""
        name = f"c{len(self._constants)}"
        self._constants[name] = value
        return name

    def known(self, modulus: int, rest: int = 0) -> None:
        """Say what is known of the position from here on."""
        self.modulus, self.rest = modulus, rest

    def gap(self, size: int) -> int | None:
        """Return the padding before a number of this size; None: only the message says."""
        if not self._is_aligned or size == 1:
            return 0
        return None if size > self.modulus else -self.rest % size

    def advance(self, octets: int) -> None:
        """Go on by a known number of octets."""
        self.rest = (self.rest + octets) % self.modulus

    def function(self) -> Callable[..., Any]:
        """Compile the text, whose function is called `made`."""
        names = dict(self._constants)
        exec("\n".join(self._lines), names)  # noqa: S102 - our own text, see the class
        made: Callable[..., Any] = names["made"]
        return made


def explain(error: BaseException, otherwise: str = "") -> str:
    """Return the path of what a generated function failed at, and what is wrong with it.

    Args:
        error: that it raised.
        otherwise: what is wrong where no check says so; "": what the error says.
    """
    traceback: TracebackType | None = error.__traceback__
    path, places = "", []
    variables: dict[str, Any] = {}
    while traceback is not None:
        names = traceback.tb_frame.f_globals
        if _PLACES in names:
            parts, checks = names[_PLACES][traceback.tb_lineno - 1]
            variables = traceback.tb_frame.f_locals
            start, path = path, path + _shown(parts, variables)
            places = [(start + _shown(check.path, variables), check) for check in checks]
        traceback = traceback.tb_next
    if isinstance(error, UnfitValue):
        return f"{path}{_glue(error)}{error}"
    for place, check in places:
        if check.variable in variables:
            try:
                foreign(check.check, variables[check.variable])
            except UnfitValue as misfit:
                return f"{place}{_glue(misfit)}{misfit}"
            except Exception as raised:  # noqa: BLE001 - of a value's own methods, as before
                return f"{place}: {text_of(raised)}"
    return f"{path}: {otherwise or text_of(error)}"


def _shown(parts: Path, variables: dict[str, Any]) -> str:
    return "".join(
        f"[{variables.get(part, '')}]" if isinstance(part, Index) else part for part in parts
    )


def _glue(misfit: UnfitValue) -> str:
    """An index follows its array at once."""
    return "" if str(misfit).startswith("[") else ": "
