"""The ROS 2 bridge passes the suite that every bridge passes."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

import pytest
from conformance_world import KINDS, SILENT_SECONDS, RosWorld
from endpoints import Start
from peers import DOMAIN, Peer
from tests.harness._hosts import SharesHost, shared_host  # type: ignore[import-not-found]

from uoarm.bridge import Bridge
from uoarm.testing.conformance import BridgeConformance, World


@pytest.fixture(scope="module")
def lasting() -> Iterator[Peer]:
    """One node for every test: it echoes topics and serves."""
    node = Peer("lasting", {"ROS_DOMAIN_ID": str(DOMAIN)}, "threads")
    node.do("serve", name="/add")
    node.do("serve", name="/silent", delay=SILENT_SECONDS)
    yield node
    node.end()


class TestRos2Bridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(KINDS)
    paths = ("echoed",)  # of the others none has a link that could break

    @pytest.fixture
    def world(self, lasting: Peer, peer: Start, request: pytest.FixtureRequest) -> Iterator[World]:
        # Of the kit's tests, those of one class break the world: they get a node to freeze.
        breaks = request.function.__qualname__.startswith("Breaking.")
        made = RosWorld(lasting, peer, breaks=breaks)
        yield made
        made.close()


HOSTS = importlib.util.find_spec("zenoh") is not None


@pytest.fixture(scope="module")
def shared(lasting: Peer) -> Iterator[Bridge]:
    with shared_host(RosWorld(lasting, Peer).spec()) as made:
        yield made


@pytest.mark.skipif(not HOSTS, reason="needs uoarm[hosts]")
class TestHostedRos2Bridge(SharesHost, TestRos2Bridge):  # type: ignore[misc]
    """The suite through a bridge host, whose link has its own tests: two kinds are enough."""

    kinds = ("scalars", "echoed")
