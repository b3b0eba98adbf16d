"""The status map shows what the frameworks know of their links."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest
from tests.manager.test_requests import HEAD, source, step

from uoarm import RobotManager
from uoarm.bridge import Bridge, Channel

Make = Callable[[str], RobotManager]


def knowing(facts: Mapping[str, object]) -> Callable[[Channel], Mapping[str, object]]:
    return lambda channel: {"role": channel.endpoint.role.value, **facts}


def test_the_facts_of_every_open_channel_are_shown(
    make_robot: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Channel, "facts", knowing({"matched": 2}))
    robot = make_robot(HEAD + source() + step("wanted", "take_broad", "narrow"))
    with robot.request("wanted"):
        shown = {
            (component.name, channel.port): dict(channel.facts)
            for component in robot.status().components
            for channel in component.channels
        }
    assert shown == {
        ("narrow", "output.default"): {"role": "output", "matched": 2},
        ("wanted", "output.default"): {"role": "output", "matched": 2},
        ("wanted", "input.default"): {"role": "input", "matched": 2},
    }


def test_a_channel_that_cannot_give_its_facts_harms_no_status(
    make_robot: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(channel: Channel) -> Mapping[str, object]:
        raise OSError(f"no facts of {channel.endpoint.component}")

    monkeypatch.setattr(Channel, "facts", broken)
    robot = make_robot(HEAD + source())
    with robot.request("narrow"):
        (component,) = robot.status().components
    assert component.channels[0].facts == (("failed", "OSError: no facts of narrow"),)


def test_the_facts_of_a_bridge_are_shown_and_harm_no_status(
    make_robot: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(bridge: Bridge) -> Mapping[str, object]:
        raise OSError(f"no facts of {bridge.name}")

    robot = make_robot(HEAD + source())
    with robot.request("narrow"):
        (bridge,) = robot.status().bridges
        assert bridge.facts == ()
        monkeypatch.setattr(Bridge, "facts", lambda _: {"empty_turns": 3})
        (bridge,) = robot.status().bridges
        assert bridge.facts == (("empty_turns", 3),)
        monkeypatch.setattr(Bridge, "facts", broken)
        (bridge,) = robot.status().bridges
    assert bridge.facts == (("failed", f"OSError: no facts of {bridge.name}"),)
