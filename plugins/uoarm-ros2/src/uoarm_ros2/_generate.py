"""The text of a function under construction, and the constants that it refers to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["Source"]


class Source:
    """One function, line by line; `argument` is what stands in its parentheses.

    Nothing of a message ever enters the text: names of fields come in as quoted literals or as
    attributes of generated classes, everything else as a constant.
    """

    def __init__(self, name: str, argument: str) -> None:
        self._name = name
        self._lines = [f"def {name}({argument}):"]
        self._constants: dict[str, object] = {}

    def line(self, text: str, depth: int = 1) -> None:
        """Add a line, indented by `depth` levels."""
        self._lines.append("    " * depth + text)

    def constant(self, value: object) -> str:
        """Return a name by which the function's text may refer to a value."""
        name = f"c{len(self._constants)}"
        self._constants[name] = value
        return name

    def function(self) -> Callable[[Any], Any]:
        """Compile the text."""
        names: dict[str, Any] = dict(self._constants)
        exec("\n".join(self._lines), names)  # noqa: S102 - our own text, see the class
        made: Callable[[Any], Any] = names[self._name]
        return made
