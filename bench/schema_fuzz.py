"""Random pairs against the checker: seconds, first seed; prints what it got wrong and left open.

Usage: ``python bench/schema_fuzz.py [--seconds 60] [--seed 0] [--universe]``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from collections import Counter
from itertools import islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.schema._finite import finite_schema
from tests.schema._hand_schemas import hand_schema
from tests.schema._judge import Body, WrongVerdictError, judge, shown
from tests.schema._mixed_schemas import mixed_pair
from tests.schema._random_choices import RandomChoices
from tests.schema._reference import Reference
from tests.schema._rewrites import negated
from tests.schema._strategies import related_pair
from tests.schema._unions import range_pair, row_pair, tagged_pair
from tests.schema._universe import universe
from tests.schema._watching import watching_pair

from uoarm.schema import check
from uoarm.testing._choices import chance

_SMALL = 40
_EXACT = (watching_pair, watching_pair, range_pair, row_pair, tagged_pair)


def _question(choices: RandomChoices) -> tuple[Body, Body, str | None]:
    """A pair, and the true answer where the producer has few enough instances to try all."""
    if chance(choices, 40):
        return choices.item(_EXACT)(choices)
    if chance(choices, 40):
        return (*mixed_pair(choices), None)
    if not chance(choices, 40):
        return (*related_pair(choices), None)
    producer, instances = finite_schema(choices)
    consumer = hand_schema(choices, 2) if chance(choices, 60) else finite_schema(choices)[0]
    consumer = negated(consumer) if chance(choices, 25) else consumer
    accepts = Reference(consumer).accepts
    return producer, consumer, "yes" if all(accepts(value) for value in instances) else "no"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--universe", action="store_true")
    options = parser.parse_args()
    everything = list(islice(universe(), None if options.universe else _SMALL))
    answers: Counter[str] = Counter()
    causes: Counter[str] = Counter()
    slowest = (0.0, 0)
    seed = options.seed
    end = time.monotonic() + options.seconds
    while time.monotonic() < end:
        seed += 1
        choices = RandomChoices(seed)
        producer, consumer, truth = _question(choices)
        try:
            started = time.perf_counter()
            verdict = check(producer, consumer)
            slowest = max(slowest, (time.perf_counter() - started, seed))
            given = judge(producer, consumer, choices, universe=everything)
            answers[given if truth in {None, given} or given == "undecided" else "WRONG"] += 1
            if truth not in {None, given} and given != "undecided":
                print(f"{given} for {truth}, seed {seed}{shown(producer, consumer)}")
            if verdict.undecided is not None:
                causes[verdict.undecided] += 1
                if causes[verdict.undecided] <= 1:
                    print(f"undecided, seed {seed}: {verdict.undecided}{shown(producer, consumer)}")
        except WrongVerdictError as error:
            answers["WRONG"] += 1
            print(f"WRONG, seed {seed}: {error}")
        except Exception:  # noqa: BLE001 - a crash of the checker is a finding
            answers["CRASH"] += 1
            last = traceback.format_exc().splitlines()
            print(f"CRASH, seed {seed}: {last[-3:]}{shown(producer, consumer)}")
    print(json.dumps({"seeds": [options.seed + 1, seed], "answers": answers, "slowest": slowest}))
    for cause, count in causes.most_common():
        print(count, cause)


if __name__ == "__main__":
    main()
