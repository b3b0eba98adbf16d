"""The ROS 2 bridge passes the suite that every bridge passes."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from conformance_world import KINDS, SILENT_SECONDS, RosWorld
from peers import DOMAIN, Peer

from uoarm.testing.conformance import BridgeConformance, World


@pytest.fixture(scope="module")
def lasting() -> Iterator[Peer]:
    """One node for every test: it echoes a topic and serves."""
    node = Peer("lasting", {"ROS_DOMAIN_ID": str(DOMAIN)}, "threads")
    node.do("echo", come="/asked", go="/echoed")
    node.do("serve", name="/add")
    node.do("serve", name="/silent", delay=SILENT_SECONDS)
    yield node
    node.end()


class TestRos2Bridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(KINDS)

    @pytest.fixture
    def world(self, lasting: Peer, peer: Callable[..., Peer]) -> World:
        return RosWorld(lasting, peer)
