"""The suite as one class to inherit from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest

from uoarm.bridge import Bridge
from uoarm.testing.conformance._describing import Describing
from uoarm.testing.conformance._ending import Ending
from uoarm.testing.conformance._flow import Flow
from uoarm.testing.conformance._services import Services
from uoarm.testing.conformance._trouble import Trouble
from uoarm.testing.conformance._world import World

__all__ = ["BridgeConformance"]


class BridgeConformance(Describing, Flow, Ending, Trouble, Services):
    """Every test that a bridge must pass. Subclasses set `kinds` and override `world`.

    Attributes:
        kinds: names of the pairs that the world has; tests of messages run for each.
    """

    kinds: ClassVar[tuple[str, ...]] = ()

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Run tests that take a `kind` once for each."""
        if "kind" in metafunc.fixturenames and metafunc.cls is not None:
            metafunc.parametrize("kind", metafunc.cls.kinds)

    @pytest.fixture
    def world(self) -> Iterator[World]:
        """The world of this test; override it."""
        raise NotImplementedError(f"{type(self).__name__} needs a fixture `world`")

    @pytest.fixture
    def bridge(self, world: World) -> Iterator[Bridge]:
        """A bridge to the world, closed after the test."""
        made = world.bridge()
        yield made
        made.close()
