"""A bridge host that the tests of a suite share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from attrs import evolve

from uoarm.bridge import Bridge
from uoarm.model import BridgeSpec
from uoarm.testing import patience
from uoarm.testing.conformance import World

__all__ = ["lent", "shared_host"]


@contextmanager
def shared_host(spec: BridgeSpec) -> Iterator[Bridge]:
    """Run a bridge in a host for all tests of a suite that end none."""
    from uoarm._host import RemoteBridge

    made = RemoteBridge(evolve(spec, host={"silence": patience(), "start": patience()}))
    yield made
    made.close()


@contextmanager
def lent(shared: Bridge, world: World, request: pytest.FixtureRequest) -> Iterator[Bridge]:
    """Give a test of the kit the shared host, in which it leaves nothing open.

    Tests that break the world, those of one class, get a host of their own.
    """
    if request.function.__qualname__.startswith("Breaking."):
        own = world.bridge()
        yield own
        own.close()
    else:
        yield shared
        assert shared.open_channels == 0
