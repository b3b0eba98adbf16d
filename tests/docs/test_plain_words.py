"""Pages are short, in sentences of some twenty words, and in words that a search finds."""

from __future__ import annotations

import statistics
from pathlib import Path

from attrs import frozen
from bench.pages import page_figures, pages, sentences_of
from bench.turns import ROOT
from tests.sweeps import for_all

from uoarm.bridge import BridgeOptions, option, options_table

# `python -m bench.pages` prints the figures. Lower these with what they count; never raise one, and
# add none.
WORDS = 1350
WRITTEN_WORDS = 36_500  # of all pages, without what is made from the code
MEDIAN_WORDS = 505
SENTENCE = 18.0  # words of a sentence on average
LONGER_PAGES: dict[str, int] = {
    "errors.md": 2700,  # every code, made of the table in the code
}
LONGER_SENTENCES: dict[str, float] = {}
# Figures of speech and pronouns in the place of a noun, and `octets` for bytes.
VAGUE: dict[str, int] = {}
# How fast something was belongs into benchmarks.md, and nowhere else.
MEASURED: dict[str, int] = {}

PAGES = pages()


def _name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@for_all("page", PAGES)
def test_a_page_is_short_and_plain(page: Path) -> None:
    figures = page_figures(page)
    assert figures.words <= LONGER_PAGES.get(page.name, WORDS), "split it by task"
    limit = LONGER_SENTENCES.get(page.name, SENTENCE)
    assert figures.sentence <= limit, f"sentences are too long, such as: {figures.longest}"
    assert figures.vague.total() <= VAGUE.get(page.name, 0), f"find a plainer word: {figures.vague}"
    if page.name != "benchmarks.md":
        assert figures.measured <= MEASURED.get(page.name, 0), "figures belong into benchmarks.md"


def test_most_pages_are_short() -> None:
    figures = [page_figures(page) for page in PAGES]
    assert sum(page.words - page.generated for page in figures) <= WRITTEN_WORDS
    assert statistics.median(page.words for page in figures) <= MEDIAN_WORDS


def test_every_limit_is_that_of_a_page() -> None:
    names = {page.name for page in PAGES}
    assert {*LONGER_PAGES, *LONGER_SENTENCES, *VAGUE, *MEASURED} <= names


def test_words_of_tables_of_options_are_counted_as_made_from_the_code(tmp_path: Path) -> None:
    @frozen
    class Lamp(BridgeOptions):
        watts: int = option(5, {"type": "integer"}, "of the lamp")

    tables = [options_table(Lamp.schema(), heading) for heading in ("option", "option of a lamp")]
    page = tmp_path / "lamp.md"
    page.write_text("# A lamp\n\n" + "\n\nIt shines.\n\n".join([*tables, "| a | table |\n"]))
    figures = page_figures(page)
    assert figures.generated == (3 + 5) + (6 + 5)  # the heading, and `watts` 5 of the lamp
    assert figures.words == figures.generated + 8  # a heading, two sentences, another table
    assert figures.tokens > figures.words


def test_sentences_are_those_of_running_text() -> None:
    text = (
        "# A heading\n\nRun `uoarm list`. It lists what [the page](a.md) says, in order. Short.\n\n"
        "```sh\nuoarm list\n```\n\n| no | table |\n|---|---|\n\n"
        "- Items of lists are sentences, too\n"
        "1. they end with their item\n"
    )
    assert sentences_of(text) == [
        "It lists what the page says, in order.",
        "Items of lists are sentences, too",
        "they end with their item",
    ]
