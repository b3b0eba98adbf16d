"""The words of the code: terms that a search finds, and one meaning for each name of a class."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from bench.structure import (
    AREAS,
    WORDS,
    class_names,
    loop_variables,
    python_files,
    words_of_names,
    words_of_texts,
)
from bench.turns import ROOT

# How many names of an area hold a word of the table: lower a number with what it counts, and
# never raise one. What is not here is zero. `tell` is a method of files, and a pulse one of hearts.
LIMITS: dict[str, dict[str, int]] = {
    "core": {"told": 1},
    "plugins": {"pulse": 31},
    "tests": {"pulse": 19},
    "examples": {"told": 1, "pulse": 6},
}  # fmt: skip
# The same of comments, docstrings and other texts. Pulses are of hearts, shelves of the warehouse.
PROSE_LIMITS: dict[str, dict[str, int]] = {
    "core": {"told": 1},
    "plugins": {"pulse": 15},
    "tests": {"pulse": 38, "shelf": 27},
    "benches": {"pulse": 1, "vain": 1},
    "examples": {"pulse": 21, "shelf": 12},
}  # fmt: skip
# How many loop variables are `one` or `each`; the same holds.
LOOPS: dict[str, int] = {}
# Classes that several modules still define, each an end, a part or a value of its own framework.
# Take a name out once it is defined in one module; add none.
SHARED_NAMES = frozenset(
    {
        "Outbox",
    }
)


def _sources(area: str) -> Iterator[tuple[Path, str]]:
    for path in python_files(*AREAS[area]):
        if path.name not in {"structure.py", "test_words.py"}:  # they hold what they count
            yield path.relative_to(ROOT), path.read_text(encoding="utf-8")


def excess(counts: Mapping[str, int], limits: Mapping[str, int]) -> dict[str, int]:
    """Return the counts that are above their limits; what has no limit may not be there."""
    return {name: count for name, count in counts.items() if count > limits.get(name, 0)}


@pytest.mark.parametrize("area", AREAS)
def test_names_are_terms_and_no_figures_of_speech(area: str) -> None:
    counts: Counter[str] = Counter()
    places: dict[str, Counter[Path]] = {word: Counter() for word in WORDS}
    for path, source in _sources(area):
        found = words_of_names(source)
        counts += found
        for word, count in found.items():
            places[word][path] = count
    more = excess(counts, LIMITS.get(area, {}))
    where = {word: places[word] for word in more}
    assert not more, f"use the term that an engineer would search for: {where}"


@pytest.mark.parametrize("area", AREAS)
def test_texts_use_the_terms_too(area: str) -> None:
    found = {path: words_of_texts(source) for path, source in _sources(area)}
    more = excess(sum(found.values(), Counter()), PROSE_LIMITS.get(area, {}))
    where = {word: {path: n[word] for path, n in found.items() if n[word]} for word in more}
    assert not more, f"use the term that an engineer would search for: {where}"


@pytest.mark.parametrize("area", AREAS)
def test_a_loop_variable_is_the_singular_of_what_is_iterated(area: str) -> None:
    vague = [
        f"{path}:{line}: {name}"
        for path, source in _sources(area)
        for line, name in loop_variables(source)
    ]
    assert not excess({area: len(vague)}, LOOPS), vague


def test_a_class_name_has_one_meaning() -> None:
    several = {name: places for name, places in class_names().items() if len(places) > 1}
    assert {name: several[name] for name in several.keys() - SHARED_NAMES} == {}


def test_what_is_above_its_limit_or_has_none_is_found() -> None:
    counts = {"told": 3, "heard": 1, "pulse": 1}
    assert excess(counts, {"told": 2, "pulse": 2}) == {"told": 3, "heard": 1}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("told = 1", {"told": 1}),
        ("def _tell_error(): pass", {"told": 1}),
        ("class UntoldError(Exception): pass", {"told": 1}),
        ("is_unheard = nobody", {"heard": 1, "nobody": 1}),
        ("'told'  # nobody", {}),
        ("total = retold", {}),
    ],
)
def test_words_are_counted_in_names_only(source: str, expected: dict[str, int]) -> None:
    assert words_of_names(source) == expected


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("for one in x: pass", 1),
        ("[each for each in x]", 1),
        ("for index, (one, other) in x: pass", 1),
        ("async def f():\n    async for one in x: pass", 1),
        ("one = 1", 0),
        ("for part in parts: pass", 0),
    ],
)
def test_loop_variables_that_name_nothing_are_found(source: str, count: int) -> None:
    assert len(list(loop_variables(source))) == count
