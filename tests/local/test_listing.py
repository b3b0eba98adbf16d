"""What the `python` bridge shows of components that its options list."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from uoarm.bridge import Discovered
from uoarm.local import PythonBridge, PythonOptions
from uoarm.model import Role

SOURCE = """
from collections.abc import Iterator

def camera(path: str, rate: float = 1.0) -> Iterator[int]:
    yield 1

def double(number: int) -> int:
    return 2 * number

class Finder:
    def __init__(self, size: int = 1) -> None: ...
    def __call__(self, number: int) -> str: ...

class Follower:
    def face(self, message: str) -> None: ...
    def speed(self, message: float) -> None: ...

def vague(message):
    return message

def quits(message: "exit(1)") -> int:
    return 1
"""


@pytest.fixture
def folder(tmp_path: Path) -> str:
    (tmp_path / "listed_parts.py").write_text(SOURCE)
    (tmp_path / "listed_broken.py").write_text("raise OSError('no camera is plugged in')")
    return str(tmp_path)


def shown(folder: str, *entries: object) -> tuple[Discovered, ...]:
    options = PythonOptions.of({"path": [folder], "discover": list(entries)})
    with closing(PythonBridge("py", options)) as bridge:
        return tuple(bridge.discover())


def ports(one: Discovered) -> dict[tuple[Role, str], object]:
    return {
        (end.role, end.port): said.message and _type(said.message.schema)
        for end, said in one.endpoints
    }


def _type(schema: Any) -> object:
    return schema["type"]


def test_what_is_listed_is_shown_with_its_structures(folder: str) -> None:
    camera, finder, follower = shown(
        folder,
        {"component": "listed_parts:camera", "name": "front", "parameters": {"path": "x"}},
        "listed_parts:Finder",
        "listed_parts:Follower",
    )
    assert camera.name == "front"
    assert camera.detail == "listed_parts:camera"
    assert ports(camera) == {(Role.OUTPUT, "default"): "integer"}
    assert camera.endpoints[0][0].parameters == {"path": "x"}
    assert ports(finder) == {
        (Role.INPUT, "default"): "integer",
        (Role.OUTPUT, "default"): "string",
        (Role.SERVICE, "default"): None,
    }
    assert ports(follower) == {(Role.INPUT, "face"): "string", (Role.INPUT, "speed"): "number"}


def test_what_cannot_be_used_is_shown_with_the_cause_and_spoils_nothing(folder: str) -> None:
    broken, unfit, vague, quits, double = shown(
        folder,
        "listed_broken:camera",
        {"component": "listed_parts:Finder", "parameters": {"size": "large"}},
        "listed_parts:vague",
        "listed_parts:quits",
        "listed_parts:double",
    )
    assert broken.endpoints == unfit.endpoints == quits.endpoints == ()
    assert "no camera is plugged in" in broken.detail
    assert "parameter 'size'" in unfit.detail
    assert quits.detail == "cannot be used: SystemExit: 1"
    assert set(ports(vague).values()) == {None}
    assert ports(double)[Role.OUTPUT, "default"] == "integer"
