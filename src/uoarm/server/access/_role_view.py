"""What a role sees of a robot: its functions, and no name of anything else, in any text or value.

A text of the manager may name whatever had a part in what it reports: the component that feeds
another one, a candidate that was passed over, a name that is nearly the one asked for. Who writes
such a text does not know who will read it. So what goes to a client passes here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any

from attrs import field, frozen

from uoarm.model import Robot, StatusEvent
from uoarm.server.access._role import AccessRole, Operation

_HIDDEN = "…"
_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_SUGGESTION = re.compile(rf"[;,]? ?did you mean [\"']{_HIDDEN}[\"'/.]*\?")
_MOST_KEPT = 32
_MOST_FORMER = 10_000


@frozen
class RobotNames:
    """What a robot has that has a name.

    Attributes:
        functions: of functions.
        components: the function of each component.
        bridges: the functions that have a component in each bridge.
    """

    functions: frozenset[str] = frozenset()
    components: Mapping[str, str] = field(factory=dict)
    bridges: Mapping[str, Iterable[str]] = field(factory=dict)


class RoleView:
    """The robot as one role sees it. Immutable, for any thread.

    Args:
        role: whose view it is.
        names: of the robot, and of what it had until a moment ago.
    """

    def __init__(self, role: AccessRole, names: RobotNames) -> None:
        self.role = role
        self.sees_all = role.allows_all(Operation.SEE)
        self._names = names

    def has_function(self, name: str) -> bool:
        """Say whether it sees a function of this name."""
        return self.role.allows(Operation.SEE, name)

    def has_component(self, name: str) -> bool:
        """Say whether it sees a component; one that the robot does not have is not seen."""
        return self.sees_all or self.has_function(self._names.components.get(name, ""))

    def has_bridge(self, name: str) -> bool:
        """Say whether a function that it sees has a component there, open or not."""
        return self.sees_all or name in self._visible_bridges

    def has_event(self, event: StatusEvent) -> bool:
        """Say whether a change is of something that it sees."""
        kind, _, name = event.subject.partition(" ")
        return self.has_function(event.function) or (kind == "bridge" and self.has_bridge(name))

    def text(self, text: str, asked: str = "") -> str:
        """Return a text with a sign in the place of each name that it does not see.

        Args:
            text: what is to be read by a client of the role.
            asked: what the client itself wrote; names in it stay, whether or not they are there.
        """
        if self.sees_all:
            return text
        for name in self._unusual:
            if name not in asked and name in text and self._hides(name):
                text = text.replace(name, _HIDDEN)
        own = set(_WORD.findall(asked))

        def shown(found: re.Match[str]) -> str:
            word = found[0]
            return _HIDDEN if word not in own and self._hides(word) else word

        return _SUGGESTION.sub("", _WORD.sub(shown, text))

    def data(self, value: Any, asked: str = "") -> Any:
        """Return JSON-ready data with every text in it as `text` has it."""
        if self.sees_all:
            return value
        if isinstance(value, str):
            return self.text(value, asked)
        if isinstance(value, Mapping):
            return {key: self.data(part, asked) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [self.data(part, asked) for part in value]
        return value

    @cached_property
    def _visible_bridges(self) -> frozenset[str]:
        return frozenset(
            bridge
            for bridge, functions in self._names.bridges.items()
            if any(map(self.has_function, functions))
        )

    @cached_property
    def _unusual(self) -> tuple[str, ...]:
        """Names that are no single word, as discovered components may have them, longest first."""
        unusual = (name for name in self._names.components if not _WORD.fullmatch(name))
        return tuple(sorted(unusual, key=len, reverse=True))

    def _hides(self, name: str) -> bool:
        """Say whether a name is of something, and of nothing that it sees."""
        names = self._names
        is_function, is_component = name in names.functions, name in names.components
        is_bridge = name in names.bridges
        if not (is_function or is_component or is_bridge):
            return False
        return not (
            (is_function and self.has_function(name))
            or (is_component and self.has_component(name))
            or (is_bridge and self.has_bridge(name))
        )


class RoleViews:
    """The views of all roles of a server, made once for each revision; for any thread.

    Args:
        robot: returns the configuration in force.
    """

    def __init__(self, robot: Callable[[], Robot]) -> None:
        self._robot = robot
        # One value, so that threads see either all of a revision or nothing of it.
        self._known: tuple[Robot | None, RobotNames] = None, RobotNames()
        self._views: dict[AccessRole, tuple[Robot, RoleView]] = {}

    def of(self, role: AccessRole) -> RoleView:
        """Return the view of a role on the configuration in force."""
        robot = self._robot()
        known = self._views.get(role)
        if known is not None and known[0] is robot:
            return known[1]
        if self._known[0] is not robot:
            self._known = robot, _names(robot, self._known[1])
        if len(self._views) >= _MOST_KEPT:
            self._views.clear()
        view = RoleView(role, self._known[1])
        self._views[role] = robot, view
        return view


def _names(robot: Robot, former: RobotNames) -> RobotNames:
    """Return the names of a robot, with those of before: texts may name what was there."""
    if len(former.components) > _MOST_FORMER:
        former = RobotNames()
    bridges: dict[str, set[str]] = {name: set() for name in robot.bridges}
    components = dict(former.components)
    for component in robot.components():
        bridges.setdefault(component.bridge, set()).add(component.function)
        components[component.name] = component.function
    functions = former.functions.union(robot.functions)
    return RobotNames(functions, components, {**former.bridges, **bridges})
