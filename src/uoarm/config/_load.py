"""Reading a configuration: every mistake at once, or the robot."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from attrs import frozen

from uoarm.config._build import build
from uoarm.config._meaning import Checker
from uoarm.config._problem import Place, Problem
from uoarm.config._shape import shape_problems
from uoarm.config._yaml import MAX_BYTES, Document, read
from uoarm.errors import ConfigurationError
from uoarm.model import Robot

__all__ = ["Report", "inspect", "load", "loads"]

_SHOWN = 50
_START = Place(1, 1)


@frozen
class Report:
    """What reading a configuration came to.

    Attributes:
        robot: the configuration, None when there are problems.
        problems: mistakes, in the order of the file.
        warnings: remarks that do not stop it from being used.
    """

    robot: Robot | None
    problems: tuple[Problem, ...] = ()
    warnings: tuple[Problem, ...] = ()

    def require(self) -> Robot:
        """Return the robot.

        Raises:
            ConfigurationError: there are problems; the text lists them.
        """
        if self.robot is not None:
            return self.robot
        lines = [str(problem) for problem in self.problems[:_SHOWN]]
        if len(self.problems) > _SHOWN:
            lines.append(f"... and {len(self.problems) - _SHOWN} more")
        raise ConfigurationError("\n".join(lines))


def load(path: str | PathLike[str]) -> Robot:
    """Read a configuration file.

    Raises:
        ConfigurationError: it cannot be read or has mistakes; the text lists all of them.
    """
    return inspect(path).require()


def loads(text: str, origin: str = "") -> Robot:
    """Read a configuration from text.

    Args:
        text: YAML 1.2.
        origin: the file that it stands for; its folder is where Python components are found.

    Raises:
        ConfigurationError: it has mistakes; the text lists all of them.
    """
    return _inspect(text, origin).require()


def inspect(path: str | PathLike[str]) -> Report:
    """Read a configuration file and report on it without raising."""
    file = str(path)
    try:
        size = Path(path).stat().st_size
        if size > MAX_BYTES:
            return _unreadable(file, f"the file has {size:,} bytes; {MAX_BYTES:,} are allowed")
        text = Path(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        return _unreadable(file, f"the file cannot be read: {error.strerror or error}")
    except UnicodeDecodeError as error:
        return _unreadable(file, f"the file is not UTF-8: byte {error.start} is wrong")
    return _inspect(text, file)


def _inspect(text: str, file: str) -> Report:
    document = read(text)
    if isinstance(document, Problem):
        return _unreadable(file, document.sentence, document.place, document.hint)
    if document.value is None:
        return _unreadable(file, "the file is empty")
    problems = sorted(shape_problems(document, file), key=lambda one: (one.place, one.path))
    if problems:
        return Report(None, tuple(problems))
    return _judge(document, file)


def _judge(document: Document, file: str) -> Report:
    checker = Checker(document, file)
    checker.run()
    problems = tuple(sorted(checker.problems, key=lambda one: (one.place, one.path)))
    warnings = tuple(sorted(checker.warnings, key=lambda one: (one.place, one.path)))
    if problems:
        return Report(None, problems, warnings)
    assert isinstance(document.value, dict), "the shape was checked"
    robot = build(document.value, file, tuple(str(warning) for warning in warnings))
    return Report(robot, (), warnings)


def _unreadable(file: str, sentence: str, place: Place = _START, hint: str = "") -> Report:
    return Report(None, (Problem(place=place, path="$", sentence=sentence, hint=hint, file=file),))
