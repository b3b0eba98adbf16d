"""The suite as one class to inherit from."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import ClassVar

import pytest
from attrs import evolve

from uoarm.bridge import Bridge
from uoarm.testing._waiting import default_limits, patience
from uoarm.testing.conformance._describing import Declaring, Describing
from uoarm.testing.conformance._ending import EndingRules
from uoarm.testing.conformance._failures import Breaking, DisturbanceRules
from uoarm.testing.conformance._flow import Flow, ServiceRules
from uoarm.testing.conformance._world import World, is_of_paths


# What ends a thread of a bridge no channel reports: its source is silent from then on.
@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
class BridgeConformance(
    Declaring, Describing, Flow, EndingRules, DisturbanceRules, Breaking, ServiceRules
):
    """Every test that a bridge must pass. Subclasses set `kinds` and override `world`.

    Attributes:
        kinds: names of the pairs that the world has; tests of messages run for each.
        paths: those of `kinds` that the bridge carries in different ways: over another link, with
            another buffer, by way of another process. What a break does, or the close of the whole
            bridge, whatever the message is, is tested with each of these; the first of `kinds`,
            unless given.
        hosted: whether the bridge of the world's `spec` runs in a process of its own. A class
            that inherits the suite and sets it is the suite for the hosted bridge.
    """

    kinds: ClassVar[tuple[str, ...]] = ()
    paths: ClassVar[tuple[str, ...]] = ()
    hosted: ClassVar[bool] = False

    @pytest.fixture(autouse=True)
    def _in_time(self, world: World) -> Iterator[None]:
        """Have what is opened, asked and closed last as long as the world may be slow."""
        with default_limits(world.patience):
            yield

    @pytest.fixture(autouse=True)
    def _in_a_host(self, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
        """Have the world make its bridges in hosts, where that is asked."""
        if self.hosted:
            from uoarm._host import RemoteBridge  # noqa: PLC0415 - needs the extra `hosts`

            spec = world.spec()
            assert spec is not None, "a hosted bridge is made of the world's `spec`"
            host = {"silence": patience(), "start": patience()}
            monkeypatch.setattr(world, "bridge", partial(RemoteBridge, evolve(spec, host=host)))

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Run tests that take a `kind` once for each, or for those that stand for a path."""
        if "kind" in metafunc.fixturenames and metafunc.cls is not None:
            kinds: tuple[str, ...] = metafunc.cls.kinds
            if is_of_paths(metafunc.function):
                kinds = tuple(kind for kind in kinds if kind in metafunc.cls.paths) or kinds[:1]
            metafunc.parametrize("kind", kinds)

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
