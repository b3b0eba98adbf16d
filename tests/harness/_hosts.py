"""A bridge host that the tests of a suite share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar

import pytest
from attrs import evolve

from uoarm.bridge import Bridge
from uoarm.model import BridgeSpec
from uoarm.testing import patience
from uoarm.testing.conformance import World

__all__ = ["SharesHost", "shared_host"]

# Of the kit: those that break the world, and the one that looks for what a bridge still holds.
_BREAKING = "Breaking."
_OF_ITS_OWN = "EndingRules.test_what_is_closed_keeps_nothing_of_who_used_it"


@contextmanager
def shared_host(spec: BridgeSpec) -> Iterator[Bridge]:
    """Run a bridge in a host for all tests of a suite that end none."""
    from uoarm._host import RemoteBridge

    made = RemoteBridge(evolve(spec, host={"silence": patience(), "start": patience()}))
    yield made
    made.close()


class SharesHost:
    """The suite of a bridge in a host, of which the fixture `shared` gives one for all tests.

    Attributes:
        harmful: further tests of the kit that end what the shared host has but once.
    """

    hosted = True
    harmful: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def has_own(cls, request: pytest.FixtureRequest) -> bool:
        """Say whether a test gets a host of its own."""
        name: str = request.function.__qualname__
        return name.startswith((_BREAKING, _OF_ITS_OWN, *cls.harmful))

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
