"""The process's ORB: idle connections, and an end that a delivery holds up."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import omniORB
import pytest
from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA
from tests.no_threads import no_threads  # type: ignore[import-not-found]
from tests.processes import ForkedProgram, run_python  # type: ignore[import-not-found]
from uoarm_rtm import _orb
from uoarm_rtm._orb import Orb, deliveries
from uoarm_rtm.nameserver import NameServer

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason
from uoarm.testing import Background, patience, wait

PUSHES = """
import sys, threading
import omniORB
from omniORB import CORBA
from _uoarm_rtm_stubs import OpenRTM
orb = CORBA.ORB_init(["peer", "-ORBscanGranularity", "1", *sys.argv[2:]], CORBA.ORB_ID)
inlet = orb.string_to_object(sys.argv[1])._narrow(OpenRTM.InPortCdr)
omniORB.setClientCallTimeout(inlet, 600_000)  # with a limit omniORB does not call again by itself
print("ready", flush=True)
def put():
    try:
        inlet.put(b"")
    except CORBA.Exception as error:
        print("failed", error, flush=True)
    else:
        print("put", flush=True)
for count in sys.stdin:
    pushing = [threading.Thread(target=put) for _ in range(int(count))]
    for thread in pushing:
        thread.start()
    for thread in pushing:
        thread.join()
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
    """A process that pushes, and closes the connections that it has opened after some seconds."""

    def __init__(self, reference: str, idle_seconds: int) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", PUSHES, reference, "-ORBoutConScanPeriod", str(idle_seconds)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._line() == "ready\n"

    def push(self, count: int) -> None:
        self.begin(count)
        self.done(count)

    def begin(self, count: int) -> None:
        assert self.process.stdin is not None
        print(count, file=self.process.stdin, flush=True)

    def done(self, count: int) -> None:
        for _ in range(count):
            assert self._line() == "put\n"

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()


def test_idle_connections_are_closed_by_the_peer_that_opened_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One that our side closes costs the peer its next message, and so a component its port."""
    monkeypatch.setattr(_orb, "_IDLE_SECONDS", "1")  # of those that we open
    monkeypatch.setenv("ORBscanGranularity", "1")
    assert _orb._shared.users == 0, "an ORB that is running already has another limit"
    orb, inlet = Orb("127.0.0.1", patience()), Inlet()
    reference = orb.text(orb.serve(inlet))
    pushers = keeps, closes = Pusher(reference, 0), Pusher(reference, 3)
    try:
        before = _count_sockets()
        keeps.push(1)
        closes.push(1)
        inlet.together = threading.Barrier(3)
        closes.begin(2)
        wait(lambda: inlet.together.n_waiting == 2)
        assert _count_sockets() == before + 3, "the peer has opened no second connection"
        inlet.together.wait(patience())
        closes.done(2)
        wait(lambda: _count_sockets() <= before + 1)
        inlet.together = threading.Barrier(1)
        keeps.push(1)  # idle for longer than any limit of ours
        keeps.end()
        wait(lambda: _count_sockets() == before)
        closes.push(1)  # opens one again
    finally:
        for pusher in pushers:
            pusher.end()
        orb.close()


def test_the_last_close_does_not_wait_for_a_delivery_and_the_next_orb_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert _orb._shared.users == 0
    orb, inlet = Orb("127.0.0.1", patience()), Inlet()
    inlet.together = threading.Barrier(2)
    pusher = Pusher(orb.text(orb.serve(inlet)), 0)
    try:
        pusher.begin(1)
        wait(lambda: inlet.together.n_waiting)
        threads = threading.enumerate()
        assert omniORB.WorkerThread in map(type, threads)
        assert all(thread.is_alive() for thread in threads)
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


def test_a_call_that_did_not_come_back_in_time_is_not_waited_for_again() -> None:
    guard = _orb.CallGuard()
    with guard:
        assert not guard.end(0.0)
        assert not Background(lambda: guard.end(2 * patience())).result()
    assert guard.end(0.0)


@pytest.mark.parametrize("kind", ["end", "watch"])
def test_a_bridge_for_which_there_is_no_thread_leaves_no_orb(
    kind: str, make_bridge: Callable[..., Bridge]
) -> None:
    assert _orb._shared.users == 0
    with no_threads(f"uoarm-rtm-{kind}"), pytest.raises(BridgeError, match="thread"):
        make_bridge()
    assert _orb._shared.users == 0
    bridge = make_bridge()
    running = _orb._shared.running
    assert running is not None
    assert running.ending is not None, "it is taken for the application's own"
    with no_threads(f"uoarm-rtm-{kind}"):
        bridge.close(timeout=patience())
    wait(lambda: omniORB.orb is None)


def test_a_naming_service_for_which_there_is_no_thread_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with no_threads("uoarm-rtm-names"), pytest.raises(BridgeError, match="start new thread"):
        NameServer()
    assert not list(tmp_path.iterdir())
    NameServer().close()


def test_a_bridge_closes_where_no_thread_is_left_for_its_servants(
    make_bridge: Callable[..., Bridge],
) -> None:
    first, _ = make_bridge("one"), make_bridge("two")
    shared: Any = first
    with no_threads():
        shared._orb.close()
    with pytest.raises(BridgeError):  # they are gone
        shared._orb.serve(Inlet())


def test_what_is_cut_are_connections_to_where_calls_went() -> None:
    orb, inlet = Orb("127.0.0.1", patience()), Inlet()
    reference = orb.text(orb.serve(inlet))
    place = _orb._address_of(reference)
    with (
        socket.create_server(("127.0.0.1", 0)) as another,
        socket.create_connection(another.getsockname()) as kept,
        socket.create_connection(place) as meant,
    ):
        orb.called(reference)
        _orb._cut(_orb._shared.called)
        meant.settimeout(patience())
        assert meant.recv(1) == b""
        accepted, _ = another.accept()
        with accepted:
            accepted.sendall(b"x")
        assert kept.recv(1) == b"x"
    orb.called("IOR:00")  # what is read no further
    orb.called("corbaloc::nowhere")
    orb.close()


def _count_sockets() -> int:
    count = 0
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # that of the listing itself
            count += str(descriptor.readlink()).startswith("socket:")
    return count


FORKED = """
from uoarm_rtm._orb import Orb

orb = Orb("127.0.0.1", 60.0)
print(orb._served._port, flush=True)
"""


def test_a_child_that_is_forked_serves_nothing_of_its_parent() -> None:
    """Who calls a component that died is refused, and does not wait for ever."""
    with ForkedProgram(FORKED) as forked:
        place = "127.0.0.1", int(forked.read())
        assert forked.read() == "forked"
        with socket.create_connection(place):
            forked.kill_parent()
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(place)


LIMITED = """
import os, socket
from uoarm_rtm._orb import Orb

near, far = socket.socketpair()
orb = Orb("127.0.0.1", 60.0)
socket.setdefaulttimeout(60)
if child := os.fork():
    os.waitpid(child, 0)
    print(os.get_blocking(near.fileno()), flush=True)
    orb.close()
else:
    os._exit(0)
"""


def test_a_child_that_is_forked_leaves_the_sockets_of_its_parent_as_they_are() -> None:
    assert run_python("-c", LIMITED).stdout == "True\n"
