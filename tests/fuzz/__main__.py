"""Search every decoder for what it should not do, guided by coverage, and print what was tried.

Usage: ``python -m tests.fuzz [--runs 100000] [--only NAME ...] [--findings FOLDER]``.

With `atheris` (``pip install atheris``) the search follows the branches of our own code, in one
process for each decoder; without it hypothesis varies the same seeds blindly. Findings are kept as
files whose octets, given to the decoder again, show them. Exit code 1: there are some.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from attrs import frozen

_LONGEST = 2048
_SECONDS_FOR_ONE = 10
_OCTETS = 1_500  # MiB
_UNITS = re.compile(r"stat::number_of_executed_units:\s+(\d+)")
_COVERED = re.compile(r"cov: (\d+)")


@frozen
class Outcome:
    """What the search in one decoder came to."""

    runs: int
    seconds: float
    covered: str
    findings: tuple[str, ...]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100_000, help="for each decoder")
    parser.add_argument("--only", nargs="*", default=[], help="names of decoders")
    parser.add_argument("--findings", type=Path, default=Path("build/fuzz"))
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        _follow_coverage(options.one, options.runs, options.findings)
        return 0
    from tests.fuzz.targets import TARGETS

    guided = find_spec("atheris") is not None
    print("guided by coverage (atheris)" if guided else "not guided: atheris is not installed")
    print(f"\n{'decoder':<34}{'runs':>10}{'seconds':>9}{'branches':>10}  findings")
    found = 0
    for name in options.only or TARGETS:
        search = _search_guided if guided else _search_blindly
        outcome = search(name, options.runs, options.findings)
        found += len(outcome.findings)
        text = "; ".join(outcome.findings) or "none"
        print(
            f"{name:<34}{outcome.runs:>10,}{outcome.seconds:>9.1f}{outcome.covered:>10}  {text}",
            flush=True,
        )
    return int(found > 0)


def _search_guided(name: str, runs: int, findings: Path) -> Outcome:
    """Run libFuzzer in a process of its own: it ends with its process."""
    findings.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    done = subprocess.run(  # the child bounds itself by its runs, and each run in time
        [
            *(sys.executable, "-m", "tests.fuzz", "--one", name),
            *("--runs", str(runs), "--findings", str(findings)),
        ],
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
        env={**os.environ, "PYTHONHASHSEED": "0"},
    )
    seconds = time.perf_counter() - started
    units, covered = _UNITS.search(done.stderr), _COVERED.findall(done.stderr)
    kept = re.findall(r"Test unit written to (\S+)", done.stderr)
    problems = tuple(kept)
    if done.returncode and not kept:
        problems = (f"it ended with {done.returncode}: {(done.stderr or done.stdout)[-300:]!r}",)
    last = covered[-1] if covered else "-"
    return Outcome(int(units[1]) if units else 0, seconds, last, problems)


def _follow_coverage(name: str, runs: int, findings: Path) -> None:
    """Search until `runs` are done or something is found; does not return."""
    import tempfile

    import atheris

    with atheris.instrument_imports(include=["uoarm", "uoarm_rocos", "uoarm_ros1", "uoarm_rtm"]):
        from tests.fuzz.targets import TARGETS
    one = TARGETS[name]
    corpus = Path(tempfile.mkdtemp(prefix="uoarm-fuzz-"))
    for place, seed in enumerate(one.seeds):
        (corpus / f"seed{place}").write_bytes(seed)
    prefix = findings / f"{re.sub('[^a-zA-Z]+', '-', name)}-"
    options = [
        f"-runs={runs}", f"-max_len={_LONGEST}", f"-timeout={_SECONDS_FOR_ONE}",
        f"-rss_limit_mb={_OCTETS}", f"-artifact_prefix={prefix}", "-print_final_stats=1", "-seed=1",
    ]  # fmt: skip

    def try_one(data: bytes) -> None:
        one.run(data)

    atheris.Setup([sys.argv[0], *options, str(corpus)], try_one)
    atheris.Fuzz()


def _search_blindly(name: str, runs: int, findings: Path) -> Outcome:
    from hypothesis import HealthCheck, given, settings, target
    from tests.fuzz.targets import TARGETS
    from tests.fuzz.test_decoders import inputs

    one, done = TARGETS[name], 0

    @settings(
        max_examples=runs,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(inputs(one.seeds))
    def search(data: bytes) -> None:
        nonlocal done
        done += 1
        failing[:] = [data]
        target(float(one.run(data)))
        failing.clear()

    failing: list[bytes] = []
    started = time.perf_counter()
    problems: tuple[str, ...] = ()
    try:
        search()
    except Exception as error:  # noqa: BLE001 - the search goes on with the other decoders
        findings.mkdir(parents=True, exist_ok=True)
        kept = findings / f"{re.sub('[^a-zA-Z]+', '-', name)}-found"
        with contextlib.suppress(IndexError):
            kept.write_bytes(failing[0])
        problems = (f"{kept}: {type(error).__name__}: {str(error)[:200]}",)
    return Outcome(done, time.perf_counter() - started, "-", problems)


if __name__ == "__main__":
    sys.exit(main())
