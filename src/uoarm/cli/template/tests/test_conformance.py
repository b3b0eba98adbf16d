"""The bridge passes the suite that every bridge passes."""

from __future__ import annotations

import pytest
from uoarm_example._bridge import ExampleBridge
from uoarm_example._framework import TOPICS

from uoarm.bridge import Bridge
from uoarm.model import Endpoint, Role
from uoarm.testing.conformance import BridgeConformance, Pair, World


class ExampleWorld(World):
    """Topics on which the bridge both publishes and subscribes."""

    def bridge(self) -> Bridge:
        return ExampleBridge("example", {})

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("nowhere", Role.OUTPUT)


def at(topic: str, role: Role) -> Endpoint:
    return Endpoint("example", f"{topic}_component", role, (topic,))


class TestExampleBridge(BridgeConformance):
    """The whole suite."""

    kinds = tuple(TOPICS)

    @pytest.fixture
    def world(self) -> ExampleWorld:
        return ExampleWorld()
