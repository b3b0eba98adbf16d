"""The bridge passes the suite that every bridge passes, against a real master and rospy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from peers import Master, Peer, running
from ros1_world import KINDS, Ros1World
from tests.harness._hosts import SharesHost, shared_host  # type: ignore[import-not-found]

from uoarm.bridge import Bridge
from uoarm.testing.conformance import BridgeConformance, World


class TestRos1Bridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(KINDS)
    paths = ("scalars", "echoed")

    @pytest.fixture
    def world(
        self, master: Master, lasting: Peer, tmp_path: Path, request: pytest.FixtureRequest
    ) -> Iterator[World]:
        # Of the kit's tests, those of one class break the world: they get a master to break.
        breaks = request.function.__qualname__.startswith("Breaking.")
        with running(tmp_path / "master") if breaks else nullcontext(master) as used:
            made = Ros1World(used, None if breaks else lasting)
            yield made
            made.close()


@pytest.fixture(scope="module")
def shared(master: Master, lasting: Peer) -> Iterator[Bridge]:
    with shared_host(Ros1World(master, lasting).spec()) as made:
        yield made


class TestInAHost(SharesHost, TestRos1Bridge):  # type: ignore[misc]
    """The whole suite with the bridge in a process of its own."""

    kinds = ("arrays", "scalars")
