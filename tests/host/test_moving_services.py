"""Services that move something, in a host: who gives a call up has the framework notified."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from uoarm._host import RemoteBridge
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm.model import BridgeSpec, Endpoint, Role, StopOutcome
from uoarm.testing import Background, patience, wait

PLUGIN = """
import threading
from pathlib import Path
from uoarm.bridge import Bridge, BridgeType, Capabilities, hookimpl
from uoarm.errors import BridgeError
from uoarm.model import StopOutcome

CALLS = Path(__file__).with_name("calls")

def note(what, number):
    with CALLS.open("a") as calls:
        calls.write(f"{what} {number}\\n")

class Arms(Bridge):
    capabilities = Capabilities(call=True, stop=True)

    def _open_source(self, *given):
        raise NotImplementedError

    _open_sink = _open_source

    def _call(self, endpoint, structures, message, timeout):
        over = threading.Event()

        def cancel():
            note("cancelled", message)
            over.set()

        with self.cancelling(cancel):
            note("called", message)
            over.wait(600)  # until it is cancelled: who calls gives up long before
        raise BridgeError("it was cancelled")

    def _stop_all(self, release, timeout):
        note("release" if release else "stop", "all")
        outcome = StopOutcome("reach", "arm", "default", stopped=False, cause="it is stuck")
        return () if release else (outcome,)

    def _close(self):
        pass

@hookimpl
def uoarm_bridge_types():
    return [BridgeType(name="arms", summary="arms", create=Arms, contract=2)]
"""
ARM = Endpoint("far", "arm", Role.SERVICE, ("arm",))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A distribution with a plugin, as an installation has it."""
    folder = tmp_path_factory.mktemp("arms")
    (folder / "arms_plugin.py").write_text(PLUGIN)
    about = folder / "arms_plugin-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: arms-plugin\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[uoarm.bridges]\narms = arms_plugin\n")
    return folder


@pytest.fixture(scope="module")
def arms(folder: Path) -> Iterator[RemoteBridge]:
    path = os.pathsep.join((str(folder), os.environ.get("PYTHONPATH", "")))
    patient = {"silence": patience(), "start": patience(), "variables": {"PYTHONPATH": path}}
    bridge = RemoteBridge(BridgeSpec("far", "arms", {}, patient))
    yield bridge
    bridge.close()


@pytest.fixture
def calls(folder: Path) -> Path:
    calls = folder / "calls"
    calls.write_text("")
    return calls


def call(arms: RemoteBridge, number: int) -> Background[object]:
    limit = 2 * patience()
    return Background(lambda: arms.call(ARM, number, timeout=limit, number=number))


def test_a_call_that_is_cancelled_is_so_in_the_framework_and_no_other(
    arms: RemoteBridge, calls: Path
) -> None:
    first, second = call(arms, 1), call(arms, 2)
    wait(lambda: set(calls.read_text().splitlines()) == {"called 1", "called 2"})
    assert arms.cancel_call(1)
    with pytest.raises(BridgeError, match="it was cancelled"):
        first.result()
    assert [line for line in calls.read_text().splitlines() if "cancelled" in line] == [
        "cancelled 1"
    ]
    assert arms.cancel_call(2)
    with pytest.raises(BridgeError, match="it was cancelled"):
        second.result()


def test_a_stop_of_everything_goes_through_the_host(arms: RemoteBridge, calls: Path) -> None:
    outcome = StopOutcome("reach", "arm", "default", stopped=False, cause="it is stuck")
    assert arms.stop_all(timeout=patience()) == (outcome,)
    assert arms.stop_all(release=True, timeout=patience()) == ()
    assert calls.read_text().splitlines() == ["stop all", "release all"]


def test_a_call_that_is_not_answered_in_time_is_cancelled_in_the_framework(
    arms: RemoteBridge, calls: Path
) -> None:
    limit = 0.05
    while "called 3" not in calls.read_text():  # its time may be over before it has begun
        limit *= 2
        with pytest.raises(BridgeTimeoutError):
            arms.call(ARM, 3, timeout=limit)
    wait(lambda: "cancelled 3" in calls.read_text())
