"""Reading a configuration: every mistake at once, or the robot."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Container, Mapping
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

from attrs import evolve, frozen

from uoarm._arguments import arguments
from uoarm._spelling import Speller
from uoarm._support.files import end_of_lines
from uoarm._support.yaml import (
    Document,
    Position,
    Problem,
    mistakes_error,
    read,
    read_file,
)
from uoarm.bridge import BridgeType
from uoarm.config._build import build
from uoarm.config._meaning import MeaningChecker
from uoarm.config._plugins import PluginChecker
from uoarm.config._shape import ShapeChecker
from uoarm.errors import ConfigurationError
from uoarm.model import Robot

Types: TypeAlias = Mapping[str, BridgeType]

_NOT_THERE = os.strerror(errno.ENOENT)
_ABSENT = "`uoarm suggest > robot.yaml` writes one of what bridges see; FILE names another"
_START = Position(1, 1)
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
        raise mistakes_error(self.problems)


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
            None,
            (
                Problem(
                    place=_START,
                    path="$",
                    sentence=sentence,
                    hint=hint,
                    file=file,
                    error_code="UOA-102",
                ),
            ),
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
    plugins = PluginChecker(document, file, speller, types, shape)
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


def merge(text: str, suggestion: str) -> str:
    """Return a configuration with the bridges and functions of another that it does not have.

    They are added after its own, with their comments; everything that stands in the text stays as
    it is, comments, order and spelling included.

    Args:
        text: the configuration, as YAML without mistakes; one that is blank becomes the other.
        suggestion: the other one, as `suggest` writes it.

    Raises:
        ConfigurationError: one has mistakes, or `bridges` or `functions` are written in braces
            and not empty, so that lines cannot be added.
    """
    if is_blank(text):
        loads(suggestion)
        return f"{text.rstrip()}\n{suggestion}".lstrip("\n")
    before = loads(text)
    had = {"bridges": before.bridges, "functions": before.functions}
    for section, known in had.items():
        added = _entries(suggestion, section, known)
        if added:
            text = _with_lines(text, section, added)
    merged = loads(text)
    kept = (merged.bridges.get(name) == bridge for name, bridge in before.bridges.items())
    kept_too = (
        merged.functions.get(name) == function for name, function in before.functions.items()
    )
    if not all(kept) or not all(kept_too):
        raise ConfigurationError("the lines cannot be added by themselves: paste them by hand")
    return text


def is_blank(text: str) -> bool:
    """Say whether a configuration has nothing yet but comments."""
    lines = text.removeprefix("\ufeff").splitlines()
    return all(line.partition("#")[0].strip() in {"", "---"} for line in lines)


def _entries(suggestion: str, section: str, known: Container[str]) -> list[str]:
    """Return the lines of a section whose entries a configuration does not have, from column 1."""
    document = read(suggestion, "")
    found = document.value.get(section) if isinstance(document.value, dict) else None
    if not isinstance(found, dict) or not found:
        return []
    lines = suggestion.splitlines()
    _, end = _lines_of(suggestion, document, section)
    starts = [document.key_place((section, name)).line - 1 for name in found]
    column = document.key_place((section, next(iter(found)))).column - 1
    return [
        line[column:] if line[:column].isspace() else line
        for name, first, last in zip(found, starts, [*starts[1:], end], strict=True)
        if name not in known
        for line in lines[first:last]
    ]


def _with_lines(text: str, section: str, added: list[str]) -> str:
    """Return a text with lines after the last one of a section."""
    document, lines = read(text, ""), text.splitlines(keepends=True)
    line_end = end_of_lines(text)
    assert isinstance(document.value, dict), "it was read before"
    start, end = _lines_of(text, document, section)
    own = document.value[section]
    column = 2
    if own:
        place = document.key_place((section, next(iter(own))))
        if place.line - 1 == start:
            raise ConfigurationError(
                f"`{section}` is written in braces: write it in lines, so that more can be added"
            )
        column = place.column - 1
    else:
        head, _, rest = lines[start].partition("{}")
        lines[start] = f"{head.rstrip()}{rest}".rstrip() + line_end
    if not lines[end - 1].endswith(line_end[-1]):  # the last one of the text may have no end
        lines[end - 1] += line_end
    more = [f"{' ' * column}{line}{line_end}" if line else line_end for line in added]
    return "".join([*lines[:end], *more, *lines[end:]])


def _lines_of(text: str, document: Document, section: str) -> tuple[int, int]:
    """Return the number of a section's first line, and of the one after its last; from 0."""
    assert isinstance(document.value, dict), "it was read before"
    lines = text.splitlines()
    start = document.key_place((section,)).line - 1
    firsts = (document.key_place((name,)).line - 1 for name in document.value)
    end = min((number for number in firsts if number > start), default=len(lines))
    while end - 1 > start and (not lines[end - 1].strip() or lines[end - 1].startswith("#")):
        end -= 1
    return start, end
