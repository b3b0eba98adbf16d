"""The conformance kit is worth its name: each way of being a bad bridge makes a test of it fail."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import Phase, settings
from tests.processes import run_python
from tests.testing import test_memory_conformance as memory
from tests.testing.bad_bridges import BUGS, table
from tests.testing.bad_endings import RULED_OUT
from tests.testing.bad_worlds import BadWorld, Bug

from uoarm.errors import UoarmError
from uoarm.testing import patience
from uoarm.testing._waiting import default_limits
from uoarm.testing.conformance._world import PAGE, _naming, rule_of

ROOT = Path(__file__).parents[2]
NOTHING_COMES = 0.3  # seconds after which nothing comes of most bugs
HANGING = 5.0  # seconds until a bug that never ends is given up
LONGER = (1, 2, 4, 8, 16, 32, 64)  # times as long as that
CAUGHT = {bug.caught.__name__: bug for bug in BUGS}


@pytest.fixture(autouse=True)
def _as_found() -> Iterator[None]:
    """Leave an example that shows a bug as it was found: to make it smaller takes most time."""
    usual = os.environ.get("HYPOTHESIS_PROFILE", "short")
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile("as-found", settings.get_profile(usual), phases=phases)
    settings.load_profile("as-found")
    yield
    settings.load_profile(usual)


def run(bug: Bug, world: memory.MemoryWorld, limit: float) -> None:
    """Run one test of the suite in a world, as pytest would, with a limit of each call."""
    bridge, spec = world.bridge(), world.spec()
    given = {
        "self": memory.TestMemoryBridge(),
        "world": world,
        "bridge": bridge,
        "kind": bug.pair,
        "served": world.served(),
        "spec": spec,
        "declared": world.registry().types[spec.plugin],
    }
    wanted = inspect.signature(bug.caught).parameters
    try:
        with default_limits(limit):
            bug.caught(**{name: given[name] for name in wanted})
    finally:
        world.close()
        with suppress(Exception):  # one of the bugs
            bridge.close()


def passes_without(bug: Bug, times: int) -> bool:
    """Whether it is the bug that is found out, and not that so short a time is over."""
    with suppress(AssertionError, UoarmError):
        run(bug, BadWorld(lambda *_: None, times * NOTHING_COMES), times * HANGING)
        return True
    return False


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name.replace(" ", "-"))
def test_a_bad_bridge_is_found_out(bug: Bug) -> None:
    for times in LONGER:  # on a machine that is starved the time is over before the bug shows
        with pytest.raises((AssertionError, UoarmError)) as caught:
            run(bug, BadWorld(bug.spoil, times * NOTHING_COMES), times * HANGING)
        text = str(caught.value)
        if bug.says in text and passes_without(bug, times):
            break
    else:
        pytest.fail(f"this is found out where the bug is and where it is not:\n{text}")
    assert isinstance(caught.value, AssertionError)
    assert f"the rule is: {rule_of(bug.caught)} ({PAGE}#" in text


@pytest.mark.parametrize("name", CAUGHT)
def test_a_good_bridge_passes_the_same_tests(name: str) -> None:
    run(CAUGHT[name], memory.MemoryWorld(), patience())


@pytest.mark.parametrize("bug", RULED_OUT, ids=lambda bug: bug.name.replace(" ", "-"))
def test_what_the_core_rules_out_is_no_bug(bug: Bug) -> None:
    run(bug, BadWorld(bug.spoil, patience()), patience())


def test_each_bug_is_one_of_its_own() -> None:
    assert len({bug.name for bug in BUGS}) == len(BUGS) >= 40


def test_the_page_has_the_table() -> None:
    page = Path(__file__).with_name("bugs.md").read_text(encoding="utf-8")
    assert table() in page, f"put this into bugs.md:\n{table()}"


def test_the_sections_that_failures_name_are_on_the_page() -> None:
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    headings = {
        line.lstrip("# ").lower().replace(" ", "-")
        for line in text.splitlines()
        if line.startswith("## ")
    }
    assert {"the-steps", "reporting-what-happens", "the-declaration"} <= headings


def test_what_is_no_exception_is_named_with_its_kind() -> None:
    def test_a_rule() -> None:
        raise SystemExit(3)

    with pytest.raises(AssertionError, match=r"the rule is: a rule .*\nSystemExit: 3"):
        _naming(test_a_rule, "the-steps")()


SUITE = """
import threading
import pytest
from tests.testing.test_memory_conformance import BridgeConformance, MemoryWorld

class Raising(MemoryWorld):
    def create(self, name, options):
        made = super().create(name, options)
        opens = made._open_source
        def opened(*given):
            threading.Thread(target=lambda: 1 // 0).start()
            return opens(*given)
        made._open_source = opened
        return made

class TestRaising(BridgeConformance):
    kinds = ("byte",)

    @pytest.fixture
    def world(self):
        return Raising()
"""


def test_a_thread_that_ends_by_what_it_raises_is_a_failure(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / "test_raising.py").write_text(SUITE)
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "first_message_after_opening"]
    done = run_python(*words, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)})
    assert done.returncode == 1, done.stdout
    assert "PytestUnhandledThreadExceptionWarning" in done.stdout
    assert "ZeroDivisionError" in done.stdout
