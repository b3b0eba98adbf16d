"""The text of a function under construction, with its alignment and the constants it uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["WIDEST", "GeneratedFunction"]

WIDEST = 8
"""Greatest alignment of CDR."""


class GeneratedFunction:
    """One function, line by line, that walks a CDR buffer.

    Nothing of a message ever enters the text: names of fields come in as quoted literals,
    everything else as a constant.

    While the text is written, `modulus` and `rest` say what is known of the position at that
    place: it is `rest` more than a multiple of `modulus`.
    """

    def __init__(self, head: str) -> None:
        self._lines = [head]
        self._constants: dict[str, object] = {}
        self._names = 0
        self.depth = 1
        self.modulus = WIDEST
        self.rest = 0

    def line(self, text: str) -> None:
        """Add a line at the present depth."""
        self._lines.append("    " * self.depth + text)

    def cut(self, head: str) -> str | None:
        """Take the last line back where it begins so, outside every block; return its rest."""
        begin = "    " + head
        return self._lines.pop()[len(begin) :] if self._lines[-1].startswith(begin) else None

    def name(self) -> str:
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
        """Return the padding before an item of this alignment; None: only known when running."""
        return None if size > self.modulus else -self.rest % size

    def advance(self, count: int) -> None:
        """Move the position by a known number of bytes."""
        self.rest = (self.rest + count) % self.modulus

    def function(self, name: str) -> Callable[..., Any]:
        """Compile the text."""
        names: dict[str, Any] = dict(self._constants)
        exec("\n".join(self._lines), names)  # noqa: S102 - our own text, see the class
        made: Callable[..., Any] = names[name]
        return made
