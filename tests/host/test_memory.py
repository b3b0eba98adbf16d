"""A host that may have so much memory and no more."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from tests.host import hosted
from tests.host.hosted import Events, at
from tests.processes import lives

from uoarm.errors import BridgeError
from uoarm.model import Health, Role
from uoarm.testing import patience, slowness, wait

pytestmark = [
    pytest.mark.usefixtures("nothing_is_left"),
    pytest.mark.skipif(sys.platform != "linux", reason="the kernel's limit is Linux's"),
]


def test_a_component_that_asks_for_too_much_gets_an_error_and_the_host_goes_on(
    tmp_path: Path,
) -> None:
    bridge = hosted.bridge(tmp_path, memory="512 MiB")
    assert bridge.call(at("grow", Role.SERVICE), 100) == 1
    with pytest.raises(BridgeError, match="MemoryError"):
        bridge.call(at("grow", Role.SERVICE), 450)
    assert bridge.call(at("double", Role.SERVICE), 2) == 4
    bridge.close()


def test_a_host_that_leaks_till_it_can_do_nothing_is_ended(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path, memory="256 MiB", silence=6 * slowness())
    process, events = bridge.process, Events()
    bridge.watch(events)
    with pytest.raises(BridgeError):
        bridge.call(at("leak", Role.SERVICE), 20, timeout=patience())
    wait(lambda: any(health_event.health is Health.LOST for health_event in events.all))
    with pytest.raises(BridgeError, match=r"is dead|256 MiB"):
        bridge.call(at("double", Role.SERVICE), 2)
    bridge.close()
    wait(lambda: not lives(process))


def test_a_host_that_cannot_start_within_its_memory_says_so(tmp_path: Path) -> None:
    with pytest.raises(BridgeError, match="it might have 1 MiB of memory"):
        hosted.bridge(tmp_path, memory="1 MiB")


def test_a_host_keeps_the_memory_of_large_messages(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    try:
        environment = Path(f"/proc/{bridge.process}/environ").read_bytes()
        interval = bridge.call(at("turns", Role.SERVICE), 0)
    finally:
        bridge.close()
    variables = {*environment.split(b"\0")}
    assert {b"MALLOC_MMAP_THRESHOLD_=33554432", b"MALLOC_TRIM_THRESHOLD_=268435456"} <= variables
    assert interval == pytest.approx(0.0005)
