"""Reading a configuration: every mistake at once, or the robot."""

from __future__ import annotations

import stat
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

from attrs import frozen

from uoarm.bridge import BridgeType
from uoarm.config._build import build
from uoarm.config._document import Document
from uoarm.config._meaning import MeaningChecker
from uoarm.config._plugins import PluginChecker
from uoarm.config._problem import Place, Problem
from uoarm.config._shape import ShapeChecker
from uoarm.config._spelling import Speller
from uoarm.config._yaml import MAX_BYTES, read
from uoarm.errors import ConfigurationError
from uoarm.model import Robot

__all__ = ["Report", "inspect", "load", "loads"]

Types: TypeAlias = Mapping[str, BridgeType]

_SHOWN = 50
_START = Place(1, 1)
_NO_TYPES: Types = MappingProxyType({})


@frozen
class Report:
    """What reading a configuration came to.

    Attributes:
        robot: the configuration, None when there are problems.
        problems: mistakes, in the order of the file.
        warnings: remarks that do not stop it from being used, in the order of the file.
    """

    robot: Robot | None
    problems: tuple[Problem, ...] = ()
    warnings: tuple[Problem, ...] = ()

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


def load(path: str | PathLike[str], types: Types = _NO_TYPES) -> Robot:
    """Read a configuration file.

    Args:
        path: the file.
        types: bridge types, to check options and endpoints with; see `Registry.types`.

    Raises:
        ConfigurationError: it cannot be read or has mistakes; the text lists all of them.
    """
    return inspect(path, types).require()


def loads(text: str, origin: str = "", types: Types = _NO_TYPES) -> Robot:
    """Read a configuration from text.

    Args:
        text: YAML 1.2.
        origin: the file that it stands for; its folder is where Python components are found.
        types: bridge types, to check options and endpoints with.

    Raises:
        ConfigurationError: it has mistakes; the text lists all of them.
    """
    return _inspect(text, origin, types).require()


def inspect(path: str | PathLike[str], types: Types = _NO_TYPES) -> Report:
    """Read a configuration file and report on it without raising."""
    file = str(path)
    try:
        raw = _read_bounded(Path(path))
        return _inspect(raw.decode("utf-8"), file, types)
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        sentence = f"the file is not UTF-8: byte {error.start + 1:,} cannot be decoded"
        return _unreadable(file, sentence, Place(line, 1), "save it as UTF-8")
    except OSError as error:
        return _unreadable(file, f"the file cannot be read: {error.strerror or error}")
    except ValueError as error:
        return _unreadable(file, f"the file cannot be read: {error}")


def _read_bounded(path: Path) -> bytes:
    """Read a regular file; a pipe or device could go on for ever.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no regular file, too large, or the path cannot be one.
    """
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise ValueError("it is a folder")
    if not stat.S_ISREG(mode):
        raise ValueError("it is not a regular file")
    with path.open("rb") as stream:
        raw = stream.read(MAX_BYTES + 1)
    if len(raw) > MAX_BYTES:
        raise ValueError(f"it has more than {MAX_BYTES:,} bytes")
    return raw


def _inspect(text: str, file: str, types: Types) -> Report:
    document = read(text, file)
    if not document.whole:
        return Report(None, _sorted(document.problems))
    if document.value is None and not document.problems:
        return _unreadable(file, "the file is empty", hint="begin with: version: 1")
    return _judge(document, file, types)


def _judge(document: Document, file: str, types: Types) -> Report:
    speller = Speller()
    shape = ShapeChecker(document, file, speller)
    meaning = MeaningChecker(document, file, speller)
    meaning.run()
    plugins = PluginChecker(document, file, speller, types)
    found = [*shape.problems(), *meaning.problems, *plugins.problems()]
    for path, structure in meaning.structures():
        found.extend(shape.structure_problems(structure, path))
    told = {problem.place for problem in document.problems}
    problems = [*document.problems, *(one for one in found if one.place not in told)]
    warnings = _sorted([*meaning.warnings, *plugins.warnings()])
    if problems:
        return Report(None, _sorted(problems), warnings)
    assert isinstance(document.value, dict), "the shape was checked"
    remarks = tuple(str(warning) for warning in warnings)
    return Report(build(document.value, file, remarks), (), warnings)


def _sorted(problems: tuple[Problem, ...] | list[Problem]) -> tuple[Problem, ...]:
    """Order problems by place; what several parts of a metaschema say alike is said once."""
    return tuple(sorted(set(problems), key=lambda one: (one.place, one.path, one.sentence)))


def _unreadable(file: str, sentence: str, place: Place = _START, hint: str = "") -> Report:
    return Report(None, (Problem(place=place, path="$", sentence=sentence, hint=hint, file=file),))
