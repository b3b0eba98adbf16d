"""A cable that is pulled and put back, in network namespaces that the test makes itself."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.cables import Cable, laid_cable
from tests.host.joined import Joined, robot

from uoarm import RobotManager
from uoarm.model import ConnectionState, Health, QueuePolicy, StatusEvent
from uoarm.testing import free_port, patience, slowness, wait

SILENCE = 10 * slowness()  # no end is starved for so long before the cable is cut


@pytest.fixture
def cable() -> Iterator[Cable]:
    with laid_cable() as made:
        yield made


class EventLog:
    """What a manager reports, and when: a listener gets a change after it is in the status."""

    def __init__(self, manager: RobotManager) -> None:
        self.all: list[tuple[float, StatusEvent]] = []
        manager.listen(lambda event: self.all.append((time.monotonic(), event)))

    def has(self, subject: str, change: str, *, after: float) -> bool:
        """Say whether there was such an event after a time."""
        return any(
            at > after and (event.subject, event.change) == (subject, change)
            for at, event in self.all
        )


def _host(cable: Cable, folder: Path, port: int, *more: str, patient: bool = True) -> Joined:
    return Joined(
        folder,
        f"tls/{cable.here}:{port}",
        *more,
        within=["ip", "netns", "exec", cable.namespace],
        patient=patient,
    )


def test_a_cut_link_is_noticed_and_another_takes_over_until_it_heals(
    tmp_path: Path, cable: Cable
) -> None:
    port = free_port()
    file = robot(
        tmp_path,
        port,
        address=cable.here,
        spare=True,
        failover="{return_after: 0.2}",
        silence=SILENCE,
    )
    with (
        RobotManager.from_file(file) as manager,
        _host(cable, tmp_path, port, "--silence", str(SILENCE)) as host,
    ):
        log = EventLog(manager)
        connection = manager.request("ticks")
        assert connection.get(patience()) == 0
        cut = time.monotonic()
        cable.cut()
        wait(lambda: connection.gaps)
        assert connection.gaps[0].after == ("spare",)
        assert "machine 'arm'" in connection.gaps[0].cause
        wait(lambda: log.has("bridge far", Health.LOST.value, after=cut))
        wait(lambda: not manager.status().machines[0].present)
        assert manager.status().machines[0].cause == "waiting for its bridge far"
        wait(lambda: "bridge far is let go" in host.log)
        mended = time.monotonic()
        cable.mend()
        wait(lambda: len(connection.gaps) == 2)
        assert connection.gaps[1].after == ("ticker",)
        wait(lambda: log.has("bridge far", Health.OK.value, after=mended))
        assert connection.get(patience()) is not None
        assert connection.state is ConnectionState.RUNNING


def test_a_connection_without_another_candidate_waits_for_the_link_to_heal(
    tmp_path: Path, cable: Cable
) -> None:
    port = free_port()
    file = robot(tmp_path, port, address=cable.here, failover="{wait: 100}", silence=SILENCE)
    with (
        RobotManager.from_file(file) as manager,
        _host(cable, tmp_path, port, "--silence", str(SILENCE)),
    ):
        log = EventLog(manager)
        # None is read while the cable is cut, and the component begins anew when it is mended.
        connection = manager.request("ticks", queue=QueuePolicy(length=100_000))
        assert connection.get(patience()) == 0
        cut = time.monotonic()
        cable.cut()
        wait(lambda: log.has("bridge far", Health.LOST.value, after=cut))
        wait(lambda: connection.state is ConnectionState.WAITING)
        assert "machine 'arm'" in connection.cause
        cable.mend()
        wait(lambda: connection.gaps)
        (gap,) = connection.gaps
        assert gap.before == gap.after == ("ticker",)
        assert gap.seconds > 0
        numbers = list(
            iter(lambda: connection.get(patience()), 0)
        )  # until the component begins anew
        assert numbers == list(range(1, len(numbers) + 1))  # what came before the cut is whole
        assert gap.position == 1 + len(numbers)


def test_what_a_short_cut_loses_is_counted_and_nothing_else_happens(
    tmp_path: Path, cable: Cable
) -> None:
    port = free_port()
    file = robot(tmp_path, port, address=cable.here, silence=30.0)
    with (
        RobotManager.from_file(file) as manager,
        _host(cable, tmp_path, port, "--silence", "30", patient=False) as host,
    ):
        connection = manager.request("ticks", queue=QueuePolicy(length=100_000))
        got = [connection.get(patience())]
        cable.cut()
        wait(lambda: "a message is lost" in host.log)  # the window was full for a second
        cable.mend()
        while len(got) < 300 or got[-1] - got[-100] > 99:  # until nothing is missing any more
            got.append(connection.get(patience()))
        missing = got[-1] - got[0] + 1 - len(got)
        assert missing > 0
        ((channel,),) = (component.channels for component in manager.status().components)
        assert dict(channel.facts)["lost_on_link"] == missing
        assert got == sorted(got)
        assert not connection.gaps


def test_two_cables_at_once_are_two(cable: Cable) -> None:
    other = Cable()
    try:
        assert other.lay() == ""
        for item in (cable, other):
            with socket.create_server((item.here, 0)) as server:
                port = server.getsockname()[1]
                call = f"import socket; socket.create_connection(('{item.here}', {port}), 60)"
                within = ["ip", "netns", "exec", item.namespace]
                subprocess.run([*within, sys.executable, "-c", call], check=True)
    finally:
        other.remove()
