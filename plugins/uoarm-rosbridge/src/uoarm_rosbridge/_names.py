"""Names of topics and services, and the functions that stand behind them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from attrs import frozen

from uoarm import RobotManager
from uoarm.errors import ControlMessageError
from uoarm.model import Function, Input, Output, Robot, Role, Service
from uoarm.server.front_end import Client, Operation

PREFIX = "/uoarm/"


@frozen
class NamedPort:
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


def find_place(given: str) -> NamedPort:
    """Return what a topic or service name stands for; a missing leading slash is added.

    Raises:
        ControlMessageError: it is no name.
    """
    name = given if given.startswith("/") else f"/{given}"
    if name == "/" or name.endswith("/") or any(text.isspace() for text in name):
        raise ControlMessageError(f"{given!r:.100} is no name of a topic or service")
    if not name.startswith(PREFIX):
        return NamedPort(name)
    function, _, port = name.removeprefix(PREFIX).partition("/")
    return NamedPort(name, function, port)


def topic_of(function: str, port: str = "") -> str:
    """Return the name of a function's topic or service."""
    return f"{PREFIX}{function}/{port}" if port else f"{PREFIX}{function}"


class Addresses:
    """What functions are called here whose ports have an address; in the loop's thread.

    Args:
        manager: of the robot, whose configuration may change.
    """

    def __init__(self, manager: RobotManager) -> None:
        self._manager = manager
        self._robot: Robot | None = None
        self._known: dict[tuple[Role, str], tuple[str, str]] = {}

    def hint(self, name: str, role: Role, client: Client) -> str:
        """Say where a client finds what it asks for by its address; empty: no function is there.

        Args:
            name: a topic or service.
            role: of the port that the client means.
            client: it is shown what it may see.
        """
        robot = self._manager.config
        if robot is not self._robot:
            self._robot = robot
            every = (place for function in robot.functions.values() for place in _places(function))
            self._known = dict(reversed(tuple(every)))  # of several the first, as for a request
        function, topic = self._known.get((role, name), ("", ""))
        if not function or not client.role.allows(Operation.SEE, function):
            return ""
        return f"{name} is between clients here; that of the robot is {topic}"


def _places(function: Function) -> Iterator[tuple[tuple[Role, str], tuple[str, str]]]:
    """Yield each part of an address that could be a name here, with the function and its topic."""
    for component in function.components:
        open_inputs = [port for port in component.inputs if port.source is None]
        ports: list[tuple[Role, Sequence[Input | Output | Service]]] = [
            (Role.OUTPUT, component.outputs),
            (Role.INPUT, open_inputs),
            (Role.SERVICE, () if component.service is None else (component.service,)),
        ]
        for role, several in ports:
            for port in several:
                name = port.endpoint.port if len(several) > 1 else ""
                for part in port.endpoint.address:
                    if part.startswith("/"):
                        yield (role, part), (function.name, topic_of(function.name, name))
