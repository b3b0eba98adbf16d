"""What `/metrics` says of components, bridges and channels."""

from __future__ import annotations

import sys
import threading
from itertools import repeat

import pytest
from prometheus_client import CollectorRegistry, generate_latest

from uoarm.model import (
    BridgeStatus,
    ChannelStatus,
    ComponentStatus,
    ConnectionState,
    ConnectionStatus,
    Health,
    MachineStatus,
    OfferState,
    OfferStatus,
    RouteStatus,
    StatusMap,
)
from uoarm.server.http._metrics import status_metrics, thread_metrics
from uoarm.testing import patience, wait

STATUS = StatusMap(
    bridges=(
        BridgeStatus("ros", "ros2", Health.LOST, 0, facts=(("empty_turns", 3), ("peer", "cam7"))),
    ),
    components=(
        ComponentStatus(
            "cam",
            "camera",
            "ros",
            Health.DEGRADED,
            ("c1",),
            channels=(
                ChannelStatus(
                    "output.default",
                    (("lost_on_link", 4), ("matched", True), ("latency", 0.5), ("peer", "cam7")),
                    4,
                ),
            ),
            failed=7,
        ),
    ),
    connections=(ConnectionStatus("c1", "camera", ConnectionState.RUNNING, ("cam",)),),
    deaths=(("cam", 2),),
    takeovers=(("camera", 1),),
    routes=(RouteStatus("cam.default", "c1", 9, 6, (("invalid", 2),), 3, copies=1),),
    offers=(OfferStatus("net:camera", "camera", "net", OfferState.FAILED, calls=5, failed=2),),
    machines=(
        MachineStatus("base", True, ("arm",), 0.25, 0.01),
        MachineStatus("desk", False, ("lamp",), cause="it has not joined"),
    ),
    held=1.5,
)


class _Collector:
    def collect(self) -> object:
        return status_metrics(STATUS)


def test_health_failures_and_facts_of_channels_are_figures() -> None:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Collector())  # type: ignore[arg-type] # it has what is used of one
    lines = generate_latest(registry).decode().splitlines()
    assert {
        'uoarm_bridge_health{bridge="ros",health="lost"} 1.0',
        'uoarm_bridge_fact{bridge="ros",fact="empty_turns"} 3.0',
        'uoarm_component_health{component="cam",function="camera",health="degraded"} 1.0',
        'uoarm_component_failed_total{component="cam",function="camera"} 7.0',
        'uoarm_component_deaths_total{component="cam"} 2.0',
        'uoarm_takeovers_total{function="camera"} 1.0',
        'uoarm_connections{state="running"} 1.0',
        'uoarm_route_received_total{consumer="c1",producer="cam.default"} 9.0',
        'uoarm_route_delivered_total{consumer="c1",producer="cam.default"} 6.0',
        'uoarm_route_dropped_total{consumer="c1",producer="cam.default",reason="invalid"} 2.0',
        'uoarm_route_invalid_total{consumer="c1",producer="cam.default"} 3.0',
        'uoarm_route_copies_total{consumer="c1",producer="cam.default"} 1.0',
        'uoarm_offer_state{function="camera",offer="net:camera",state="failed"} 1.0',
        'uoarm_offer_calls_total{function="camera",offer="net:camera"} 5.0',
        'uoarm_offer_failed_total{function="camera",offer="net:camera"} 2.0',
        'uoarm_machine_present{machine="base"} 1.0',
        'uoarm_machine_present{machine="desk"} 0.0',
        'uoarm_machine_clock_offset_seconds{machine="base"} 0.25',
        "uoarm_emergency_stop 1.0",
        "uoarm_lock_differences 0.0",
        'uoarm_channel_lost_total{component="cam",port="output.default"} 4.0',
        'uoarm_channel_fact{component="cam",fact="latency",port="output.default"} 0.5',
        'uoarm_channel_fact{component="cam",fact="matched",port="output.default"} 1.0',
    } <= set(lines)
    assert "cam7" not in "".join(lines), "only numbers are figures"


@pytest.mark.skipif(sys.platform != "linux", reason="needs the clocks of Linux's threads")
def test_a_thread_that_turns_for_nothing_shows() -> None:
    over = threading.Event()
    waits = threading.Thread(target=over.wait, args=(patience(),), name="waits")
    turns = threading.Thread(target=lambda: all(not over.is_set() for _ in repeat(None)))
    turns.name = "turns"
    for thread in (waits, turns):
        thread.start()

    def seconds() -> dict[str, float]:
        return {sample.labels["thread"]: sample.value for sample in thread_metrics().samples}

    try:
        wait(lambda: seconds()["turns"] > 0.5)
        assert seconds()["waits"] < 0.1
    finally:
        over.set()
        for thread in (waits, turns):
            thread.join(patience())
    assert not {"turns", "waits"} & seconds().keys()
