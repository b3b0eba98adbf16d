"""What a host reads of its manager's requests is as it was written, and read once only."""

from __future__ import annotations

from typing import Any

import pytest

from uoarm._host.agent.dispatcher import _read
from uoarm._host.agent.host_agent import HostedBridge
from uoarm._host.transport.transport import LinkLostError
from uoarm.bridge import BridgeType, Registry, ServiceStructures
from uoarm.model import BridgeSpec, Endpoint, MessageStructure, Role, from_json, to_json
from uoarm.testing import MemoryBridge


def endpoint(**options: object) -> Endpoint:
    return Endpoint("far", "arm", Role.INPUT, ("topic", "name"), options=options)


@pytest.mark.parametrize(
    "value",
    [
        endpoint(depth=3),
        MessageStructure({"type": "object", "properties": {"x": {"type": "number"}}}),
        ServiceStructures(MessageStructure({"type": "integer"}), MessageStructure(True)),
    ],
)
def test_what_came_before_is_the_very_same_value(value: object) -> None:
    kind = type(value)
    first = _read(to_json(value), kind)
    assert first == value == from_json(to_json(value), kind)
    assert _read(to_json(value), kind) is first


def test_what_is_equal_in_python_but_not_in_json_is_not_confused() -> None:
    options: list[object] = [1, 1.0, True]
    read = [_read(to_json(endpoint(depth=option)), Endpoint).options["depth"] for option in options]
    assert [type(item) for item in read] == [int, float, bool]


def test_the_same_data_of_another_kind_is_another_value() -> None:
    data = to_json(MessageStructure(True))
    assert isinstance(_read(data, MessageStructure), MessageStructure)
    with pytest.raises(ValueError, match="Endpoint"):
        _read(data, Endpoint)


def test_what_is_large_is_not_kept() -> None:
    large = to_json(endpoint(words="word " * 1000))
    first = _read(large, Endpoint)
    assert _read(large, Endpoint) == first
    assert _read(large, Endpoint) is not first


class LostLink:
    """A link that is lost while the bridge is made."""

    is_closed = False

    def watch_alive(self, *_: object) -> None:
        pass

    def answer(self, *_: object) -> None:
        raise LinkLostError("the manager has gone")

    def close(self) -> None:
        self.is_closed = True


def test_a_bridge_whose_manager_goes_while_it_is_made_is_closed() -> None:
    made: list[MemoryBridge] = []

    def make(name: str, options: Any) -> MemoryBridge:
        made.append(MemoryBridge(name, options))
        return made[0]

    registry, link = Registry([]), LostLink()
    registry.add(BridgeType("memory", "for tests", make, contract=2))
    with pytest.raises(LinkLostError):
        HostedBridge(registry, BridgeSpec("one", "memory"), link)  # type: ignore[arg-type]
    assert made[0].closed
    assert link.is_closed
