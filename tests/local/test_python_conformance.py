"""The python bridge passes the suite that every bridge passes."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from attrs import evolve

from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing.conformance import BridgeConformance, Pair, Served, Victim, World

HERE = Path(__file__).parent


class PythonWorld(World):
    """The classes and functions of `parts.py`."""

    runs_code = True

    def __init__(self) -> None:
        self._killed = [threading.Event() for _ in range(2)]
        self._released = threading.Event()

    def spec(self) -> BridgeSpec:
        options = {"path": [str(HERE)], "discover": ["parts:Numbers"]}
        return BridgeSpec("python", "python", options)

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("Nowhere", Role.OUTPUT)

    def samples(self, kind: str) -> Sequence[Message]:
        return samples(kind)

    def victims(self) -> Sequence[Victim]:
        return [
            Victim(
                evolve(at("until_killed", Role.OUTPUT, killed=killed), component=name), killed.set
            )
            for name, killed in zip(("first", "second"), self._killed, strict=True)
        ]

    def served(self) -> Served:
        silent = at("silent", Role.SERVICE, released=self._released)
        broken, double = at("broken", Role.SERVICE), at("double", Role.SERVICE)
        text = at("measure", Role.SERVICE), {"text": "Kia ora", "kind": "a"}
        return Served(double, {"value": 21}, {"value": 42}, broken, silent, text=text)

    def close(self) -> None:
        for killed in self._killed:
            killed.set()
        self._released.set()


def samples(kind: str) -> Sequence[Message]:
    number = {"small": -128, "large": 2**64 - 1, "real": 5e-324, "truth": True}
    text = {"text": "Kia ora \u2192 \U0001f916\r\n\t\0", "kind": "b"}
    made: dict[str, Message] = {
        "Numbers": number,
        "Texts": text,
        "Pixels": {"width": 1024, "data": bytes(range(256)) * 8192},
        "Everything": {
            "numbers": [number] * 300,
            "texts": {"": text, "\u2192": text},
            "either": None,
            "pair": [False, -0.0],
        },
    }
    return [made[kind]]


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
