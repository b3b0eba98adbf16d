"""Reading a configuration: every mistake at once, or the robot."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

from attrs import evolve, frozen

from uoarm._arguments import arguments
from uoarm._spelling import Speller
from uoarm._yaml import Document, Place, Problem, read, read_file
from uoarm.bridge import BridgeType
from uoarm.config._build import build
from uoarm.config._meaning import MeaningChecker
from uoarm.config._plugins import PluginChecker
from uoarm.config._shape import ShapeChecker
from uoarm.errors import ConfigurationError
from uoarm.model import Robot

__all__ = ["Report", "inspect", "load", "loads"]

Types: TypeAlias = Mapping[str, BridgeType]

_SHOWN = 50
_NOT_THERE = os.strerror(errno.ENOENT)
_ABSENT = "`uoarm suggest > robot.yaml` writes one of what bridges see; FILE names another"
_START = Place(1, 1)
_NO_TYPES: Types = MappingProxyType({})


@frozen
class Report:
    """What reading a configuration came to.

    Attributes:
        robot: the configuration, None when there are problems.
        problems: mistakes, in the order of the file.
        warnings: remarks that do not stop it from being used, in the order of the file.
        unchecked: what was not looked at, as a person would ask it.
    """

    robot: Robot | None
    problems: tuple[Problem, ...] = ()
    warnings: tuple[Problem, ...] = ()
    unchecked: tuple[str, ...] = ()

    def require(self) -> Robot:
        """Return the robot.

        Raises:
            ConfigurationError: there are problems; the text lists the first 50 and counts the rest.
        """
        if self.robot is not None:
            return self.robot
        lines = [str(problem) for problem in self.problems[:_SHOWN]]
        if len(self.problems) > _SHOWN:
            lines.append(f"... and {len(self.problems) - _SHOWN:,} more")
        raise ConfigurationError("\n".join(lines))


@arguments(path="uoarm.config.loads(text) reads a text")
def load(path: str | PathLike[str], types: Types = _NO_TYPES) -> Robot:
    """Read a configuration file.

    Args:
        path: the file.
        types: bridge types, to check options and endpoints with; see `Registry.types`.

    Raises:
        ConfigurationError: it cannot be read or has mistakes; the text lists all of them.
    """
    return inspect(path, types).require()


@arguments()
def loads(text: str, origin: str = "", types: Types = _NO_TYPES) -> Robot:
    """Read a configuration from text.

    Args:
        text: YAML 1.2.
        origin: the file that it stands for; its folder is where Python components are found.
        types: bridge types, to check options and endpoints with.

    Raises:
        ConfigurationError: it has mistakes; the text lists all of them.
    """
    return _report(read(text, origin), origin, types).require()


@arguments()
def inspect(
    path: str | PathLike[str],
    types: Types = _NO_TYPES,
    *,
    parameters: bool = False,
    missing: Callable[[str], str] | None = None,
) -> Report:
    """Read a configuration file and report on it without raising.

    Args:
        path: the file.
        types: bridge types, to check options and endpoints with.
        parameters: whether parameters are checked with the components, too. That imports Python
            components that run in this environment, each within ten seconds.
        missing: says of a plugin that `types` has not why, as `Registry.missing` does: then what
            the file names and is not here is among the warnings.
    """
    document = read_file(Path(path))
    problems = tuple(
        evolve(problem, hint=_ABSENT) if problem.sentence.endswith(_NOT_THERE) else problem
        for problem in document.problems
    )
    document = evolve(document, problems=problems)
    return _report(document, str(path), types, parameters=parameters, missing=missing)


def _report(
    document: Document,
    file: str,
    types: Types,
    *,
    parameters: bool = False,
    missing: Callable[[str], str] | None = None,
) -> Report:
    if not document.whole:
        return Report(None, _sorted(document.problems))
    if document.value is None and not document.problems:
        sentence, hint = "the file is empty", "begin with: version: 1"
        return Report(
            None, (Problem(place=_START, path="$", sentence=sentence, hint=hint, file=file),)
        )
    return _judge(document, file, types, parameters=parameters, missing=missing)


def _judge(
    document: Document,
    file: str,
    types: Types,
    *,
    parameters: bool,
    missing: Callable[[str], str] | None,
) -> Report:
    speller = Speller()
    shape = ShapeChecker(document, file, speller)
    meaning = MeaningChecker(document, file, speller)
    meaning.run()
    plugins = PluginChecker(document, file, speller, types)
    found = [*shape.problems(), *meaning.problems, *plugins.problems()]
    if parameters and not document.problems:
        found.extend(plugins.parameter_problems())
    for path, structure in meaning.structures():
        found.extend(shape.structure_problems(structure, path))
    reported = {problem.place for problem in document.problems}
    problems = [*document.problems, *(item for item in found if item.place not in reported)]
    absent = () if missing is None else plugins.absences(missing)
    warnings = _sorted([*meaning.warnings, *plugins.warnings(), *absent])
    unchecked = () if missing is None else tuple(plugins.unchecked())
    if problems:
        return Report(None, _sorted(problems), warnings, unchecked)
    assert isinstance(document.value, dict), "the shape was checked"
    remarks = tuple(str(warning) for warning in warnings)
    robot = evolve(build(document.value, file, remarks), text=document.text)
    return Report(robot, (), warnings, unchecked)


def _sorted(problems: tuple[Problem, ...] | list[Problem]) -> tuple[Problem, ...]:
    """Order problems by place; what several parts of a metaschema say alike is said once."""
    return tuple(
        sorted(
            set(problems),
            key=lambda problem: (
                problem.place.line,
                problem.place.column,
                problem.path,
                problem.sentence,
            ),
        )
    )
