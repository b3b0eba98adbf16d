"""Threads that compute have short turns in commands, and turns as before in their callers."""

from __future__ import annotations

import sys
import threading

import click
import pytest
from click.testing import CliRunner

from uoarm._support.process_tuning import short_switch_interval, switch_interval_seconds
from uoarm._support.workers import WorkerPool
from uoarm.cli import main
from uoarm.errors import UsageError
from uoarm.testing import patience


@pytest.mark.parametrize(("given", "seconds"), [(None, 0.0005), ("", 0.0005), ("2.5", 0.0025)])
def test_a_command_runs_with_short_switch_interval_and_leaves_no_trace(
    given: str | None, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, during = sys.getswitchinterval(), []

    @click.command()
    def look() -> None:
        during.append(sys.getswitchinterval())

    monkeypatch.setitem(main.commands, "look", look)
    ran = CliRunner().invoke(main, ["look"], env={"UOARM_SWITCH_INTERVAL": given})
    assert ran.exit_code == 0, ran.output
    assert during == [pytest.approx(seconds)]
    assert sys.getswitchinterval() == before


@pytest.mark.parametrize("given", ["0.5", "4"])
def test_many_threads_have_longer_turns_in_our_own_processes_only(
    given: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hundred that wait for the lock, each half a millisecond, would leave it no time."""
    monkeypatch.setenv("UOARM_SWITCH_INTERVAL", given)
    before, gate = sys.getswitchinterval(), threading.Event()
    ended = threading.Semaphore(0)

    def intervals(threads: int) -> float:
        pool = WorkerPool("test", idle_seconds=0)
        for _ in range(threads):
            pool.submit(gate.wait, patience(), done=lambda *_: ended.release())
        return sys.getswitchinterval()

    try:
        assert intervals(100) == before
        with short_switch_interval():
            assert max(0.002, float(given) / 1000) <= intervals(1) < before
            assert intervals(300) == pytest.approx(0.005)
        assert intervals(1) == sys.getswitchinterval() == before
    finally:
        gate.set()
    for _ in range(402):
        assert ended.acquire(timeout=patience())


@pytest.mark.parametrize("given", ["fast", "0", "-1", "nan", "1e9"])
def test_another_text_is_refused_with_what_is_expected(
    given: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UOARM_SWITCH_INTERVAL", given)
    with pytest.raises(UsageError, match=r"UOARM_SWITCH_INTERVAL: expected milliseconds, 0\.01 to"):
        switch_interval_seconds()
    ran = CliRunner().invoke(main, ["bridges"])
    assert (ran.exit_code, "expected milliseconds" in ran.output) == (2, True)
