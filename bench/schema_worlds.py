"""Random documents with dynamic scopes, recursive and far references, against exact truth.

Usage: ``python bench/schema_worlds.py [--kind dynamic|recursive|far] [--pairs 1000] [--seed 0]``.
Prints what the checker got wrong, and the tally. Every pair is judged by a second decision
procedure in a finite world (``tests/schema/_worlds.py``).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.schema._judge import WrongVerdictError
from tests.schema._random_choices import RandomChoices
from tests.schema._scoped_judge import GENERATORS, judge_scoped


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", choices=sorted(GENERATORS), action="append")
    parser.add_argument("--pairs", type=int, default=1_000, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    wrong = 0
    for kind in options.kind or GENERATORS:
        answers: Counter[str] = Counter()
        started = time.process_time()
        for seed in range(options.seed, options.seed + options.pairs):
            try:
                answers[judge_scoped(kind, RandomChoices(seed))] += 1
            except WrongVerdictError as error:
                answers["WRONG"] += 1
                print(f"WRONG, {kind}, seed {seed}: {error}", flush=True)
        wrong += answers["WRONG"]
        seconds = round(time.process_time() - started, 1)
        seeds = [options.seed, options.seed + options.pairs - 1]
        print(json.dumps({"kind": kind, "seeds": seeds, "answers": answers, "seconds": seconds}))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
