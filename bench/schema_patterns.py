"""Random texts as patterns: our automata against Node's, Python's and Rust's engines.

Usage: ``python bench/schema_patterns.py [--patterns 5000] [--seed 0]``; needs node on the path.

Node (with the `u` flag, else without) is the judge of every pattern that is decided. Python's `re`
and Rust's engine, as ``jsonschema`` and ``jsonschema-rs`` use them, must agree where a pattern is
not called disputed.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import subprocess
import sys
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import jsonschema_rs
from tests.schema._pattern_texts import TEXTS, random_text

from uoarm.schema.regex import (
    MalformedPatternError,
    UnsupportedPatternError,
    compile_pattern,
    found_in,
    is_disputed,
)

_NODE = """
const lines = require('readline').createInterface({input: process.stdin});
lines.on('line', line => {
  const [pattern, texts] = JSON.parse(line), found = {};
  for (const flag of ['u', '']) {
    try { const one = new RegExp(pattern, flag); found[flag] = texts.map(t => one.test(t)); }
    catch { found[flag] = null; }
  }
  process.stdout.write(JSON.stringify(found) + '\\n');
});
"""
Answers = list[bool] | None


def _python(pattern: str) -> Answers:
    try:
        return [re.search(pattern, text) is not None for text in TEXTS]
    except (re.error, OverflowError):
        return None


def _rust(pattern: str) -> Answers:
    try:
        validator = jsonschema_rs.Draft202012Validator({"pattern": pattern})
    except (ValueError, jsonschema_rs.ValidationError):
        return None
    return [validator.is_valid(text) for text in TEXTS]


def _first(ours: list[bool], theirs: Answers, *, plain: bool) -> str:
    """The first text on which two engines differ; without the flag only those of 16 bits count."""
    for text, one, other in zip(TEXTS, ours, theirs or ours, strict=True):
        if one != other and not (plain and any(ord(char) > 0xFFFF for char in text)):
            return f"{text!r}: {one}, and not {other}"
    return ""


def _judge(pattern: str, node: Any) -> tuple[str, str]:
    """What we made of a pattern, and what is wrong with it."""
    unicode, plain = node["u"], node[""]
    try:
        compile_pattern(pattern)
        ours = [found_in(pattern, text) for text in TEXTS]
    except MalformedPatternError as error:
        return "malformed", str(error) if unicode is not None else ""
    except UnsupportedPatternError:
        return "undecided", ""
    except Exception as error:  # noqa: BLE001 - a crash is a finding
        return "crash", repr(error)
    if unicode is None and plain is None:
        return "decided", "it is malformed"
    wrong = _first(ours, plain if unicode is None else unicode, plain=unicode is None)
    if wrong or is_disputed(pattern):
        return "disputed" if is_disputed(pattern) else "decided", wrong
    wrong = _first(ours, _python(pattern), plain=False) or _first(ours, _rust(pattern), plain=False)
    return "decided", f"undisputed, but {wrong}" if wrong else ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--patterns", type=int, default=5_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    source = random.Random(options.seed)
    tally: Counter[str] = Counter()
    pipe = subprocess.PIPE
    with subprocess.Popen(["node", "-e", _NODE], stdin=pipe, stdout=pipe, text=True) as node:
        assert node.stdin is not None
        assert node.stdout is not None
        for _ in range(options.patterns):
            pattern = random_text(source.choice)
            node.stdin.write(json.dumps([pattern, TEXTS]) + "\n")
            node.stdin.flush()
            made, wrong = _judge(pattern, json.loads(node.stdout.readline()))
            tally[made] += 1
            if wrong:
                tally["WRONG"] += 1
                print(f"{pattern!r}, {made}: {wrong}")
        node.stdin.close()
    print(json.dumps(tally))
    return 1 if tally["WRONG"] else 0


if __name__ == "__main__":
    sys.exit(main())
