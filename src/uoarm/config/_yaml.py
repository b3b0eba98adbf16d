"""YAML 1.2 into plain values, with the line and column of every one of them.

The parser is libyaml's through PyYAML (its pure Python twin where libyaml is absent): it is the
only kept one that reads 60,000 lines in a second and still tells positions. Its events are built
into values here, with the scalar rules of the YAML 1.2 core schema (`yes` and `on` are strings)
and with limits on depth, size and what aliases unfold to. Tags are refused: configuration is data.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

import yaml
from attrs import frozen

from uoarm.config._problem import Place, Problem

__all__ = ["Document", "Path", "read"]

Path: TypeAlias = tuple[str | int, ...]

MAX_BYTES = 10_000_000
MAX_DEPTH = 64
MAX_NODES = 2_000_000

_INTEGER = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"0o[0-7]+")
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WORDS: Mapping[str, object] = {
    "": None,
    "~": None,
    **dict.fromkeys(("null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_MAX_DIGITS = 1000


@frozen
class Document:
    """A plain value and the places of its parts.

    Attributes:
        value: dicts, lists, strings, numbers, booleans, None.
        places: line and column of every key's value and every list item, by path.
    """

    value: object
    places: Mapping[Path, Place]

    def place(self, path: Path) -> Place:
        """Return the place of a path, or of the nearest part around it."""
        while path and path not in self.places:
            path = path[:-1]
        return self.places.get(path, Place(1, 1))


class _RefusedError(Exception):
    def __init__(self, mark: Any, sentence: str, hint: str = "") -> None:
        super().__init__(sentence)
        self.problem = Problem(
            place=Place(mark.line + 1, mark.column + 1), path="$", sentence=sentence, hint=hint
        )


class _Frame:
    """One mapping or list that is being filled."""

    def __init__(self, value: dict[str, object] | list[object], path: Path) -> None:
        self.value = value
        self.path = path
        self.key: str | None = None


def read(text: str) -> Document | Problem:
    """Read one document; the first thing that is not YAML, or over a limit, is the problem."""
    if len(text) > MAX_BYTES:
        return Problem(
            place=Place(1, 1),
            path="$",
            sentence=f"the file has {len(text):,} characters; {MAX_BYTES:,} are allowed",
        )
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return _Builder().build(yaml.parse(text, Loader=loader))
    except _RefusedError as refused:
        return refused.problem
    except yaml.YAMLError as error:
        return _syntax_problem(error, text)


class _Builder:
    """Builds values from parser events, with an explicit stack."""

    def __init__(self) -> None:
        self._places: dict[Path, Place] = {}
        self._stack: list[_Frame] = []
        self._anchors: dict[str, tuple[object, int]] = {}
        self._open_anchors: list[tuple[str, int]] = []
        self._nodes = 0
        self._root: object = None
        self._documents = 0

    def build(self, events: Iterator[Any]) -> Document:
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent):
                self._documents += 1
                if self._documents > 1:
                    raise _RefusedError(event.start_mark, "the file holds more than one document")
            elif isinstance(event, yaml.AliasEvent):
                self._alias(event)
            elif isinstance(event, yaml.ScalarEvent):
                self._scalar(event)
            elif isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
                self._begin(event)
            elif isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent):
                self._end()
        return Document(self._root, self._places)

    def _scalar(self, event: Any) -> None:
        self._refuse_tag(event)
        frame = self._stack[-1] if self._stack else None
        if frame is not None and isinstance(frame.value, dict) and frame.key is None:
            self._key(frame, event)
            return
        value = _resolve(event) if event.implicit[0] else event.value
        self._count(event, 1)
        if event.anchor:
            self._anchors[event.anchor] = (value, 1)
        self._put(value, event)

    def _key(self, frame: _Frame, event: Any) -> None:
        key = event.value
        if event.implicit[0] and not isinstance(_resolve(event), str):
            raise _RefusedError(
                event.start_mark, f"the key {key} is not a string", f'write "{key}" in quotes'
            )
        if key == "<<":
            raise _RefusedError(event.start_mark, "merge keys (<<) are not part of YAML 1.2")
        if key in frame.value:
            path: Path = (*frame.path, key)
            first = self._places[path]
            raise _RefusedError(
                event.start_mark, f"the key {key!r} is given twice; first in line {first.line}"
            )
        frame.key = key

    def _alias(self, event: Any) -> None:
        if event.anchor not in self._anchors:
            raise _RefusedError(event.start_mark, f"the alias *{event.anchor} has no anchor")
        value, size = self._anchors[event.anchor]
        self._count(event, size)
        self._put(value, event)

    def _begin(self, event: Any) -> None:
        self._refuse_tag(event)
        if len(self._stack) >= MAX_DEPTH:
            raise _RefusedError(event.start_mark, f"nested more than {MAX_DEPTH} levels deep")
        frame = self._stack[-1] if self._stack else None
        if frame is not None and isinstance(frame.value, dict) and frame.key is None:
            raise _RefusedError(event.start_mark, "a key must be a string, not a mapping or list")
        self._count(event, 1)
        value: dict[str, object] | list[object] = (
            {} if isinstance(event, yaml.MappingStartEvent) else []
        )
        path = self._put(value, event)
        self._stack.append(_Frame(value, path))
        self._open_anchors.append((event.anchor or "", self._nodes))

    def _end(self) -> None:
        frame = self._stack.pop()
        anchor, before = self._open_anchors.pop()
        if anchor:
            self._anchors[anchor] = (frame.value, self._nodes - before + 1)

    def _put(self, value: object, event: Any) -> Path:
        place = Place(event.start_mark.line + 1, event.start_mark.column + 1)
        if not self._stack:
            self._root = value
            self._places[()] = place
            return ()
        frame = self._stack[-1]
        if isinstance(frame.value, dict):
            assert frame.key is not None, "a value follows its key"
            path: Path = (*frame.path, frame.key)
            frame.value[frame.key] = value
            frame.key = None
        else:
            path = (*frame.path, len(frame.value))
            frame.value.append(value)
        self._places[path] = place
        return path

    def _count(self, event: Any, size: int) -> None:
        self._nodes += size
        if self._nodes > MAX_NODES:
            raise _RefusedError(
                event.start_mark, f"more than {MAX_NODES:,} values, aliases unfolded"
            )

    def _refuse_tag(self, event: Any) -> None:
        if event.tag is not None and event.tag not in {"!", "tag:yaml.org,2002:str"}:
            raise _RefusedError(event.start_mark, f"the tag {event.tag} is not allowed")


def _resolve(event: Any) -> object:
    """Return what a plain scalar means by the core schema of YAML 1.2."""
    text = event.value
    if event.tag is not None:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if len(text) > _MAX_DIGITS:
        return text
    if _INTEGER.fullmatch(text):
        return int(text)
    if _OCTAL.fullmatch(text):
        return int(text, 0)
    if _HEXADECIMAL.fullmatch(text):
        return int(text, 0)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


def _syntax_problem(error: yaml.YAMLError, text: str) -> Problem:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    what = getattr(error, "problem", None) or str(error)
    place = Place(mark.line + 1, mark.column + 1) if mark is not None else Place(1, 1)
    lines = text.splitlines()
    line = lines[place.line - 1] if place.line <= len(lines) else ""
    hint = "YAML does not allow tabs for indentation: use spaces" if "\t" in line else ""
    return Problem(place=place, path="$", sentence=f"this is not YAML: {what}", hint=hint)
