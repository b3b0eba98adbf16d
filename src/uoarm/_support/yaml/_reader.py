"""YAML 1.2 into plain values, with the line and column of every one of them.

The parser is libyaml's through PyYAML (its pure Python twin where libyaml is absent). Its events
are built into values here, without recursion, by the scalar rules of the YAML 1.2 core schema and
within a budget of octets, depth and what aliases unfold to, spent before any value is built. A key
that is given twice is refused, and so are tags: these files are data.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path as File
from typing import Any

import yaml
from attrs import frozen

from uoarm._support.files import UnreadableFileError, read_text
from uoarm._support.yaml._document import (
    Document,
    NodePosition,
    Path,
    Position,
    Problem,
    ScalarError,
    clip,
    resolve,
    write_path,
)

_FORBIDDEN = re.compile(r"[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_STRING_TAGS = frozenset({None, "!", "tag:yaml.org,2002:str"})
_TAG_PREFIX = "tag:yaml.org,2002:"
_START = Position(1, 1)


@frozen
class ReadBudget:
    """How much one file may ask for.

    Attributes:
        octets: of the file; of text that was not read from one, characters.
        nodes: values, each alias counted with all that it stands for.
        depth: how deeply they are nested.
    """

    octets: int = 10_000_000
    nodes: int = 200_000
    depth: int = 64


_ROBOT = ReadBudget()


class _StopError(Exception):
    """Reading cannot go on."""

    def __init__(self, place: Position, sentence: str, hint: str = "", path: Path = ()) -> None:
        super().__init__(sentence)
        self.place, self.sentence, self.hint, self.path = place, sentence, hint, path


class _Frame:
    """One mapping or list that is being filled."""

    __slots__ = ("anchor", "before", "is_merge", "key", "key_place", "path", "spot", "value")

    def __init__(
        self, value: Any, spot: NodePosition, path: Path, anchor: str, before: int
    ) -> None:
        self.value = value
        self.spot = spot
        self.path = path
        self.anchor = anchor
        self.before = before
        self.key: str | None = None
        self.key_place: Position | None = None
        self.is_merge = False


def read_file(path: File, budget: ReadBudget = _ROBOT) -> Document:
    """Read one document from a regular file; what is wrong with it stands in its `problems`."""
    try:
        return read(read_text(path, budget.octets), str(path), budget)
    except UnreadableFileError as error:
        problem = Problem(
            place=Position(error.line or 1, 1),
            path="$" if error.line else "",
            sentence=error.sentence,
            hint=error.hint,
            file=str(path),
            error_code="UOA-101",
        )
        return Document(None, NodePosition(_START), (problem,), whole=False)


def read(text: str, file: str = "", budget: ReadBudget = _ROBOT) -> Document:
    """Read one document; what is wrong with it as YAML stands in its `problems`."""
    text = text.removeprefix("\ufeff")
    builder = _Builder(file, budget)
    try:
        _refuse_size_and_characters(text, budget.octets)
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        builder.build(yaml.parse(text, Loader=loader))
    except _StopError as stop:
        builder.complain(stop.place, stop.sentence, stop.hint, stop.path)
    except yaml.YAMLError as error:
        builder.complain(*_syntax(error, text))
    else:
        return Document(builder.root, builder.spot, tuple(builder.problems), text=text)
    return Document(None, NodePosition(_START), tuple(builder.problems), whole=False)


def _refuse_size_and_characters(text: str, limit: int) -> None:
    if len(text) > limit:
        raise _StopError(_START, f"the file has {len(text):,} characters; {limit:,} are allowed")
    bad = _FORBIDDEN.search(text)
    if bad is not None:
        before = text[: bad.start()]
        place = Position(before.count("\n") + 1, bad.start() - before.rfind("\n"))
        raise _StopError(place, f"the character U+{ord(bad.group()):04X} is not allowed in YAML")


class _Builder:
    """Builds values from parser events, with an explicit stack."""

    def __init__(self, file: str, budget: ReadBudget) -> None:
        self._budget = budget
        self.root: object = None
        self.spot = NodePosition(_START)
        self.problems: list[Problem] = []
        self._file = file
        self._stack: list[_Frame] = []
        self._anchors: dict[str, tuple[object, int]] = {}
        self._nodes = 0
        self._documents = 0

    def build(self, events: Iterator[Any]) -> None:
        """Take every event of one document.

        Raises:
            _StopError: a limit, or what cannot be a value.
            yaml.YAMLError: the text is not YAML.
        """
        take: dict[type, Callable[[Any], None]] = {
            yaml.DocumentStartEvent: self._document,
            yaml.AliasEvent: self._alias,
            yaml.ScalarEvent: self._scalar,
            yaml.MappingStartEvent: self._begin,
            yaml.SequenceStartEvent: self._begin,
            yaml.MappingEndEvent: self._end,
            yaml.SequenceEndEvent: self._end,
        }
        for event in events:
            action = take.get(type(event))
            if action is not None:
                action(event)

    def complain(self, place: Position, sentence: str, hint: str = "", path: Path = ()) -> None:
        """Note a problem and go on."""
        self.problems.append(
            Problem(
                place=place,
                path=write_path(path),
                sentence=sentence,
                hint=hint,
                file=self._file,
                error_code="UOA-102",
            )
        )

    def _document(self, event: Any) -> None:
        self._documents += 1
        if self._documents > 1:
            raise _StopError(
                _place(event), "a second document begins here", "one file holds one configuration"
            )

    def _scalar(self, event: Any) -> None:
        frame = self._stack[-1] if self._stack else None
        if frame is not None and frame.key is None and isinstance(frame.value, dict):
            self._key(frame, event)
            return
        self._check_tag(event)
        self._count(event, 1)
        value: object = event.value
        if event.implicit[0] and event.tag is None:
            try:
                value = resolve(event.value)
            except ScalarError as error:
                self.complain(_place(event), str(error), "write text in quotes", self._here())
        if event.anchor:
            self._anchors[event.anchor] = (value, 1)
        self._put(value, NodePosition(_place(event)))

    def _key(self, frame: _Frame, event: Any) -> None:
        self._check_tag(event)
        key: str = event.value
        place = _place(event)
        frame.key, frame.key_place = key, place
        is_plain = event.implicit[0] and event.tag is None
        frame.is_merge = is_plain and key == "<<"
        if event.anchor:
            self._anchors[event.anchor] = (key, 1)
        if key in frame.value:
            assert isinstance(frame.spot.parts, dict), "a mapping has parts by key"
            first = frame.spot.parts[key].key
            line = first.line if first is not None else place.line
            self.complain(
                place,
                f"the key {clip(key)} is given twice, first in line {line}",
                path=(*frame.path, key),
            )
        elif is_plain:
            self._check_plain_key(key, place, frame.path)

    def _check_plain_key(self, key: str, place: Position, path: Path) -> None:
        if key == "<<":
            self.complain(
                place, "merge keys (<<) are not part of YAML 1.2", "write the keys out", path
            )
            return
        try:
            is_text = isinstance(resolve(key), str)
        except ScalarError:
            is_text = False
        if not is_text:
            shown = clip(key)
            self.complain(place, f"the key {shown} is not text", "write it in quotes", (*path, key))

    def _alias(self, event: Any) -> None:
        frame = self._stack[-1] if self._stack else None
        if frame is not None and frame.key is None and isinstance(frame.value, dict):
            raise _StopError(_place(event), "an alias cannot be a key", "write the key out")
        if event.anchor not in self._anchors:
            raise _StopError(
                _place(event),
                f"the alias *{event.anchor} stands before the end of its anchor, or has none",
                path=self._here(),
            )
        value, size = self._anchors[event.anchor]
        self._count(event, size)
        self._put(value, NodePosition(_place(event)))

    def _begin(self, event: Any) -> None:
        frame = self._stack[-1] if self._stack else None
        if frame is not None and frame.key is None and isinstance(frame.value, dict):
            raise _StopError(_place(event), "a key must be text, not a mapping or a list")
        self._check_tag(event, container=True)
        if len(self._stack) >= self._budget.depth:
            raise _StopError(_place(event), f"nested more than {self._budget.depth} levels deep")
        self._count(event, 1)
        is_mapping = type(event) is yaml.MappingStartEvent
        value: object = {} if is_mapping else []
        spot = NodePosition(_place(event), parts={} if is_mapping else [])
        path = self._here()
        self._put(value, spot)
        self._stack.append(_Frame(value, spot, path, event.anchor or "", self._nodes))

    def _end(self, _: Any) -> None:
        frame = self._stack.pop()
        if frame.anchor:
            self._anchors[frame.anchor] = (frame.value, self._nodes - frame.before + 1)

    def _here(self) -> Path:
        """The path of the value that comes next."""
        if not self._stack:
            return ()
        frame = self._stack[-1]
        return (*frame.path, len(frame.value) if frame.key is None else frame.key)

    def _put(self, value: object, spot: NodePosition) -> None:
        if not self._stack:
            self.root, self.spot = value, spot
            return
        frame = self._stack[-1]
        parts = frame.spot.parts
        if isinstance(parts, dict):
            key = frame.key
            assert key is not None, "a value follows its key"
            if key not in parts and not frame.is_merge:  # which was complained of
                spot.key = frame.key_place
                frame.value[key] = value
                parts[key] = spot
            frame.key = None
        elif parts is not None:
            frame.value.append(value)
            parts.append(spot)

    def _count(self, event: Any, size: int) -> None:
        self._nodes += size
        if self._nodes > self._budget.nodes:
            raise _StopError(
                _place(event), f"more than {self._budget.nodes:,} values, aliases counted in full"
            )

    def _check_tag(self, event: Any, *, container: bool = False) -> None:
        if event.tag is not None and (container or event.tag not in _STRING_TAGS):
            self.complain(
                _place(event),
                f"the tag {clip(event.tag.replace(_TAG_PREFIX, '!!'))} is not allowed",
                "leave the tag out: a configuration is plain data",
                self._here() if self._stack and self._stack[-1].key is not None else (),
            )


def _place(event: Any) -> Position:
    mark = event.start_mark
    return Position(mark.line + 1, mark.column + 1)


def _syntax(error: yaml.YAMLError, text: str) -> tuple[Position, str, str]:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    place = Position(mark.line + 1, mark.column + 1) if mark is not None else _START
    what = getattr(error, "problem", None) or "it cannot be parsed"
    context = getattr(error, "context", None)
    begun = getattr(error, "context_mark", None)
    if context and begun is not None:
        what = f"{what} ({context}, begun in line {begun.line + 1})"
    lines = text.splitlines()
    line = lines[place.line - 1] if place.line <= len(lines) else ""
    tab = "\t" in line[: len(line) - len(line.lstrip())] or "\\t" in what or "tab" in what
    hint = "write text in quotes" if "cannot start any token" in what else ""
    if tab:
        hint = "YAML does not allow tabs for indentation: use spaces"
    return place, f"this is not YAML: {what}", hint
