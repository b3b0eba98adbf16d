"""The python bridge passes the suite that every bridge passes."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from uoarm.bridge import Bridge
from uoarm.local import PythonBridge
from uoarm.model import Endpoint, Role
from uoarm.testing.conformance import BridgeConformance, Pair, Served, Victim, World

HERE = Path(__file__).parent


class PythonWorld(World):
    """The classes and functions of `parts.py`."""

    def __init__(self) -> None:
        self._killed = threading.Event()
        self._released = threading.Event()

    def bridge(self) -> Bridge:
        return PythonBridge("python", {"path": [str(HERE)], "discover": ["parts:Numbers"]})

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("Nowhere", Role.OUTPUT)

    def victim(self) -> Victim:
        endpoint = at("until_killed", Role.OUTPUT, killed=self._killed)
        return Victim(endpoint, self._killed.set)

    def served(self) -> Served:
        silent = at("silent", Role.SERVICE, released=self._released)
        broken, double = at("broken", Role.SERVICE), at("double", Role.SERVICE)
        return Served(double, {"value": 21}, {"value": 42}, broken, silent)

    def close(self) -> None:
        self._killed.set()
        self._released.set()


def at(name: str, role: Role, **parameters: object) -> Endpoint:
    return Endpoint("python", name, role, (f"parts:{name}",), parameters=parameters)


class TestPythonBridge(BridgeConformance):
    """The whole suite."""

    kinds = ("Numbers", "Texts", "Pixels", "Everything")

    @pytest.fixture
    def world(self) -> Iterator[World]:
        made = PythonWorld()
        yield made
        made.close()
