"""The bridge passes the suite that every bridge passes, against a real Mosquitto."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from brokers import Broker, running
from vda_world import VdaWorld

from uoarm.testing.conformance import BridgeConformance, World


class TestVda5050Bridge(BridgeConformance):
    """The whole suite."""

    kinds = ("order", "instantActions")

    @pytest.fixture
    def world(
        self, broker: Broker, tmp_path: Path, request: pytest.FixtureRequest
    ) -> Iterator[World]:
        # Of the kit's tests, those of one class break the world: they get a broker to break.
        breaks = request.function.__qualname__.startswith("Breaking.")
        with running(tmp_path / "broker") if breaks else nullcontext(broker) as used:
            made = VdaWorld(used)
            yield made
            made.close()


@pytest.mark.long
class TestInAHost(TestVda5050Bridge):
    """The whole suite with the bridge in a process of its own."""

    hosted = True
