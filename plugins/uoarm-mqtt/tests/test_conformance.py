"""The bridge passes the suite that every bridge passes, against a real Mosquitto."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from brokers import Broker, running
from mqtt_world import KINDS, MqttWorld, lasting_spec
from tests.harness._hosts import SharesHost, shared_host  # type: ignore[import-not-found]

from uoarm.bridge import Bridge
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
            made = MqttWorld(used, bridge_lasts=self.hosted)
            yield made
            made.close()


@pytest.fixture(scope="module")
def shared(broker: Broker) -> Iterator[Bridge]:
    with shared_host(lasting_spec(broker)) as made:
        yield made


class TestInAHost(SharesHost, TestMqttBridge):  # type: ignore[misc]
    """The whole suite with the bridge in a process of its own."""

    kinds = ("nested", "text")
