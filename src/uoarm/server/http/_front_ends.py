"""Which front ends are installed, which of them are broken, and why."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points

from uoarm._origin import install_command
from uoarm._plugins import PluginProblem, values_of
from uoarm._raised import text_of
from uoarm.server.front_end import CONTRACT_VERSION, FrontEnd, FrontEndHooks

__all__ = ["FrontEnds"]

_GROUP = "uoarm.front_ends"
_KNOWN = {"rosbridge": "uoarm-rosbridge"}


class FrontEnds:
    """Front ends that can be served, by name.

    One that fails to load is listed in `problems` and hurts nobody else.

    Args:
        reserved: paths that the server has itself.
        given: instead of the installed ones.
        points: entry points to read instead of the installed ones.
    """

    def __init__(
        self,
        reserved: Iterable[str] = (),
        given: Iterable[FrontEnd] | None = None,
        points: Iterable[EntryPoint] | None = None,
    ) -> None:
        self._reserved = frozenset(reserved)
        self._by_name: dict[str, FrontEnd] = {}
        self._problems: list[PluginProblem] = []
        if given is not None:
            for front_end in given:
                self._admit(front_end.name, front_end)
            return
        found = entry_points(group=_GROUP) if points is None else points
        for point in sorted(found, key=lambda point: point.name):
            try:
                answer = values_of(point, FrontEndHooks, "uoarm_front_ends", FrontEnd)
            except Exception as error:  # noqa: BLE001 - a broken plugin may raise anything
                self.drop(point.name, text_of(error))
                continue
            for front_end in answer:
                self._admit(point.name, front_end)

    @property
    def usable(self) -> tuple[FrontEnd, ...]:
        """Those that can be served."""
        return tuple(self._by_name.values())

    @property
    def problems(self) -> tuple[PluginProblem, ...]:
        """Those that cannot, each with its cause."""
        return tuple(self._problems)

    def at(self, path: str) -> FrontEnd | None:
        """Return the front end whose endpoint a path is."""
        return next(
            (front_end for front_end in self._by_name.values() if front_end.path == path), None
        )

    def find(self, name: str) -> FrontEnd | None:
        """Return the front end of a name that can be served."""
        return self._by_name.get(name)

    def drop(self, name: str, cause: str) -> None:
        """Serve one no more, for a cause."""
        self._by_name.pop(name, None)
        self._problems.append(PluginProblem(name, cause))

    def missing(self, name: str) -> str:
        """Say why there is no front end of this name, and what to do."""
        for problem in self._problems:
            if problem.name == name:
                return f"the front end {name!r} cannot be used: {problem.cause}"
        if name in _KNOWN:
            return f"the front end {name!r} is not installed: {install_command(_KNOWN[name])}"
        there = ", ".join(self._by_name) or "none"
        return f"there is no front end {name!r} (installed: {there})"

    def _admit(self, plugin: str, one: FrontEnd) -> None:
        same = [other for other in self.usable if one.name == other.name or one.path == other.path]
        if one.contract != CONTRACT_VERSION:
            self._problems.append(
                PluginProblem(
                    plugin,
                    f"front end {one.name!r} implements contract version {one.contract}, "
                    f"this uoarm has version {CONTRACT_VERSION}: install matching versions",
                )
            )
        elif one.path in self._reserved:
            cause = f"front end {one.name!r} wants {one.path}, which is the server's own"
            self._problems.append(PluginProblem(plugin, cause))
        elif same:
            cause = f"front end {one.name!r} at {one.path} is already there: {same[0].summary}"
            self._problems.append(PluginProblem(plugin, cause))
        else:
            self._by_name[one.name] = one
