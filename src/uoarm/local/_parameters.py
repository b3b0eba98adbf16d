"""Parameters of components: what was written for them, against their signature and its hints."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Mapping
from typing import Any

from uoarm._hints.arrays import HintError
from uoarm._hints.convert import reader
from uoarm._hints.schemas import schema_of
from uoarm._mistakes import schema_mistakes
from uoarm._spelling import Speller
from uoarm.model import Options

__all__ = ["build_parameters", "parameter_mistakes"]


def parameter_mistakes(
    accepted: Mapping[str, inspect.Parameter],
    hints: Mapping[str, Any],
    message: str | None,
    given: Options,
) -> dict[str, str]:
    """Return what is wrong with parameters, by name; nothing where they fit.

    Args:
        accepted: the parameters of a function or class, without the one that takes messages.
        hints: their type hints; what has none, or one without a structure, takes everything.
        message: the name of the parameter that takes messages, where a function has one.
        given: the values in the configuration.
    """
    found: dict[str, str] = {}
    takes_all = any(parameter.kind is parameter.VAR_KEYWORD for parameter in accepted.values())
    named = {parameter.name for parameter in accepted.values() if parameter.kind in _NAMED}
    for name, value in given.items():
        if name in named:
            wrong = _misfit(value, hints.get(name, inspect.Parameter.empty))
            if wrong:
                found[name] = wrong
        elif not takes_all:
            close = difflib.get_close_matches(name, named, n=1)
            known = f"there are {', '.join(sorted(named))}" if named else "it takes none"
            hint = f"did you mean {close[0]!r}?" if close else known
            found[name] = f"there is no such parameter: {hint}"
    for name in sorted(named - given.keys()):
        if accepted[name].default is inspect.Parameter.empty:
            whole = f"; each message comes whole, in {message!r}" if message else ""
            found[name] = f"it has no value: give it one under `parameters`{whole}"
    return found


def build_parameters(hints: Mapping[str, Any], given: Options, place: str) -> dict[str, Any]:
    """Return the parameters as the values that their hints say.

    Raises:
        MessageError: a value does not fit its hint.
    """
    built: dict[str, Any] = {}
    for name, value in given.items():
        read = reader(hints.get(name, Any), f"the parameter {name!r} of {place}")
        built[name] = value if read is None else read(value)
    return built


_NAMED = {inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY}


def _misfit(value: object, hint: Any) -> str:
    """Return what is wrong with a value, "" where it fits or the hint says nothing."""
    try:
        schema = schema_of(hint)
    except HintError:
        return ""
    reports = [
        f"{'.'.join(map(str, path))}: {sentence}" if path else sentence
        for path, sentence, _, _ in schema_mistakes(value, schema, Speller())
    ]
    return "; ".join(reports)
