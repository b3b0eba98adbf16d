"""Writing a configuration over another, in its file: only the lines of what is different change."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path as FilePath
from typing import Any

from attrs import evolve, frozen

from uoarm import config
from uoarm._raised import reason_of
from uoarm._support import yaml
from uoarm._support.files import UnreadableFileError, end_of_lines, read_text, written_beside
from uoarm._support.yaml import Document, Path
from uoarm.errors import ConfigurationError, UsageError
from uoarm.model import Robot

_MOST_OCTETS = 10_000_000
_COMMENT = re.compile(r"(?:^|\s)(#.*)$")


@frozen
class _Entry:
    """The lines of one key with its value, or of one item of a list; from 0, the end excluded.

    Comments and empty lines after the last line of the value are not of the entry.
    """

    path: Path
    first: int
    end: int
    column: int


@frozen
class _Edit:
    """Lines that take the place of others; where `first` is `end`, they are inserted there."""

    first: int
    end: int
    lines: tuple[str, ...]


class _Text:
    """A configuration's text, and where in it everything stands."""

    def __init__(self, text: str) -> None:
        self.lines = text.splitlines()
        self.document: Document = yaml.read(text)
        whole = _Entry((), 0, len(self.lines), 0)
        self.root = evolve(whole, end=self._without_tail(0, len(self.lines)))

    def value(self, path: Path) -> Any:
        found: Any = self.document.value
        for part in path:
            found = found[part]
        return found

    def entries(self, entry: _Entry) -> list[_Entry]:
        """Return what a mapping or a list holds, where each stands in lines of its own."""
        value = self.value(entry.path)
        parts = value if isinstance(value, dict) else range(len(value))
        starts = [self._start((*entry.path, part)) for part in parts]
        lines = [line for line, _ in starts]
        is_inside = not entry.path or isinstance(entry.path[-1], int)  # `- name: x` begins there
        if not lines or (lines[0] <= entry.first and not (is_inside and lines[0] == entry.first)):
            return []
        if lines != sorted(set(lines)) or not all(self._begins(*start) for start in starts):
            return []
        nexts = [*lines[1:], entry.end]
        ends = [self._without_tail(*both) for both in zip(lines, nexts, strict=True)]
        return [
            _Entry((*entry.path, part), line, end, column)
            for part, (line, column), end in zip(parts, starts, ends, strict=True)
        ]

    def moved(self, entry: _Entry, column: int) -> tuple[str, ...]:
        """Return the lines of an entry, as they are where it begins in another column."""
        lines = self.lines[entry.first : entry.end]
        head = f"{' ' * column}{lines[0][entry.column :]}"
        shift = column - entry.column
        rest = (
            f"{' ' * (len(line) - len(line.lstrip(' ')) + shift)}{line.lstrip(' ')}"
            if line
            else line
            for line in lines[1:]
        )
        return head, *rest

    def _start(self, path: Path) -> tuple[int, int]:
        if not isinstance(path[-1], int):
            place = self.document.key_place(path)
            return place.line - 1, place.column - 1
        place = self.document.place(path)
        line = self.lines[place.line - 1]
        return place.line - 1, line.find("-")

    def _begins(self, line: int, column: int) -> bool:
        """Say whether nothing but a dash of a list stands before an entry in its line."""
        return column >= 0 and not self.lines[line][:column].strip(" -")

    def _without_tail(self, first: int, end: int) -> int:
        while end - 1 > first and not self.lines[end - 1].partition("#")[0].strip():
            end -= 1
        return end


def rewrite(text: str, wanted: str) -> str:
    """Return a configuration's text with what another one has.

    What both have stays as it stands, its comments, order and spelling included; what is new is
    written as in the other one, after what was there. Where the other text was made from this one,
    which its lines and comments show, it is returned as it is.

    Args:
        text: the configuration so far, as YAML without mistakes.
        wanted: the other one, likewise.

    Raises:
        ConfigurationError: one has mistakes, or it cannot be done line by line.
    """
    robot = config.loads(wanted)
    if _is_made_from(wanted, text):
        return wanted
    if is_same(config.loads(text), robot):
        return text
    old, new = _Text(text), _Text(wanted)
    lines, line_end = text.splitlines(keepends=True), end_of_lines(text)
    lines[-1] = f"{old.lines[-1]}{line_end}"  # the last one may have no end
    edits = list(_edits(old, old.root, new, new.root))
    for edit in sorted(edits, key=lambda item: (item.first, item.end), reverse=True):
        lines[edit.first : edit.end] = [f"{line}{line_end}" for line in edit.lines]
    made = "".join(lines)
    try:
        is_made = is_same(config.loads(made), robot)
    except ConfigurationError:
        is_made = False
    if not is_made:
        raise ConfigurationError(
            "the change cannot be written line by line, such as where entries share a line or "
            "an anchor: write the file by hand and reload it"
        )
    return made


def is_same(first: Robot, second: Robot) -> bool:
    """Say whether two configurations are the same but for remarks, their file and their text."""
    bridges = {
        name: evolve(spec, folder=second.bridges[name].folder) if name in second.bridges else spec
        for name, spec in first.bridges.items()
    }
    return evolve(first, bridges=bridges, warnings=second.warnings, origin=second.origin) == second


def _is_made_from(text: str, other: str) -> bool:
    """Say whether a text has all comments of another, and half of its lines at least."""
    lines, others = set(text.splitlines()), set(other.splitlines())
    return 2 * len(lines & others) >= len(others) and _comments(others) <= _comments(lines)


def _comments(lines: Iterable[str]) -> set[str]:
    return {found[1].strip() for found in map(_COMMENT.search, lines) if found is not None}


def _edits(old: _Text, entry: _Entry, new: _Text, other: _Entry) -> Iterator[_Edit]:
    """Yield what makes one mapping or list the other; both stand in lines of their own."""
    mine = {_name(old, item): item for item in old.entries(entry)}
    theirs = {_name(new, item): item for item in new.entries(other)}
    last = None
    for name, value in mine.items():
        if name not in theirs:
            yield _Edit(value.first, value.end, ())
        elif _exact(old.value(value.path)) != _exact(new.value(theirs[name].path)):
            yield from _changed(old, value, new, theirs[name])
        last = value
    assert last is not None, "the caller looked"
    more = [line for name, value in theirs.items() if name not in mine
            for line in new.moved(value, last.column)]  # fmt: skip
    if more:
        yield _Edit(last.end, last.end, tuple(more))


def _exact(value: Any) -> str:
    """Return by what to compare: 1, 1.0 and true are equal to Python."""
    return json.dumps(value, sort_keys=True)


def _changed(old: _Text, entry: _Entry, new: _Text, other: _Entry) -> Iterator[_Edit]:
    value, wanted = old.value(entry.path), new.value(other.path)
    if type(value) is type(wanted) and isinstance(value, dict | list):
        mine, theirs = old.entries(entry), new.entries(other)
        if mine and theirs and _can_be_matched(old, mine, new, theirs):
            yield from _edits(old, entry, new, other)
            return
    lines = new.moved(other, entry.column)
    before = old.lines[entry.first : entry.end]
    kept = _COMMENT.search(before[0])
    if len(before) == len(lines) == 1 and kept is not None and not _COMMENT.search(lines[0]):
        lines = (f"{lines[0]}  {kept[1]}",)
    yield _Edit(entry.first, entry.end, lines)


def _can_be_matched(
    old: _Text, mine: Sequence[_Entry], new: _Text, theirs: Sequence[_Entry]
) -> bool:
    """Say whether items of lists have names of their own, and those of both the same order."""
    if not isinstance(mine[0].path[-1], int):
        return True
    names = [_name(old, entry) for entry in mine]
    others = [_name(new, entry) for entry in theirs]
    if not all(isinstance(name, str) for name in (*names, *others)):
        return False
    known, wanted = set(names), set(others)
    common = [name for name in names if name in wanted]
    shared = [item for item in others if item in known]
    return common == shared == others[: len(set(common))]


def _name(text: _Text, entry: _Entry) -> object:
    """Return the key of an entry, or the name that an item of a list has."""
    part = entry.path[-1]
    if not isinstance(part, int):
        return part
    value = text.value(entry.path)
    return value.get("name") if isinstance(value, dict) else None


class KeptFile:
    """A configuration file, and what stood in it when it was read or written last.

    Of two writers none undoes the other's change unseen: where another writer has written since,
    nothing is. For one thread at a time.
    """

    def __init__(self, robot: Robot) -> None:
        self._path = FilePath(robot.origin) if robot.origin else None
        self._text = robot.text

    def note(self, robot: Robot) -> None:
        """Note a configuration that was read from a file; another file than this one is nothing."""
        if self._path is not None and FilePath(robot.origin) == self._path:
            self._text = robot.text

    def prepare(self, wanted: str) -> str:
        """Return what would stand in the file with another configuration; writes nothing.

        Raises:
            UsageError: the configuration is of no file, or another writer has changed that.
            ConfigurationError: the change cannot be written line by line.
        """
        self._require_unchanged(self._known())
        return rewrite(self._text, wanted)

    @contextmanager
    def written(self, text: str) -> Iterator[None]:
        """Write the file beside its place, and put it there as the block ends without an error.

        What can fail for want of room has failed before the block begins.

        Raises:
            UsageError: another writer has changed the file meanwhile; that change stands.
            ConfigurationError: it cannot be written.
        """
        place = self._known().resolve()
        with ExitStack() as stack:
            with _writing(place):
                mode = place.stat().st_mode
                beside = written_beside(place, text.encode(), private=True)
                put_in_place = stack.enter_context(beside)
            yield  # outside of the above: a limit that is over is an OSError, too
            self._require_unchanged(place, "the change is in force, but not kept: ")
            with _writing(place, "the change is in force, but "):
                put_in_place()
                place.chmod(mode)
        self._text = text

    def _known(self) -> FilePath:
        if self._path is None:
            raise UsageError(
                "the configuration in force is of no file: there is none to keep it in"
            )
        return self._path

    def _require_unchanged(self, path: FilePath, intro: str = "") -> None:
        try:
            now = read_text(path, _MOST_OCTETS)
        except UnreadableFileError as error:
            raise ConfigurationError(f"{intro}{path}: {error}") from error
        if now.removeprefix("\ufeff") != self._text:
            raise UsageError(
                f"{intro}{path} was changed since it was read: reload it, and make the change anew"
            )


@contextmanager
def _writing(place: FilePath, intro: str = "") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        why = reason_of(error, place)
        raise ConfigurationError(f"{intro}{place} cannot be written: {why}") from error
