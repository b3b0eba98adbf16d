"""Figures of the source code: modules and their lengths, words, comments, lines.

`python -m bench.structure` prints them for this checkout, `--json` as JSON, and `--before FOLDER`
beside those of another checkout. `tests/test_words.py` holds some of them.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import statistics
import subprocess
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

from bench.tables import print_table
from bench.turns import ROOT

AREAS = {
    "core": ("src",),
    "plugins": ("plugins/*/src",),
    "tests": ("tests", "plugins/*/tests"),
    "benches": ("bench",),
    "examples": ("examples",),
}
# Figures of speech, and pronouns in the place of a noun; the forms of a word count together.
WORDS = {
    "told": ("told", "tell", "tells", "telling", "untold"),
    "heard": ("heard", "unheard", "hear", "hears", "hearing"),
    "somebody": ("somebody", "someone"),
    "nobody": ("nobody",),
    "whoever": ("whoever",),
    "everybody": ("everybody", "anybody"),
    "pulse": ("pulse", "pulses"),
    "outage": ("outage", "outages"),
    "shelf": ("shelf",),
    "vain": ("vain",),
}
_WORD_OF = {form: word for word, forms in WORDS.items() for form in forms}
_VAGUE = {"one", "each"}
_LOOP = re.compile(r"\bfor\b[^:=]{0,80}\b(?:one|each)\b[^:=]{0,80}\bin\b")
_CLASS = re.compile(r"^class ([A-Za-z]\w*)[(:\[]", re.MULTILINE)
_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")
_ENTRY_POINT = re.compile(r'[\w-]+ = "([\w.]+)(?::\w+)?"$')
_PARTS = re.compile(r"[A-Z]?[a-z]+")
_LOWER = re.compile(r"[a-z]+")
# The modules whose comments say what the code cannot: locks, orders, races.
SUBTLE = ("_control", "_dataplane", "_host/transport", "server/streams")
_SMALL = 80
_LONG = 600


def python_files(*patterns: str, root: Path = ROOT) -> Iterator[Path]:
    """Yield the Python files that git knows, or will, below folders given as patterns."""
    listing = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "*.py"],
        cwd=root,
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    ).stdout
    folders = [folder for pattern in patterns for folder in root.glob(pattern)]
    for name in sorted(set(listing.splitlines())):
        path = root / name
        if path.exists() and any(folder in path.parents for folder in folders):
            yield path


def words_of_names(source: str) -> Counter[str]:
    """Return how often each word of the table stands in a name of this module."""
    counts: Counter[str] = Counter()
    if _WORD_OF.keys().isdisjoint(map(str.lower, _PARTS.findall(source))):
        return counts  # in no name, nor in any text: to read tokens takes a hundred times as long
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.NAME:
            for part in _PARTS.findall(token.string):
                if word := _WORD_OF.get(part.lower()):
                    counts[word] += 1
    return counts


def words_of_prose(text: str) -> Counter[str]:
    """Return how often each word of the table stands in a text."""
    found = (_WORD_OF.get(word) for word in _LOWER.findall(text.lower()))
    return Counter(word for word in found if word)


def prose_of(source: str) -> str:
    """Return the comments and texts of a module, docstrings among them."""
    kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", -1)}
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return "\n".join(token.string for token in tokens if token.type in kinds)


def words_of_texts(source: str) -> Counter[str]:
    """Return how often each word of the table stands in a text or a comment of this module."""
    if not words_of_prose(source):
        return Counter()  # nor in a name: to read tokens takes a hundred times as long
    return words_of_prose(prose_of(source))


def loop_variables(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and name of each loop variable that names nothing: `one`, `each`."""
    if not _LOOP.search(source):
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.For | ast.AsyncFor | ast.comprehension):
            for name in ast.walk(node.target):
                if isinstance(name, ast.Name) and name.id in _VAGUE:
                    yield name.lineno, name.id


def class_names(root: Path = ROOT) -> Mapping[str, list[str]]:
    """Return where each public class of core and plugins is defined, by its name."""
    places: dict[str, list[str]] = defaultdict(list)
    for path in python_files("src", "plugins/*/src", root=root):
        for name in _CLASS.findall(path.read_text(encoding="utf-8")):
            places[name].append(str(path.relative_to(root)))
    return places


def _module_name(path: Path) -> str:
    parts = path.with_suffix("").parts
    start = len(parts) - parts[::-1].index("src")
    return ".".join(part for part in parts[start:] if part != "__init__")


def imports_in(source: str) -> Iterator[ast.Import | ast.ImportFrom]:
    """Yield every import of a module, those within functions, too."""
    waiting: list[ast.AST] = [ast.parse(source)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        for block in _BLOCKS:  # expressions are nine tenths of all nodes, and hold no import
            waiting.extend(getattr(node, block, ()))


@cache
def imports_of(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """Return the imports of a file, which is read once."""
    return tuple(imports_in(path.read_text(encoding="utf-8")))


def _importers(paths: Iterable[Path]) -> Counter[str]:
    counts: Counter[str] = Counter()
    for path in paths:
        modules = set()
        for node in imports_of(path):
            if isinstance(node, ast.Import):
                modules |= {name.name for name in node.names}
            elif node.module:
                modules |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
        counts.update(modules)
    return counts


def _entry_points(root: Path) -> set[str]:
    """Return the modules that a distribution names as a way in: scripts and plugins."""
    found: set[str] = set()
    for path in (root / "pyproject.toml", *root.glob("plugins/*/pyproject.toml")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if match := _ENTRY_POINT.match(line):
                found.add(match[1])
    return found


def _is_public(name: str) -> bool:
    return not any(part.startswith("_") for part in name.split("."))


def small_modules(root: Path = ROOT) -> Iterator[Path]:
    """Yield modules under 80 lines that are no door of their own: join each with its importer.

    A door is what three modules import, what a distribution's entry points name, what is public,
    and what defines a name that a public package lists in its `__all__`.
    """
    paths = list(python_files("src", "plugins/*/src", root=root))
    importers = _importers(paths)
    doors = _entry_points(root)
    for path in paths:
        if path.name == "__init__.py" and _is_public(_module_name(path)):
            doors |= {
                node.module
                for node in imports_of(path)
                if isinstance(node, ast.ImportFrom) and node.module and not node.col_offset
            }
    for path in paths:
        name = _module_name(path)
        is_door = _is_public(name) or name in doors or importers[name] > 2
        if is_door or path.name in {"__init__.py", "__main__.py"}:
            continue
        if path.read_text(encoding="utf-8").count("\n") < _SMALL:
            yield path


def long_modules(root: Path = ROOT) -> list[Path]:
    """Return the modules of core and plugins that are too long to be one idea."""
    return [
        path
        for path in python_files("src", "plugins/*/src", root=root)
        if path.read_text(encoding="utf-8").count("\n") > _LONG
    ]


def structure_figures(root: Path = ROOT) -> dict[str, float]:
    """Return the figures of a checkout, by name; lines are all lines of a file."""
    figures: dict[str, float] = {}
    loops = lambdas = 0
    names: Counter[str] = Counter()
    prose: Counter[str] = Counter()
    for area, patterns in AREAS.items():
        total = 0
        for path in python_files(*patterns, root=root):
            source = path.read_text(encoding="utf-8")
            total += source.count("\n")
            loops += sum(1 for _ in loop_variables(source))
            names += words_of_names(source)
            prose += words_of_texts(source)
        figures[f"lines of {area}"] = total
    trees = {}
    for path in python_files("src", "plugins/*/src", root=root):
        trees[path] = ast.parse(path.read_text(encoding="utf-8"))
        lambdas += sum(isinstance(node, ast.Lambda) for node in ast.walk(trees[path]))
    lengths = {path: path.read_text(encoding="utf-8").count("\n") for path in trees}
    modules = [path for path in trees if path.name not in {"__init__.py", "__main__.py"}]
    small = list(small_modules(root))
    figures |= {
        "modules of core and plugins": len(trees),
        "median lines of a module": statistics.median(lengths[path] for path in modules),
        f"modules over {_LONG} lines": len(long_modules(root)),
        f"modules under {_SMALL} lines that are no door": len(small),
        "lambdas": lambdas,
        "loop variables named one or each": loops,
        "classes of one name": sum(len(places) > 1 for places in class_names(root).values()),
    }
    figures |= {f"names with {word!r}": names[word] for word in WORDS}
    figures |= {f"texts and comments with {word!r}": prose[word] for word in WORDS}
    for folder in SUBTLE:
        figures[f"comments in 100 lines of {folder}"] = _comment_share(root / "src/uoarm" / folder)
    return figures


def _comment_share(folder: Path) -> float:
    comments = lines = 0
    for path in folder.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        lines += sum(1 for line in source.splitlines() if line.strip())
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        comments += sum(token.type == tokenize.COMMENT for token in tokens)
    return round(100 * comments / lines, 1) if lines else 0.0


def main() -> None:
    """Print the figures of this checkout, beside those of another one where it is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--before", type=Path, help="another checkout, to stand beside")
    arguments = parser.parse_args()
    figures = structure_figures()
    before = structure_figures(arguments.before) if arguments.before else {}
    if arguments.json:
        print(json.dumps({"now": figures, "before": before}, indent=2))
        return
    rows = [(name, f"{before.get(name, '')}", f"{value:g}") for name, value in figures.items()]
    print_table("The source code", ("what", "before", "now"), rows)


if __name__ == "__main__":
    main()
