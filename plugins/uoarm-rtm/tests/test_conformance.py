"""The OpenRTM bridge passes the suite that every bridge passes."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

import pytest
from conformance_world import KINDS, TYPES_IDL, RtmWorld, begin_loop
from endpoints import Start
from peers import Peer
from tests.harness._hosts import SharesHost, shared_host  # type: ignore[import-not-found]

from uoarm.bridge import Bridge
from uoarm.testing.conformance import BridgeConformance, World


@pytest.fixture(scope="module")
def loop(nameserver: str) -> Iterator[Peer]:
    """One component for every test: it sends back what comes, and serves."""
    component = Peer(nameserver, "Loop", KINDS["long"], TYPES_IDL)
    begin_loop(component)
    yield component
    component.end()


class TestRtmBridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(KINDS)
    paths = ("long", "buffered", "pulled")

    @pytest.fixture
    def world(self, loop: Peer, nameserver: str, peer: Start) -> Iterator[World]:
        made = RtmWorld(nameserver, loop, peer)
        yield made
        made.close()


HOSTS = importlib.util.find_spec("zenoh") is not None


@pytest.fixture(scope="module")
def shared(loop: Peer, nameserver: str) -> Iterator[Bridge]:
    with shared_host(RtmWorld(nameserver, loop, Peer).spec()) as made:
        yield made


@pytest.mark.skipif(not HOSTS, reason="needs uoarm[hosts]")
class TestHostedRtmBridge(SharesHost, TestRtmBridge):  # type: ignore[misc]
    """The suite through a bridge host, whose link has its own tests: two kinds are enough."""

    kinds = ("ranges", "text")
