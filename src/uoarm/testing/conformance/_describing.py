"""Does the bridge tell the truth about its endpoints, and say no in the right words?"""

from __future__ import annotations

import re

import pytest
from attrs import evolve
from jsonschema import Draft202012Validator

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason
from uoarm.testing.conformance._line import example_of, structure_of
from uoarm.testing.conformance._rules import rules
from uoarm.testing.conformance._world import World

__all__ = ["Describing"]

_ABSENT = (FailureReason.NOT_FOUND, FailureReason.UNAVAILABLE)


@rules("the-steps")
class Describing:
    """`describe` and `discover`."""

    def test_structures_are_valid_schemas_with_messages(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        pair = world.pair(kind)
        for incoming in (True, False):
            structure = structure_of(bridge, pair, incoming=incoming)
            Draft202012Validator.check_schema(structure.schema)
            assert example_of(structure) is not None

    def test_describing_twice_says_the_same(self, world: World, bridge: Bridge, kind: str) -> None:
        pair = world.pair(kind)
        for endpoint in (pair.sink, pair.source):
            first, again = bridge.describe(endpoint), bridge.describe(endpoint)
            assert first == again, f"{endpoint} was described by {first}, then by {again}"

    def test_what_is_not_there_is_named(self, world: World, bridge: Bridge) -> None:
        endpoint = world.missing()
        with pytest.raises(BridgeError) as caught:
            bridge.describe(endpoint)
        reason = caught.value.reason
        assert reason in _ABSENT, f"the reason is {reason}, expected NOT_FOUND or UNAVAILABLE"
        words = re.split(r"[^\w]+", " ".join(endpoint.address))
        text = str(caught.value.__cause__ or caught.value)
        assert any(word in text for word in words if word), f"{text!r} does not name it"

    def test_what_is_not_there_does_not_open(self, world: World, bridge: Bridge, kind: str) -> None:
        structure = structure_of(bridge, world.pair(kind), incoming=False)
        with pytest.raises(BridgeError):
            bridge.open_source(world.missing(), structure, lambda _: None)
        assert bridge.open_channels == 0

    def test_an_address_without_parts_is_refused(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with pytest.raises(BridgeError):
            bridge.describe(evolve(world.pair(kind).source, address=()))

    def test_discovered_components_can_be_described(self, bridge: Bridge) -> None:
        if not bridge.capabilities.discover:
            pytest.skip("the bridge does not discover components")
        found = bridge.discover()
        assert found, "nothing was discovered, though the world has components"
        for component in found:
            for endpoint, description in component.endpoints:
                report = bridge.describe(endpoint)
                assert report == description, (
                    f"{endpoint} is described by {report}, not {description}"
                )
