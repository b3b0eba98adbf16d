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
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.schema._judge import WrongVerdictError, judge, shown
from tests.schema._random_choices import RandomChoices
from tests.schema._strategies import related_pair
from tests.schema._universe import universe
from uoarm.schema import check


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--universe", action="store_true")
    options = parser.parse_args()
    everything = list(universe()) if options.universe else []
    answers: Counter[str] = Counter()
    causes: Counter[str] = Counter()
    slowest = (0.0, 0)
    seed = options.seed
    end = time.monotonic() + options.seconds
    while time.monotonic() < end:
        seed += 1
        choices = RandomChoices(seed)
        producer, consumer = related_pair(choices)
        try:
            started = time.perf_counter()
            verdict = check(producer, consumer)
            slowest = max(slowest, (time.perf_counter() - started, seed))
            answers[judge(producer, consumer, choices, universe=everything)] += 1
            if verdict.undecided is not None:
                causes[verdict.undecided] += 1
                if causes[verdict.undecided] <= 2:
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
