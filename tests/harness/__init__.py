"""The harness of the tests, a plugin of pytest: isolation, leaks, limits, needs, parallel runs."""

from __future__ import annotations

import asyncio
import gc
import inspect
import itertools
import os
import random
import time
from collections.abc import Generator
from contextlib import ExitStack
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis.strategies import none
from tests.harness import _delays, _kit, _leaks, _limits, _needs, _places
from tests.harness._steps import longest_step, waits
from tests.profiles import IS_LONG
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

from uoarm.testing import patience, slowness
from uoarm.testing._waiting import default_limits

__all__ = ["Scheduler", "longest_step", "waits"]

# Now, as other conftests read the environment when they are imported.
_places.isolate()
_delays.begin()

# Half of the time a worker waits, for processes and for silence: so there are more of them than
# cores, by as many at most.
SPARE_WORKERS = 4
# One worker runs all tests of these, so that the scene is started, or what they share is built,
# once, and always as they stand, as parts of a scene are ended one after another.
TOGETHER = {
    "plugins/uoarm-ros1/tests/test_roscpp.py",
    "tests/examples/test_healthbot.py",
    "tests/examples/test_vision_components.py",
    "tests/harness/test_harness.py",
    "tests/packaging/test_distributions.py",
    "tests/test_layers.py",
}
# The last resort against a test that hangs where nothing limits its wait.
HANGING = 10
# Of a test that is a coroutine: its report shows where it hung.
_PATIENT = 3
# Processor time, which a busy machine does not lengthen, from which on a test is a long one.
LONG_SECONDS = 120.0
# Of the collector of garbage: from which time on what stays is left out of a look at everything.
LONG_LOOK_SECONDS = 0.02
OLDEST = 2
ORDER = "UOARM_TEST_ORDER"
_HELD = pytest.StashKey[_leaks.Holdings]()


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers", "needs(*what): programs, packages or data it cannot do without"
    )
    config.addinivalue_line(
        "markers", "keeps(*what): what a library that is first used in it never gives back"
    )
    config.addinivalue_line("markers", "long: runs with `make test-long` only")
    if config.option.timeout is None:
        config.option.timeout = HANGING * patience()
    limits = ExitStack()
    limits.enter_context(default_limits(patience(), closing=False))
    config.add_cleanup(limits.close)
    long_limits = _limits.LongLimits(patience())
    long_limits.install()
    config.add_cleanup(long_limits.remove)


def pytest_report_header() -> str:
    return f"slowness of this machine: {slowness():.1f}, so waits end after {patience():.0f} s"


class Unavailable(pytest.Module):
    """A module that is not imported, as something that it needs is not here or not asked for."""

    def collect(self) -> list[pytest.Item]:
        if _wants_no_needs(self.config):
            return []
        found = _needs.refused(_needs.of_module(_path(self.config, self.path)))
        assert found
        reason, outcome = found
        if outcome is pytest.fail:
            raise self.CollectError(reason)
        pytest.skip(reason, allow_module_level=True)


def _wants_no_needs(config: pytest.Config) -> bool:
    return "not needs" in config.option.markexpr


def pytest_pycollect_makemodule(
    module_path: Path, parent: pytest.Collector
) -> pytest.Module | None:
    needs = _needs.of_module(_path(parent.config, module_path))
    if not (needs and _wants_no_needs(parent.config)) and _needs.refused(needs) is None:
        return None
    module: pytest.Module = Unavailable.from_parent(parent, path=module_path)
    return module


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what modules need; with UOARM_TEST_ORDER=<number>, run in an order of that number."""
    for module, found in itertools.groupby(items, attrgetter("path")):
        path = _path(config, module)
        named = {"keeps": _needs.kept_by_module(path), "needs": _needs.of_module(path)}
        marks = [getattr(pytest.mark, name)(*given) for name, given in named.items() if given]
        tests = list(found)
        for item, mark in itertools.product(tests, marks):
            item.add_marker(mark)
        if _needs.is_astray(path) and any(item.get_closest_marker("needs") for item in tests):
            raise pytest.UsageError(f"{path} needs something, and is in none of {_needs.PLACES}")
    if seed := os.environ.get(ORDER):
        stand = iter([item for item in items if _is_together(item)])
        random.Random(seed).shuffle(items)
        items[:] = [next(stand) if _is_together(item) else item for item in items]


def _is_together(item: pytest.Item) -> bool:
    return item.nodeid.partition("::")[0] in TOGETHER


@pytest.hookimpl(specname="pytest_runtest_setup", tryfirst=True)
def pytest_runtest_setup_of_needs(item: pytest.Item) -> None:
    _needs.check(item)


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """Leave garbage alone while tests are collected: nearly all that is made then stays.

    With its first example Hypothesis collects garbage, and looks for what holds its random numbers:
    now, while that is little to look at, and nothing of it is left out yet.
    """
    settings(max_examples=1, database=None)(given(none())(lambda _: None))()
    gc.disable()


def pytest_collection_finish() -> None:
    """Freeze what collecting made: later collections of garbage leave out what stays anyway."""
    gc.collect()
    gc.freeze()
    gc.enable()


class _LongLooks:
    """Freezes all that stays after a test in which the collector's look at everything took long.

    A server lets go of what is frozen, and what tests import and keep is not frozen yet. The time
    shows both: to ask for the count of what is frozen takes 40 ms, as it goes over all of it.
    """

    def __init__(self) -> None:
        self._begin = 0.0
        self._is_long = False

    def __call__(self, phase: str, facts: dict[str, int]) -> None:
        if facts["generation"] < OLDEST:
            return
        if phase == "start":
            self._begin = time.thread_time()
        elif time.thread_time() - self._begin > LONG_LOOK_SECONDS:
            self._is_long = True

    def shorten(self) -> None:
        if self._is_long:
            gc.collect()  # what is frozen is never found to be garbage
            gc.freeze()
            self._is_long = False


_looks = _LongLooks()
gc.callbacks.append(_looks)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, None, None]:
    item.stash[_HELD] = _leaks.Holdings()
    with _leaks.maker(item.nodeid):
        yield


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    begin = time.process_time()
    with _leaks.maker(item.nodeid):
        yield
    spent = time.process_time() - begin
    # At length a property takes as long as its examples do.
    if spent > LONG_SECONDS and not (IS_LONG or item.get_closest_marker("long")):
        pytest.fail(
            f"{spent:.0f} s of processor time: make it less, or mark it long", pytrace=False
        )


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine, in a loop of its own."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = inspect.signature(pyfuncitem.obj).parameters
    test = pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names})
    asyncio.run(asyncio.wait_for(test, _PATIENT * patience()))
    return True


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
) -> Generator[None, object, object]:
    """What a fixture of several tests holds is no leak of the test that is the first to use it."""
    held = request.node.stash.get(_HELD, None) or request._pyfuncitem.stash.get(_HELD, None)
    if fixturedef.scope == "function" or held is None:
        return (yield)
    before = _leaks.Holdings()
    with _leaks.maker(f"fixture {fixturedef.argname}"):
        made = yield
    held.keep(before)
    return made


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, None, None]:
    with _leaks.maker(item.nodeid):
        yield
    held = item.stash.get(_HELD, None)
    if held is None:
        return
    del item.stash[_HELD]
    kept = tuple(str(what) for mark in item.iter_markers("keeps") for what in mark.args)
    left = held.left(item.nodeid, kept)
    _looks.shorten()
    if left:
        _leaks.end_processes(item.nodeid)
        pytest.fail(f"{item.nodeid} left behind:\n" + "\n".join(left), pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_report_to_serializable(
    report: pytest.CollectReport | pytest.TestReport,
) -> Generator[None, dict[str, Any] | None, dict[str, Any] | None]:
    """Leave out of a report what its reader does not use of a test that passed: its keywords."""
    data = yield
    if data is not None and "keywords" in data and report.passed:
        data["keywords"] = {}
    return data


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Fail a test of the conformance kit whose skip is in no table, or whose row is out of date."""
    del call
    report = yield
    if mistake := _kit.mistake_of(item, report):
        report.outcome, report.longrepr = "failed", f"{item.nodeid}: {mistake}"
    return report


def pytest_sessionfinish(session: pytest.Session) -> None:
    left = _leaks.processes_of()
    if left:
        _leaks.end_processes()
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        print(f"\nprocesses left behind by this run: {left}")  # noqa: T201 - after the reports


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_xdist_auto_num_workers() -> Generator[None, int, int]:
    """Answer `-n auto`, unless xdist's own variable of the environment does."""
    count = yield
    given = "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ
    return count if given else count + min(count, SPARE_WORKERS)


def _path(config: pytest.Config, path: Path) -> str:
    return (
        path.relative_to(config.rootpath).as_posix() if path.is_relative_to(config.rootpath) else ""
    )


class Scheduler(LoadScopeScheduling):  # type: ignore[misc]  # xdist has no types
    """Hands single tests to workers; those of a module that starts something big stay together.

    (xdist has a mark for that, which pytest 9.2 leaves without effect.)
    """

    def _split_scope(self, nodeid: str) -> str:
        module = nodeid.partition("::")[0]
        return module if module in TOGETHER else nodeid

    def mark_test_complete(
        self, node: WorkerController, item_index: int, duration: float = 0
    ) -> None:
        """Forget what is complete, which xdist goes over at the end of each test."""
        super().mark_test_complete(node, item_index, duration)
        scope = self._split_scope(self.registered_collections[node][item_index])
        work = self.assigned_work[node]
        if all(work[scope].values()):
            del work[scope]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Scheduler | None:
    return Scheduler(config, log) if config.getvalue("dist") == "load" else None
