"""What each error code means: its cause, an example and what to do.

Every error that uoarm raises on purpose has a code (`UoarmError.error_code`), and so have the
mistakes of a configuration, the reasons of a refused plan and the events that report a failure. A
code keeps its meaning from one version to the next; texts may change. `uoarm explain CODE` prints
an entry of the table in `error_codes.json`, and `docs/errors.md` is made of it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from attrs import frozen

from uoarm.errors import UsageError

__all__ = ["ERROR_CODES", "ErrorExplanation", "explain", "markdown"]


@frozen
class ErrorExplanation:
    """One kind of failure.

    Attributes:
        code: such as `UOA-201`; its first digit is the group.
        title: what happened, in a few words.
        cause: why it happens.
        example: a text that it comes with.
        remedy: what to do.
    """

    code: str
    title: str
    cause: str
    example: str
    remedy: str

    def __str__(self) -> str:
        return (
            f"{self.code}  {self.title}\n\n"
            f"Cause:    {self.cause}\nExample:  {self.example}\nRemedy:   {self.remedy}"
        )


_FILE: Any = json.loads(files("uoarm").joinpath("error_codes.json").read_text(encoding="utf-8"))
_TABLE = tuple(ErrorExplanation(**entry) for entry in _FILE["codes"])

ERROR_CODES: Mapping[str, ErrorExplanation] = MappingProxyType(
    {entry.code: entry for entry in _TABLE}
)
"""Every code with its meaning, in order."""


def explain(code: str) -> ErrorExplanation:
    """Return what a code means.

    Args:
        code: such as `UOA-201`; `uoa-201` and `201` are taken too.

    Raises:
        UsageError: there is no such code.
    """
    written = code.strip().upper()
    entry = ERROR_CODES.get(written) or ERROR_CODES.get(f"UOA-{written.removeprefix('UOA')}")
    if entry is None:
        known = f"{_TABLE[0].code} to {_TABLE[-1].code}"
        raise UsageError(f"there is no error code {code!r}; the codes are {known}: uoarm explain")
    return entry


def markdown() -> str:
    """Return `docs/errors.md`: every code with an anchor of its own."""
    return "\n".join(_page()) + "\n"


def _page() -> Iterator[str]:
    yield "# Error codes"
    yield ""
    yield "Every refusal, failure and mistake has a code that keeps its meaning. It is the last"
    yield "line of a command's error, and `error_code` of exceptions, events and JSON. Each has"
    yield "the cause, an example and what to do, as `uoarm explain CODE` prints it."
    yield "[Troubleshooting](troubleshooting.md) begins with symptoms."
    group = ""
    for entry in _TABLE:
        if entry.code[4] != group:
            group = entry.code[4]
            yield ""
            yield f"## {group}xx: {_FILE['groups'][group]}"
        yield ""
        yield f"### {entry.code}"
        yield ""
        yield f"{entry.title[0].upper()}{entry.title[1:]}. {entry.cause}"
        yield ""
        yield f"`{entry.example}`"
        yield ""
        yield entry.remedy
