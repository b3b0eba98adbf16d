"""Endpoints and bridges as tests write them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from peers import Master

from uoarm.bridge import Bridge, HealthEvent, Registry
from uoarm.model import BridgeSpec, Endpoint, Health, Role
from uoarm.testing import patience, wait

CHECK_SECONDS = 0.1
WAIT_SECONDS = min(patience(), 60)


class Reports:
    """What a bridge reported."""

    def __init__(self, bridge: Bridge) -> None:
        self.events: list[HealthEvent] = []
        bridge.watch(self.events.append)

    def wait(self, health: Health, text: str = "") -> HealthEvent:
        """Wait for a report and return it."""

        def found() -> list[HealthEvent]:
            events = tuple(self.events)
            return [event for event in events if event.health is health and text in event.cause]

        wait(lambda: bool(found()), f"no {health} with {text!r}: {self.events}")
        return found()[0]


@contextmanager
def bridge_to(world: Master, /, **options: Any) -> Iterator[Bridge]:
    given = {"master": world.uri, "check": CHECK_SECONDS, "wait": WAIT_SECONDS, **options}
    bridge = Registry().create(BridgeSpec("ros", "ros1", given))
    try:
        yield bridge
    finally:
        bridge.close()


def endpoint(role: Role, *address: str, component: str = "", **options: Any) -> Endpoint:
    return Endpoint("ros", component or address[0].strip("/"), role, address, options=options)


def output(*address: str, **options: Any) -> Endpoint:
    return endpoint(Role.OUTPUT, *address, **options)


def input_(*address: str, **options: Any) -> Endpoint:
    return endpoint(Role.INPUT, *address, **options)


def service(*address: str, **options: Any) -> Endpoint:
    return endpoint(Role.SERVICE, *address, **options)
