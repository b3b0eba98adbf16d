"""Endpoints and bridges as tests write them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from peers import Master

from uoarm.bridge import Bridge, Registry
from uoarm.model import BridgeSpec, Endpoint, Role
from uoarm.testing import patience

CHECK_SECONDS = 0.1
WAIT_SECONDS = min(patience(), 60)


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
