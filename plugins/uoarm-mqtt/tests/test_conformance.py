"""The bridge passes the suite that every bridge passes, against a real Mosquitto."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from brokers import Broker, running
from mqtt_world import KINDS, MqttWorld

from uoarm.testing.conformance import BridgeConformance, World


class TestMqttBridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(KINDS)

    @pytest.fixture
    def world(
        self, broker: Broker, tmp_path: Path, request: pytest.FixtureRequest
    ) -> Iterator[World]:
        # Of the kit's tests, those of one class break the world: they get a broker to break.
        breaks = request.function.__qualname__.startswith("Breaking.")
        with running(tmp_path / "broker") if breaks else nullcontext(broker) as used:
            made = MqttWorld(used)
            yield made
            made.close()


class TestInAHost(TestMqttBridge):
    """The whole suite with the bridge in a process of its own."""

    hosted = True
    kinds = ("nested", "text")
