"""Runs every tier of tests that this machine can run, and prints in a table what it ran.

    python -m tests.tiers [TIER ...]     run these tiers, or all that do not take hours
    python -m tests.tiers long           run those that do
    python -m tests.tiers --install      install what the tiers need, as far as it can be had

The exit status is 0 when no test failed and nothing is missing that automation (CI) must have.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from attrs import frozen
from tests.harness import SPARE_WORKERS
from tests.harness._delays import DELAYS
from tests.harness._needs import NEEDS, PLACES, missing

from uoarm.testing import slowness

ROOT = Path(__file__).parents[1]
REPORTS = ROOT / "build" / "tests"
NO_TESTS = 5
# As a tier begins, and while its last tests wait, the processor has time for another.
AT_ONCE = 2
LOOK_SECONDS = 0.1
# What takes long comes first, so that nothing of it is left to run alone at the end.
PLUGINS = (
    "ros2",
    "rtm",
    "ros1",
    "rocos",
    "mqtt",
    "vda5050",
    "rosbridge",
    "remote",
    "foxglove",
    "mcp",
)


@frozen
class Tier:
    """Tests that need the same.

    Attributes:
        name: under which it is asked for.
        what: what it is about, for the table.
        arguments: of pytest.
        needs: without which none of it can be run.
        is_long: whether it takes long, and is run only where it is asked for.
        is_late: whether its threads begin late and go on late, as on a busy machine.
        is_waiting: whether its tests wait for peers for more than half of their time.
        is_alone: whether no other tier runs meanwhile.
    """

    name: str
    what: str
    arguments: tuple[str, ...]
    needs: tuple[str, ...] = ()
    is_long: bool = False
    is_late: bool = False
    is_waiting: bool = False
    is_alone: bool = True

    def workers(self, is_beside: bool) -> str:
        """Return how many tests run at once, as pytest-xdist takes it."""
        many = self.is_waiting and not is_beside
        return str((os.cpu_count() or 1) + SPARE_WORKERS) if many else "auto"

    @property
    def variables(self) -> dict[str, str]:
        """Return those of the environment: each long run has an order, or delays, of its own."""
        number = str(time.time_ns())
        if self.is_late:
            return {DELAYS: number}
        long = {"HYPOTHESIS_PROFILE": "long", "UOARM_TEST_ORDER": number}
        return long if self.is_long else {}


SHORT, LONG = "not needs and not long", "not needs"
PROGRAMS, LONG_PROGRAMS = "needs and not long", "needs and long"
TIERS = (
    Tier("core", "nothing but .[dev]", ("tests", "-m", SHORT), is_waiting=True),
    Tier(
        "programs",
        "browser, Node.js, vision, the examples",
        (*PLACES, "-m", PROGRAMS),
        is_alone=False,
    ),
    *(
        Tier(
            name,
            f"plugins/uoarm-{name}",
            (f"plugins/uoarm-{name}/tests", "-m", "not long"),
            (name,),
            is_waiting=True,
            is_alone=False,
        )
        for name in PLUGINS
    ),
    Tier("long-core", "the core, its properties at length", ("tests", "-m", LONG), is_long=True),
    Tier(
        "late-core",
        "the core, its threads late",
        ("tests", "-m", SHORT),
        is_long=True,
        is_late=True,
    ),
    Tier("long-programs", "the programs at length", (*PLACES, "-m", LONG_PROGRAMS), is_long=True),
    *(
        Tier(
            f"{kind}-{name}",
            f"plugins/uoarm-{name} {what}",
            (f"plugins/uoarm-{name}/tests", *marks),
            (name,),
            is_long=True,
            is_late=kind == "late",
            is_waiting=True,
        )
        for kind, what, marks in (
            ("long", "at length", ()),
            ("late", "with its threads late", ("-m", "not long")),
        )
        for name in PLUGINS
    ),
)
BY_DEFAULT = tuple(tier.name for tier in TIERS if not tier.is_long)
NAMES = {
    **{tier.name: (tier.name,) for tier in TIERS},
    "long": tuple(tier.name for tier in TIERS if tier.is_long),
}
GROUPS = (
    "-e .[vision-lbph,vision-dlib]",
    "-e .[healthbot]",
    *(f"-e plugins/uoarm-{name}[dev]" for name in PLUGINS),
)


@frozen
class Outcome:
    """What became of a tier."""

    tier: Tier
    counts: Counter[str]
    seconds: float
    processor_seconds: float
    failed: bool
    reasons: Counter[str]


class Run:
    """A tier that runs, or cannot be run; what it writes is kept until it is shown."""

    def __init__(self, tier: Tier, is_beside: bool) -> None:
        self.tier = tier
        self.reasons = Counter(reason for name in tier.needs if (reason := missing(name)))
        self._is_shown = False
        self._begin, self._seconds, self._processor_seconds = time.monotonic(), 0.0, 0.0
        self._status: int | None = None
        REPORTS.mkdir(parents=True, exist_ok=True)
        self._report = REPORTS / f"{tier.name}.xml"
        self._report.unlink(missing_ok=True)
        output = REPORTS / f"{tier.name}.log"
        with output.open("wb") as written:
            if self.reasons:
                written.write("".join(f"{reason}\n" for reason in self.reasons).encode())
                self._process = None
            else:
                self._process = subprocess.Popen(
                    list(self._command(is_beside)),
                    cwd=ROOT,
                    env={**os.environ, **tier.variables},
                    stdout=written,
                    stderr=subprocess.STDOUT,
                )
        self._output = output.open("rb")

    def _command(self, is_beside: bool) -> Iterator[str]:
        yield from (sys.executable, "-m", "pytest", "-c", "pyproject.toml", "--rootdir=.")
        yield from (f"-n={self.tier.workers(is_beside)}", f"--junitxml={self._report}")
        if sys.stdout.isatty():
            yield "--color=yes"
        yield from self.tier.arguments

    def has_ended(self) -> bool:
        """Return whether its tests have; the processor time is that of all processes below it."""
        if self._process is not None and self._status is None:
            pid, status, used = os.wait4(self._process.pid, os.WNOHANG)
            if pid == 0:
                return False
            self._process.returncode = self._status = os.waitstatus_to_exitcode(status)
            self._seconds = time.monotonic() - self._begin
            self._processor_seconds = used.ru_utime + used.ru_stime
        return True

    def show(self) -> None:
        """Write what it has written since the last time."""
        if not self._is_shown:
            print(f"\n== {self.tier.name}: {self.tier.what}", flush=True)
            self._is_shown = True
        sys.stdout.buffer.write(self._output.read())
        sys.stdout.flush()

    def outcome(self) -> Outcome:
        """Return what became of it, once it has ended."""
        self._output.close()
        if self._process is None:
            must = os.environ.get("CI") and all(NEEDS[name].exists for name in self.tier.needs)
            return Outcome(self.tier, Counter(), 0.0, 0.0, bool(must), self.reasons)
        counts, reasons = read(self._report)
        failed = self._status not in {0, NO_TESTS}
        return Outcome(self.tier, counts, self._seconds, self._processor_seconds, failed, reasons)

    def close(self) -> None:
        """Kill it if it runs."""
        self._output.close()
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def run_all(tiers: Sequence[Tier]) -> list[Outcome]:
    """Run tiers, some beside each other, and show what each writes in one piece, in their order."""
    outcomes: list[Outcome] = []
    waiting, begun = deque(tiers), deque[Run]()
    beside = sum(not tier.is_alone for tier in tiers) > 1
    try:
        while waiting or begun:
            running = [run.tier for run in begun if not run.has_ended()]
            if waiting and _has_room(waiting[0], running):
                tier = waiting.popleft()
                begun.append(Run(tier, is_beside=beside and not tier.is_alone))
                continue
            has_ended = begun[0].has_ended()
            begun[0].show()
            if has_ended:
                outcomes.append(begun.popleft().outcome())
            else:
                time.sleep(LOOK_SECONDS)
    finally:
        for run in begun:
            run.close()
    return outcomes


def _has_room(tier: Tier, running: Sequence[Tier]) -> bool:
    return not running or (
        len(running) < AT_ONCE and not any(other.is_alone for other in (tier, *running))
    )


def read(report: Path) -> tuple[Counter[str], Counter[str]]:
    """Return how many tests ended how, and why some were skipped."""
    counts: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    if report.exists():
        for case in ET.parse(report).getroot().iter("testcase"):
            skipped = case.find("skipped")
            ended = {element.tag for element in case} & {"failure", "error"}
            if skipped is not None:
                # Of a whole module, the text alone has the reason: (file, line, 'Skipped: ...').
                whole = skipped.get("message") == "collection skipped"
                said = (skipped.text or "" if whole else skipped.get("message", "")).strip("()'\"")
                reasons[said.rpartition("Skipped: ")[2]] += 1
            counts["failed" if ended else "passed" if skipped is None else "skipped"] += 1
    return counts, reasons


def table(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """The lines of the closing table."""
    yield f"{'tier':<10}{'':<10}{'passed':>8}{'failed':>8}{'skipped':>8}{'seconds':>9}{'of CPU':>8}"
    for outcome in outcomes:
        ran = sum(outcome.counts.values())
        said = "FAILED" if outcome.failed else "ok" if ran else "not run"
        numbers = "".join(f"{outcome.counts[name]:>8}" for name in ("passed", "failed", "skipped"))
        seconds = f"{outcome.seconds:>9.0f}{outcome.processor_seconds:>8.0f}"
        yield f"{outcome.tier.name:<10}{said:<10}{numbers}{seconds}  {outcome.tier.what}"
    for outcome in outcomes:
        for reason, count in sorted(outcome.reasons.items()):
            times = f" ({count} tests)" if outcome.counts else ""
            yield f"  not run of {outcome.tier.name}{times}: {reason}"


def install() -> int:
    """Install what all tiers need; what cannot be had is left out, and said."""
    wanted = [group for group in GROUPS if _exists(group)]
    if not _pip(*wanted):
        for group in wanted:
            if not _pip(group):
                print(f"left out, as it could not be installed: {group}", flush=True)
    for group in set(GROUPS) - set(wanted):
        print(f"left out, as it is not there for this machine: {group}", flush=True)
    return 0


def _exists(group: str) -> bool:
    return all(need.exists for need in NEEDS.values() if group[3:] in need.get)


def _pip(*groups: str) -> bool:
    words = [word for group in groups for word in group.split(" ")]
    # The extra `server`, which plugins need for their tests, brings this one.
    ours = ["-e", ".[dev]", "-e", "plugins/uoarm-rosbridge"]
    command = [sys.executable, "-m", "pip", "install", "--quiet", *ours, *words]
    return subprocess.run(command, cwd=ROOT, check=False).returncode == 0


def main(arguments: Sequence[str]) -> int:
    """Run the command; returns the exit status."""
    if list(arguments) == ["--install"]:
        return install()
    if unknown := set(arguments) - NAMES.keys():
        print(f"no tiers {sorted(unknown)}; there are {sorted(NAMES)}", file=sys.stderr)
        return 2
    names = {name for given in arguments for name in NAMES[given]} or BY_DEFAULT
    slowness()  # before the first of them: what begins beside another would count that one, too
    outcomes = run_all([tier for tier in TIERS if tier.name in names])
    print("\n== what was run\n", *table(outcomes), sep="\n", flush=True)
    return int(any(outcome.failed for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
