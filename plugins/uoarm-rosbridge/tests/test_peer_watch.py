"""The thread that watches peers and silences waits for what is due next, and for nothing else."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
from uoarm_rosbridge.client import _health
from uoarm_rosbridge.client._channels import TopicSource, parameter

from uoarm.bridge import Channel, ChannelHealth, ChannelMonitor
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Health, Role
from uoarm.testing import wait


class Waits(threading.Event):
    """Notes for how long is waited."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds: list[float] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.seconds.append(-1.0 if timeout is None else timeout)
        return super().wait(timeout)


class Source(TopicSource):
    """A topic of which nothing comes."""

    def __init__(self, stale_after: float, reports: list[Health]) -> None:
        Channel.__init__(self, Endpoint("ros", "scan", Role.OUTPUT, ("/scan", "Scan")))
        health = ChannelHealth("/scan", time.monotonic(), stale_after=stale_after)
        health.connected(time.monotonic())
        self.health = ChannelMonitor(health, lambda health, _: reports.append(health))

    def _close(self) -> None: ...


def test_it_wakes_when_something_is_due_and_not_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threading, "Event", Waits)
    link: Any = SimpleNamespace(is_up=False)
    nothing: Any = None
    watch = _health.PeerWatch("ros", link, 3600.0, nothing, nothing, nothing)
    monkeypatch.undo()
    poked: Any = watch._poked
    reports: list[Health] = []
    patient, short = Source(1800.0, reports), Source(0.01, reports)
    try:
        wait(lambda: len(poked.seconds) == 1)
        assert poked.seconds[0] > 1800
        watch.keep(patient)
        wait(lambda: len(poked.seconds) == 2)
        assert 0 < poked.seconds[1] <= 1800
        watch.keep(short)
        wait(lambda: reports == [Health.LOST])
    finally:
        watch.close()
    patient.close()
    short.close()


@pytest.mark.parametrize("value", [[], {}, "[" * 100_000, "]"])
def test_a_parameter_that_cannot_be_read_says_so(value: object) -> None:
    link: Any = SimpleNamespace(rosapi=lambda _, **__: {"value": value})
    place = Endpoint("ros", "p", Role.OUTPUT, ("/p",))
    if isinstance(value, str):
        with pytest.raises(BridgeError, match="p"):
            parameter(link, place, "/p")
    else:
        assert parameter(link, place, "/p") == value


def test_an_answer_that_no_robot_gives_ends_no_watch() -> None:
    def peers(endpoint: Endpoint) -> frozenset[str]:
        if endpoint.component == "odd":
            raise TypeError("unhashable type: 'dict'")
        return frozenset({"/node"})

    link: Any = SimpleNamespace(is_up=True, ask_again=lambda: None)
    nothing: Any = None
    back: list[str] = []
    watch = _health.PeerWatch(
        "ros", link, 3600.0, peers, nothing, lambda *_, component: back.append(component)
    )
    try:
        for component in ("odd", "scan"):
            watch.remember(Endpoint("ros", component, Role.OUTPUT, ("/scan",)))
        watch.look_anew()
        wait(lambda: back == ["scan"])
        assert watch._thread.is_alive()
    finally:
        watch.close()
