"""What a viewer moves: from its first message on, until it goes and gives its leases back."""

from __future__ import annotations

import json
import threading
from collections.abc import Collection, Iterator
from typing import Any

import pytest
from tests.leases import lease, leased_robot  # type: ignore[import-not-found]
from uoarm_foxglove._catalogue import ChannelCatalogue, ListingAnswer, ListingQuestion
from viewer import Viewer

from uoarm import RobotManager
from uoarm.server import Limits, ServerOptions, serve_in_thread
from uoarm.testing import MemoryBridge, Taker, patience, wait

SPEED = {"type": "object", "properties": {"v": {"type": "integer"}}, "required": ["v"]}


@pytest.fixture
def memory() -> MemoryBridge:
    return MemoryBridge()


@pytest.fixture
def base(memory: MemoryBridge) -> Taker:
    return memory.taker("base", SPEED)


@pytest.fixture
def robot(memory: MemoryBridge, base: Taker) -> Iterator[RobotManager]:
    del base
    gone = "gone: {components: [{name: gone, bridge: memory, input: {endpoint: [gone]}}]}"
    with leased_robot(memory, stop="{v: 0}", more=gone) as robot:
        yield robot


@pytest.fixture
def listed(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Hold back all listings until it is set."""
    listed = threading.Event()
    make = ChannelCatalogue.make

    def late(
        self: ChannelCatalogue, questions: Collection[ListingQuestion]
    ) -> dict[ListingQuestion, ListingAnswer]:
        listed.wait(patience())
        return make(self, questions)

    monkeypatch.setattr(ChannelCatalogue, "make", late)
    yield listed
    listed.set()


@pytest.mark.parametrize("ending", ["it unadvertises", "it goes"])
def test_what_a_viewer_moved_stops_as_it_ends(
    robot: RobotManager, base: Taker, ending: str
) -> None:
    def taken() -> list[Any]:
        return [message["v"] for message in base.taken.messages]

    def advertise(viewer: Viewer) -> None:
        viewer.send("advertise", channels=[{"id": 1, "topic": "/drive", "encoding": "json"}])

    with (
        robot.request("drive"),
        serve_in_thread(robot, ServerOptions(port=0)) as server,
        Viewer(server) as second,
    ):
        advertise(second)
        with Viewer(server) as first:
            advertise(first)
            first.publish(1, json.dumps({"v": 1}).encode())
            wait(lambda: taken() == [1], "the command did not arrive")
            assert lease(robot).holder is not None
            if ending == "it unadvertises":
                first.send("unadvertise", channelIds=[1])
                wait(lambda: lease(robot).holder is None, "its lease was not given back")
        wait(lambda: lease(robot).holder is None, "its lease was not given back")
        wait(lambda: taken() == [1, 0], "what it moved was not stopped")
        second.publish(1, json.dumps({"v": 2}).encode())
        wait(lambda: taken() == [1, 0, 2], "another cannot command it")


def test_what_a_viewer_does_before_its_first_listing_waits_for_it(
    robot: RobotManager, base: Taker, listed: threading.Event
) -> None:
    """As one does that connects again: it advertises and publishes at once."""
    with serve_in_thread(robot, ServerOptions(port=0)) as server, Viewer(server) as viewer:
        viewer.send("advertise", channels=[{"id": 1, "topic": "/drive", "encoding": "json"}])
        for number in (1, 2):
            viewer.publish(1, json.dumps({"v": number}).encode())
        assert viewer.socket.ping().wait(patience())
        listed.set()
        wait(lambda: len(base.taken.messages) == 2, "what was published early did not arrive")
        assert [message["v"] for message in base.taken.messages] == [1, 2]


def test_what_a_viewer_withdrew_fails_without_the_next_of_its_number(
    robot: RobotManager, base: Taker, listed: threading.Event
) -> None:
    with serve_in_thread(robot, ServerOptions(port=0)) as server, Viewer(server) as viewer:
        viewer.send("advertise", channels=[{"id": 1, "topic": "/gone", "encoding": "json"}])
        viewer.publish(1, b'{"v": 1}')
        viewer.send("unadvertise", channelIds=[1])
        viewer.send("advertise", channels=[{"id": 1, "topic": "/drive", "encoding": "json"}])
        assert viewer.socket.ping().wait(patience())
        listed.set()
        assert "no component at ['gone']" in viewer.until("status")["message"]
        viewer.publish(1, b'{"v": 2}')
        wait(lambda: len(base.taken.messages) == 1, "the next one takes nothing")


def test_no_more_waits_for_the_first_listing_than_may(
    robot: RobotManager, listed: threading.Event
) -> None:
    options = ServerOptions(port=0, limits=Limits(queue_messages=2))
    with serve_in_thread(robot, options) as server, Viewer(server) as viewer:
        for _ in range(3):
            viewer.send("subscribeConnectionGraph")
        assert "2 messages wait for the first listing" in viewer.until("status")["message"]
        listed.set()
