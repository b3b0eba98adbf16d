"""The process's ORB: idle connections, and an end that a delivery holds up."""

from __future__ import annotations

import subprocess
import sys
import threading
from typing import Any

import omniORB
import pytest
from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA
from uoarm_rtm import _orb
from uoarm_rtm._orb import Orb, deliveries

from uoarm.errors import BridgeError, FailureReason
from uoarm.testing import Background, ResourceSnapshot, patience, wait

PUSHES = """
import sys, threading
from omniORB import CORBA
from _uoarm_rtm_stubs import OpenRTM
orb = CORBA.ORB_init(["peer", "-ORBoutConScanPeriod", "0"], CORBA.ORB_ID)
inlet = orb.string_to_object(sys.argv[1])._narrow(OpenRTM.InPortCdr)
print("ready", flush=True)
for count in sys.stdin:
    pushing = [threading.Thread(target=inlet.put, args=(b"",)) for _ in range(int(count))]
    for thread in pushing:
        thread.start()
    for thread in pushing:
        thread.join()
    print("put", flush=True)
"""


class Inlet(OpenRTM__POA.InPortCdr):  # type: ignore[misc]  # generated, without annotations
    """Takes messages, as many at once as the barrier says."""

    def __init__(self) -> None:
        self.together = threading.Barrier(1)

    def put(self, data: bytes) -> Any:
        with deliveries:
            self.together.wait(patience())
        return OpenRTM.PORT_OK


class Pusher:
    """A process that pushes, and keeps the connections that it has opened."""

    def __init__(self, reference: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", PUSHES, reference],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._line() == "ready\n"

    def push(self, count: int) -> None:
        self.begin(count)
        assert self._line() == "put\n"

    def begin(self, count: int) -> None:
        assert self.process.stdin is not None
        print(count, file=self.process.stdin, flush=True)

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()


def test_connections_that_a_peer_leaves_idle_go_with_their_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_orb, "_IDLE_SECONDS", "1")
    monkeypatch.setenv("ORBscanGranularity", "1")
    assert _orb._shared.users == 0, "an ORB that is running already has another limit"
    orb, inlet = Orb("127.0.0.1", patience()), Inlet()
    pusher = Pusher(orb.text(orb.serve(inlet)))
    try:
        snapshot = ResourceSnapshot()
        inlet.together = threading.Barrier(3)
        pusher.push(3)
        assert _count_workers() > 1, "the peer has opened no second connection"
        snapshot.check()
        inlet.together = threading.Barrier(1)
        pusher.push(1)  # a connection that was closed is opened again
    finally:
        pusher.end()
        orb.close()


def test_the_last_close_does_not_wait_for_a_delivery_and_the_next_orb_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert _orb._shared.users == 0
    orb, inlet = Orb("127.0.0.1", patience()), Inlet()
    inlet.together = threading.Barrier(2)
    pusher = Pusher(orb.text(orb.serve(inlet)))
    try:
        pusher.begin(1)
        wait(lambda: inlet.together.n_waiting)
        monkeypatch.setattr(_orb, "_DESTROY_SECONDS", 2 * patience())
        Background(orb.close).result()
        monkeypatch.setattr(_orb, "_DESTROY_SECONDS", 0.1)
        with pytest.raises(BridgeError, match="the last one has not ended") as refused:
            Orb("127.0.0.1", patience())
        assert refused.value.reason is FailureReason.UNAVAILABLE
        inlet.together.wait(patience())
        monkeypatch.setattr(_orb, "_DESTROY_SECONDS", patience())
        Orb("127.0.0.1", patience()).close()
    finally:
        inlet.together.abort()
        pusher.end()


def _count_workers() -> int:
    return sum(isinstance(thread, omniORB.WorkerThread) for thread in threading.enumerate())
