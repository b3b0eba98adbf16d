"""A bridge host that the tests of a suite share."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from attrs import evolve

from uoarm.bridge import Bridge
from uoarm.model import BridgeSpec
from uoarm.testing import patience
from uoarm.testing.conformance import World

# Of the kit: those that break the world, and the one that looks for what a bridge still holds.
_BREAKING = "Breaking."
_OF_ITS_OWN = "EndingRules.test_what_is_closed_keeps_nothing_of_who_used_it"


def renamed(configuration: str, suffix: str) -> str:
    """Return a configuration with a suffix to the name of each function and component."""
    return re.sub(r"(?m)(^  (?=\w)|name: )(\w+)", rf"\1\2{suffix}", configuration)


@contextmanager
def shared_host(spec: BridgeSpec) -> Iterator[Bridge]:
    """Run a bridge in a host for all tests of a suite that end none."""
    from uoarm._host import RemoteBridge

    made = RemoteBridge(evolve(spec, host={"silence": patience(), "start": patience()}))
    yield made
    made.close()


class SharesHost:
    """The suite of a bridge in a host, of which the fixture `shared` gives one for all tests."""

    hosted = True

    @staticmethod
    def has_own(request: pytest.FixtureRequest) -> bool:
        """Say whether a test gets a host of its own."""
        name: str = request.function.__qualname__
        return name.startswith((_BREAKING, _OF_ITS_OWN))

    @pytest.fixture
    def bridge(
        self, shared: Bridge, world: World, request: pytest.FixtureRequest
    ) -> Iterator[Bridge]:
        """Give a test the shared host, where it leaves nothing open, or one of its own."""
        can_break = type(world).broken is not World.broken
        is_breaking = request.function.__qualname__.startswith(_BREAKING)
        if self.has_own(request) and (can_break or not is_breaking):
            own = world.bridge()
            yield own
            own.close()
        else:
            yield shared
            assert shared.open_channels == 0
