"""The python bridge passes the same suite in a host as in this process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from attrs import evolve
from tests.harness._hosts import SharesHost, shared_host
from tests.local.test_python_conformance import samples

from uoarm.bridge import Bridge
from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing.conformance import BridgeConformance, Pair, Served, Victim, World

TESTS = Path(__file__).parents[1]


class HostedWorld(World):
    """The components of the in-process suite, and two that are driven through a file."""

    runs_code = True

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def spec(self) -> BridgeSpec:
        path = [str(TESTS / "local"), str(TESTS / "host" / "parts")]
        return BridgeSpec("python", "python", {"path": path, "discover": ["parts:Numbers"]})

    def pair(self, kind: str) -> Pair:
        return Pair(at(f"parts:{kind}", Role.INPUT), at(f"parts:{kind}", Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("parts:Nowhere", Role.OUTPUT)

    def samples(self, kind: str) -> Sequence[Message]:
        return samples(kind)

    def victims(self) -> Sequence[Victim]:
        made = []
        for name in ("first", "second"):
            killed = self._folder / name
            endpoint = at("hosted_kit_parts:until_killed", Role.OUTPUT, killed=str(killed))
            made.append(Victim(evolve(endpoint, component=name), killed.touch))
        return made

    def served(self) -> Served:
        double, broken = at("parts:double", Role.SERVICE), at("parts:broken", Role.SERVICE)
        silent = at("hosted_kit_parts:silent", Role.SERVICE)
        text = at("parts:measure", Role.SERVICE), {"text": "Kia ora", "kind": "a"}
        return Served(double, {"value": 21}, {"value": 42}, broken, silent, text=text)


def at(target: str, role: Role, **parameters: object) -> Endpoint:
    return Endpoint("python", target.partition(":")[2], role, (target,), parameters=parameters)


@pytest.fixture(scope="module")
def shared(unhurried: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bridge]:
    del unhurried
    with shared_host(HostedWorld(tmp_path_factory.getbasetemp()).spec()) as made:
        yield made


@pytest.mark.usefixtures("unhurried")
class TestHostedPythonBridge(SharesHost, BridgeConformance):
    """The whole suite."""

    kinds = ("Numbers", "Texts", "Pixels", "Everything")

    @pytest.fixture
    def world(self, tmp_path: Path) -> World:
        return HostedWorld(tmp_path)
