"""Inputs that move something, in the configuration: what is read, and every mistake."""

from __future__ import annotations

import pytest

from uoarm.config import loads
from uoarm.errors import ConfigurationError
from uoarm.model import (
    CommandPolicy,
    FieldLimit,
    LeasePolicy,
    Robot,
    StopMessage,
    from_json,
    to_json,
)
from uoarm.model import Endpoint as Port

ROBOT = """
version: 1
bridges: {{python: {{}}}}
functions:
  drive:
    components:
      - name: base
        bridge: python
        input: {{endpoint: ["m:base"], {settings}}}
"""


def read(settings: str) -> Robot:
    return loads(ROBOT.format(settings=settings))


def endpoint(robot: Robot) -> Port:
    (component,) = robot.components()
    return component.inputs[0].endpoint


def test_an_input_that_moves_something_is_read_and_travels_whole() -> None:
    port = endpoint(
        read("lifetime: 0.25, stop: {message: {v: [0, 0]}}, limits: {v: {minimum: -1, rate: 2}}")
    )
    limits = (FieldLimit("v", minimum=-1, rate=2),)
    assert port.command == CommandPolicy(0.25, StopMessage({"v": [0, 0]}), limits)
    assert from_json(to_json(port), Port) == port


def test_a_lease_is_read_and_travels() -> None:
    port = endpoint(read("lease: {duration: 2, priorities: {safety: 10, guest: -1}}"))
    lease = LeasePolicy(2, (("safety", 10), ("guest", -1)))
    assert port.command == CommandPolicy(lease=lease)
    assert from_json(to_json(port), Port) == port


def test_a_stop_message_may_be_null_and_any_other_input_has_none() -> None:
    assert endpoint(read("stop: {message: null}")).command == CommandPolicy(stop=StopMessage(None))
    assert endpoint(read("options: {}")).command is None


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ("lifetime: 1", "a lifetime needs a stop message"),
        ("lifetime: 0, stop: {message: 0}", "lifetime"),
        ("lifetime: soon, stop: {message: 0}", "lifetime"),
        ("stop: {}", "message"),
        ("limits: {v: {minimum: 1, maximum: -1}}", "the minimum 1 is more than the maximum -1"),
        ("limits: {v: {rate: 0}}", "rate"),
        ("limits: {v: {}}", "limits.v"),
        ("limits: 3", "limits"),
        ("lease: 2", "lease"),
        ("lease: {}", "duration"),
        ("lease: {duration: 0}", "duration"),
        ("lease: {duration: 1, priorities: {safety: most}}", "priorities"),
    ],
)
def test_mistakes_are_reported_with_their_place(settings: str, expected: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        read(settings)
    assert expected in str(caught.value)
