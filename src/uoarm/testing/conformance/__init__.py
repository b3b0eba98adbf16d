"""The conformance kit: the suite that every bridge passes.

A bridge author writes a `World` and gets the whole suite, under pytest with hypothesis::

    class TestMyBridge(BridgeConformance):
        kinds = ("integers", "text", "image")

        @pytest.fixture
        def world(self) -> Iterator[World]:
            ...

Each test states in its name what it holds. What a world does not supply is skipped, with the
reason, so that a report of the run is also the list of what a bridge does not do.
"""

from uoarm.testing.conformance._suite import BridgeConformance
from uoarm.testing.conformance._world import (
    LinkVictim,
    Pair,
    Retained,
    Served,
    Victim,
    World,
)

__all__ = ["BridgeConformance", "LinkVictim", "Pair", "Retained", "Served", "Victim", "World"]
