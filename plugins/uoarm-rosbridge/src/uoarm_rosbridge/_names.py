"""Names of topics and services, and the functions that stand behind them."""

from __future__ import annotations

from attrs import frozen

from uoarm.errors import ControlMessageError

__all__ = ["PREFIX", "Place", "find_place", "topic_of"]

PREFIX = "/uoarm/"


@frozen
class Place:
    """What a name stands for.

    Attributes:
        name: with a leading slash, as clients see it.
        function: the function; empty for a topic or service between clients.
        port: output, input or nothing, after the function's name.
    """

    name: str
    function: str = ""
    port: str = ""

    @property
    def wanted(self) -> str:
        """The function, or function.output, as the manager names it."""
        return f"{self.function}.{self.port}" if self.port else self.function

    @property
    def right(self) -> str:
        """The name that a role's patterns are held against."""
        return self.function or self.name


def find_place(given: str) -> Place:
    """Return what a topic or service name stands for; a missing leading slash is added.

    Raises:
        ControlMessageError: it is no name.
    """
    name = given if given.startswith("/") else f"/{given}"
    if name == "/" or name.endswith("/") or any(text.isspace() for text in name):
        raise ControlMessageError(f"{given!r:.100} is no name of a topic or service")
    if not name.startswith(PREFIX):
        return Place(name)
    function, _, port = name.removeprefix(PREFIX).partition("/")
    return Place(name, function, port)


def topic_of(function: str, port: str = "") -> str:
    """Return the name of a function's topic or service."""
    return f"{PREFIX}{function}/{port}" if port else f"{PREFIX}{function}"
