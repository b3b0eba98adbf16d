"""Figures of the pages: words, the length of sentences, words that no reader searches for.

`python -m bench.pages` prints them by page. `tests/docs/test_plain_words.py` holds them. Words that
are made from the code are counted apart, since nothing on a page can shorten them: the page of the
error codes, and tables of options, which tests compare with the code. A word has a letter or a
digit; the last line also counts the bars of tables, dashes and braces, as `wc -w` does.
"""

from __future__ import annotations

import re
import statistics
from collections import Counter
from pathlib import Path

from attrs import frozen

from bench.structure import words_of_prose
from bench.tables import print_table
from bench.turns import ROOT

# Figures of speech that are more than a word, and words for which there is a plainer one.
_PHRASES = re.compile(
    r"\b(?:in vain|go(?:es)? on|octets?|who comes|can(?:not)? be had|let go of|wrong words)\b",
    re.IGNORECASE,
)
# What belongs into benchmarks.md: how fast something was, on which machine, under which load.
_MEASURED = re.compile(
    r"\bload (?:of )?\d|\bp99\b|\bmedians?\b|\b(?:two|four) (?:shared )?cores\b",
    re.IGNORECASE,
)
# Tables of `uoarm.bridge.options_table`.
_OPTIONS = re.compile(
    r"^\| (?:option|policy|member)(?: of an? \w+)? \| default \| meaning \|\n(?:\|.*\n?)*",
    re.MULTILINE,
)
_GENERATED_PAGES = {"errors.md"}  # of `uoarm explain --markdown`
_FENCE = re.compile(r"^( *)(`{3,}|~{3,}).*?^\1\2[`~]*$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_WORD = re.compile(r"[A-Za-z0-9`][\w`'.,/-]*")
_END = re.compile(r"(?<=[.!?])[\"')]*\s+(?=[A-Z`*\"'(\[])")


@frozen
class PageFigures:
    """What was counted on one page."""

    words: int
    generated: int
    """How many of them are made from the code."""
    tokens: int
    """Words and signs that stand alone."""
    sentence: float
    """The mean number of words of a sentence of running text."""
    longest: str
    vague: Counter[str]
    measured: int


def pages() -> list[Path]:
    """Return the pages that people read: the README and those of `docs`."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def _paragraphs(text: str) -> list[str]:
    """Return running text and items of lists; no tables, headings, code or lists of links."""
    paragraphs: list[list[str]] = [[]]
    for line in _FENCE.sub("\n", text).splitlines():
        stripped = line.strip()
        if not stripped or stripped.startswith(("#", "|", ">", "<!--", "(")):
            paragraphs.append([])
        elif re.match(r"(?:[-*+]|\d+\.) ", stripped):
            paragraphs.append([re.sub(r"^(?:[-*+]|\d+\.) ", "", stripped)])
        else:
            paragraphs[-1].append(stripped)
    return [" ".join(lines) for lines in paragraphs if lines]


def sentences_of(text: str) -> list[str]:
    """Return the sentences of a page's running text, each code span and link as its words."""
    found = []
    for paragraph in _paragraphs(text):
        plain = re.sub(r"`[^`]*`", lambda span: "`" + re.sub(r"\W", "", span[0]) + "`", paragraph)
        found += _END.split(_LINK.sub(r"\1", plain))
    return [sentence for sentence in found if len(_WORD.findall(sentence)) > 2]


def _count(text: str) -> int:
    return sum(any(map(str.isalnum, token)) for token in text.split())


def page_figures(page: Path) -> PageFigures:
    """Count a page."""
    text = page.read_text(encoding="utf-8")
    sentences = sentences_of(text)
    lengths = [len(_WORD.findall(sentence)) for sentence in sentences]
    prose = re.sub(r"`[^`\n]*`", "", _FENCE.sub("\n", text))
    vague = words_of_prose(prose)
    del vague["pulse"]  # of a patient, on the pages about devices
    vague.update(match.lower() for match in _PHRASES.findall(prose))
    words = _count(text)
    tables = sum(map(_count, _OPTIONS.findall(text)))
    return PageFigures(
        words=words,
        generated=words if page.name in _GENERATED_PAGES else tables,
        tokens=len(text.split()),
        sentence=round(statistics.mean(lengths), 1) if lengths else 0.0,
        longest=max(sentences, key=lambda sentence: len(_WORD.findall(sentence)), default=""),
        vague=vague,
        measured=len(_MEASURED.findall(prose)),
    )


def main() -> None:
    """Print the figures of every page, and of all together."""
    figures = {page.name: page_figures(page) for page in pages()}
    rows = [
        (
            name,
            f"{page.words}",
            f"{page.generated}",
            f"{page.sentence}",
            f"{page.vague.total()}",
            f"{page.measured}",
        )
        for name, page in figures.items()
    ]
    words = [page.words for page in figures.values()]
    generated = [page.generated for page in figures.values()]
    rows.append(("all", f"{sum(words)}", f"{sum(generated)}", "", "", ""))
    rows.append(("all that is written", f"{sum(words) - sum(generated)}", "", "", "", ""))
    rows.append(("median", f"{statistics.median(words):g}", "", "", "", ""))
    tokens = sum(page.tokens for page in figures.values())
    rows.append(("all, signs that stand alone included", f"{tokens}", "", "", "", ""))
    headings = ("page", "words", "made from code", "words a sentence", "vague", "measurements")
    print_table("The pages", headings, rows)


if __name__ == "__main__":
    main()
