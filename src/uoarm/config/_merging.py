"""Merging what is suggested into a file: lines are added, and not one that stands there changes."""

from __future__ import annotations

from collections.abc import Container

from uoarm._yaml import Document, read
from uoarm.config._load import loads
from uoarm.errors import ConfigurationError

__all__ = ["is_blank", "merge"]


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
    return all(line.partition("#")[0].strip() in {"", "---"} for line in text.splitlines())


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
    document, lines = read(text, ""), text.splitlines()
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
        lines[start] = f"{head.rstrip()}{rest}".rstrip()
    more = [f"{' ' * column}{line}" if line else line for line in added]
    end_of_text = "\n" if text.endswith("\n") or end == len(lines) else ""
    return "\n".join([*lines[:end], *more, *lines[end:]]) + end_of_text


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
