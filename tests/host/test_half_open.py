"""A link that stays open and carries nothing any more: the socket lives, no frame arrives."""

from __future__ import annotations

import select
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.host import hosted
from tests.host.hosted import ANY, Events, at
from tests.processes import lives

from uoarm._host import process_connection
from uoarm._host.transport.frames import LinkSockets
from uoarm.errors import BridgeError
from uoarm.model import Health, Role
from uoarm.testing import patience, slowness, wait

pytestmark = pytest.mark.usefixtures("nothing_is_left")


class Middleman:
    """Stands between a host and its manager; passes everything on until it is to stall.

    Attributes:
        near: where the manager is to be connected.
        far: where the host is.
    """

    def __init__(self) -> None:
        self._stall = threading.Event()
        self._stalled = threading.Event()
        self._ended = threading.Event()
        self.near, manager = LinkSockets.make()
        self.far, host = LinkSockets.make()
        self._ends = {
            host.requests: manager.requests,
            manager.requests: host.requests,
            host.incoming: manager.outgoing,
            manager.incoming: host.outgoing,
        }
        self._thread = threading.Thread(target=self._run, name="middleman")
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.is_set():
            readable = [] if self._stall.is_set() else list(self._ends)
            if not readable:
                self._stalled.set()
            for socket in select.select(readable, [], [], 0.02)[0]:
                octets = socket.recv(65536)
                if not octets:
                    return self._close()
                self._ends[socket].sendall(octets)
        return self._close()

    def _close(self) -> None:
        for socket in (*self._ends, *self._ends.values()):
            socket.close()

    def stall(self) -> None:
        """Carry nothing from now on."""
        self._stall.set()
        assert self._stalled.wait(patience())

    def go_on(self) -> None:
        self._stall.clear()

    def end(self) -> None:
        self._ended.set()
        self._thread.join()


@pytest.fixture
def middlemen(monkeypatch: pytest.MonkeyPatch, nothing_is_left: None) -> Iterator[list[Middleman]]:
    """Have every host connected to a middleman."""
    made: list[Middleman] = []

    def detour() -> tuple[LinkSockets, LinkSockets]:
        made.append(Middleman())
        return made[-1].near, made[-1].far

    monkeypatch.setattr(process_connection, "LinkSockets", SimpleNamespace(make=detour))
    yield made
    for middleman in made:
        middleman.end()


def test_a_link_that_carries_nothing_is_given_up_and_what_it_held_is_counted(
    middlemen: list[Middleman], tmp_path: Path
) -> None:
    bridge = hosted.bridge(tmp_path)
    process, events, got = bridge.process, Events(), list[int]()
    bridge.watch(events)
    source = bridge.open_source(at("forever"), ANY, got.append)
    sink = bridge.open_sink(at("double", Role.INPUT), ANY)
    sink.send(1)
    wait(lambda: len(got) > 10 and sink.facts()["under_way"] == 0)
    middlemen[0].stall()
    for number in range(5):
        sink.send(number)
    # Nothing of what it goes on to send arrives, and its count crosses in shared memory. It stops
    # at a full window, where it may have been since before this is looked at.
    wait(lambda: source.facts()["under_way"] > 10)  # type: ignore[operator] # an int
    hosted.hasten(bridge, slowness())
    wait(lambda: any(health_event.health is Health.LOST for health_event in events.all))
    assert "has not answered" in events.all[-1].cause
    with pytest.raises(BridgeError, match="died"):
        sink.send(1)
    assert sink.facts()["under_way"] == 5
    held = source.facts()["under_way"]
    assert isinstance(held, int)
    assert held > 10
    assert got == list(range(len(got)))
    bridge.close()
    wait(lambda: not lives(process))


def test_a_link_that_stalls_for_a_moment_goes_on_and_counts_what_it_dropped(
    middlemen: list[Middleman], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hosted.doubt_soon(monkeypatch)
    bridge = hosted.bridge(tmp_path, variables={})
    events, got = Events(), list[int]()
    bridge.watch(events)
    source = bridge.open_source(at("forever"), ANY, got.append)
    wait(lambda: len(got) > 10)
    middlemen[0].stall()
    wait(lambda: events.all)
    assert events.all[0].health is Health.DEGRADED
    wait(lambda: source.facts()["under_way"] > 100)  # type: ignore[operator] # more than a window
    middlemen[0].go_on()
    seen = len(got)
    wait(lambda: len(got) > seen + 100)

    def missing() -> int:
        so_far = list(got)
        return so_far[-1] + 1 - len(so_far)

    # It goes on sending, and where its process gets no time it may lose more just now.
    wait(lambda: 0 < missing() == source.facts()["lost_on_link"])
    bridge.close()
    assert len(set(got)) == len(got)
