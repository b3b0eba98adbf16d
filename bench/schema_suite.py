"""The official JSON-Schema-Test-Suite as questions for the checker: right, wrong, undecided.

Usage: ``python bench/schema_suite.py [--json] [--causes]``. A ``const`` of an instance is contained
in a schema exactly when the instance is valid; schema against schema, only the answer is counted
and each is tried against the instances of the group.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.schema._judge import answer
from tests.schema._official import groups
from tests.schema._suite_pairs import Derived, const_pairs, schema_pairs

from uoarm.schema import check

if TYPE_CHECKING:
    from collections.abc import Iterable

_ANSWERS = ("right", "wrong", "undecided", "error")
Table = dict[str, Counter[str]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="the figures as JSON")
    parser.add_argument("--causes", action="store_true", help="also why pairs were left undecided")
    options = parser.parse_args()
    suite = groups()
    causes: Counter[str] = Counter()
    consts, schemas = _table(const_pairs(suite), causes), _table(schema_pairs(suite), causes)
    if options.json:
        print(json.dumps({"const": consts, "schema": schemas, "causes": causes}))
        return
    _show("An instance as const against its schema and its negation", consts)
    _show("Schema against schema within a file ('right' is: decided)", schemas)
    if options.causes:
        for cause, count in causes.most_common():
            print(f"{count:6} {cause}")


def _table(pairs: Iterable[Derived], causes: Counter[str]) -> Table:
    table: Table = {}
    for pair in pairs:
        table.setdefault(pair.keyword, Counter())[_outcome(pair, causes)] += 1
    return table


def _outcome(pair: Derived, causes: Counter[str]) -> str:
    try:
        verdict = check(pair.producer, pair.consumer)
    except Exception as error:  # noqa: BLE001 - counted as what it is
        causes[f"raised {type(error).__name__}: {error}"[:160]] += 1
        return "error"
    given = answer(verdict)
    if given == "undecided":
        causes[str(verdict.undecided)[:160]] += 1
        return given
    if pair.contained is None:
        return "right"
    return "right" if (given == "yes") == pair.contained else "wrong"


def _show(title: str, table: Table) -> None:
    print(f"\n{title}\n\n| keyword | pairs | right | wrong | undecided | error | undecided share |")
    print("|---|---|---|---|---|---|---|")
    total: Counter[str] = Counter()
    for keyword, counts in sorted(table.items()):
        total += counts
        _row(keyword, counts)
    _row("all", total)


def _row(name: str, counts: Counter[str]) -> None:
    cells = " | ".join(str(counts[kind]) for kind in _ANSWERS)
    print(f"| {name} | {counts.total()} | {cells} | {counts['undecided'] / counts.total():.1%} |")


if __name__ == "__main__":
    main()
