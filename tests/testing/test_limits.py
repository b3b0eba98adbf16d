"""Calls that are given no limit have that of the test, and only within it."""

from __future__ import annotations

import inspect
import os
import subprocess
from contextlib import ExitStack, closing

import pytest
from hypothesis import given
from hypothesis.strategies import floats, lists
from tests.testing.test_memory_conformance import MemoryWorld

from uoarm import RobotManager
from uoarm.bridge import Bridge, HealthEvent
from uoarm.errors import BridgeTimeoutError
from uoarm.model import Endpoint, Health, Role
from uoarm.testing import MemoryBridge, _resources, hanging, hold_idle, patience, wait
from uoarm.testing._resources import idle_share
from uoarm.testing._waiting import default_limits
from uoarm.testing.conformance._failures import HealthLog


def test_a_call_without_a_limit_has_the_one_around_it() -> None:
    bridge = MemoryBridge("one")
    bridge.emitter("camera", {"type": "integer"})
    endpoint = Endpoint("one", "camera", Role.OUTPUT, ("camera",))
    with hanging(bridge, "_describe"), default_limits(0.05):
        with pytest.raises(BridgeTimeoutError, match=r"within 0\.05 s"):
            bridge.describe(endpoint)
        with pytest.raises(BridgeTimeoutError, match=r"within 0\.02 s"):
            bridge.describe(endpoint, timeout=0.02)
    bridge.close()


@pytest.mark.parametrize("call", [Bridge.describe, Bridge.open_sink, RobotManager.call])
def test_in_all_tests_it_is_as_long_as_the_machine_is_slow(call: object) -> None:
    assert inspect.signature(call).parameters["timeout"].default == patience()  # type: ignore[arg-type]
    with default_limits(1.0):
        assert inspect.signature(call).parameters["timeout"].default == 1.0  # type: ignore[arg-type]
    assert inspect.signature(call).parameters["timeout"].default == patience()  # type: ignore[arg-type]


def test_nor_is_a_client_or_a_server_that_is_late_taken_for_gone() -> None:
    server, client = pytest.importorskip("uoarm.server"), pytest.importorskip("uoarm.client")
    asyncio_client = pytest.importorskip("websockets.asyncio.client")
    assert server.Limits().stall_seconds == patience()
    assert server.Limits().ping_seconds < patience()
    assert server.Limits(stall_seconds=1.0).stall_seconds == 1.0
    assert inspect.signature(client.connect).parameters["timeout"].default == patience()
    defaults = inspect.signature(asyncio_client.connect.__init__).parameters
    assert defaults["ping_timeout"].default == patience()


def test_a_wait_that_fails_shows_how_things_are_then() -> None:
    looks: list[None] = []
    with pytest.raises(AssertionError, match="1 look"):
        wait(lambda: looks.append(None), lambda: f"{len(looks)} look", timeout=0)
    with pytest.raises(AssertionError, match="never"):
        wait(lambda: False, "never", timeout=0)


def test_what_a_bridge_reported_while_the_kit_waited_is_shown() -> None:
    with closing(MemoryBridge("one")) as bridge:
        log = HealthLog(MemoryWorld(), bridge)
        log.patience = 0
        endpoint = Endpoint("one", "camera", Role.OUTPUT, ("camera",))
        bridge.report(Health.DEGRADED, "early")

        def looked_at(_: HealthEvent) -> bool:
            bridge.report(Health.LOST, "late")
            return False

        with pytest.raises(AssertionError, match="late"):
            log.wait(endpoint, None, looked_at)


def test_where_waking_is_expensive_what_waits_may_take_more() -> None:
    assert idle_share(1.0, [0.002] * 2) == pytest.approx(0.05)  # either may have been disturbed
    assert idle_share(1.0, [0.03, 0.002, 0.0001]) == pytest.approx(0.06)
    assert idle_share(1.0, [0.0015] * 3) == pytest.approx(0.2)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux says what threads want")
def test_a_loop_that_others_leave_little_time_turns_for_nothing_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_resources, "crowd", lambda: 8.0)
    loop, core = ["sh", "-c", "while :; do :; done"], {min(os.sched_getaffinity(0))}
    with ExitStack() as stack:
        # Each has a thirteenth of one core, and its turn several times in each look.
        for _ in range(13):
            process = stack.enter_context(subprocess.Popen(loop))
            stack.callback(process.kill)
            os.sched_setaffinity(process.pid, core)
        with pytest.raises(AssertionError, match="a loop turns for nothing here"):
            hold_idle("here", process.pid, timeout=2.0)


@given(slower=floats(1, 1000), wakes=lists(floats(0, 10)))
def test_a_loop_that_takes_all_it_gets_is_never_idle(slower: float, wakes: list[float]) -> None:
    assert 0.05 <= idle_share(slower, wakes) <= 0.35
