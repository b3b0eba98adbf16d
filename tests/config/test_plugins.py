"""What a plugin knows of its own options and addresses is checked with everything else."""

from __future__ import annotations

import os
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import pytest

from uoarm import RobotManager, _plugins
from uoarm._mistakes import schema_mistakes
from uoarm._spelling import Speller
from uoarm.bridge import Bridge, BridgeType, Registry
from uoarm.config import loads
from uoarm.errors import ConfigurationError
from uoarm.model import BridgeSpec
from uoarm.testing import MemoryBridge

TEXT = """\
version: 1
bridges:
  lab:
    plugin: probe
    options: {domain: seven, colour: red}
functions:
  camera:
    components:
      - {name: one, bridge: lab, output: {endpoint: [wrong]}}
      - {name: two, bridge: lab, priority: -1, output: {endpoint: [right]}}
      - {name: three, bridge: lab, priority: -2, output: {endpoint: [explode]}}
"""


def check_endpoint(address: tuple[str, ...], options: Any) -> str:
    assert dict(options) == {}
    if address == ("explode",):
        raise RuntimeError("no idea")
    return "" if address == ("right",) else f"expected ['right'], got {list(address)}"


def never(name: str, options: Any) -> Bridge:
    raise AssertionError(f"{name} must not be made with {options}")


PROBE = BridgeType(
    "probe",
    "for this test",
    never,
    bridge_options={
        "type": "object",
        "properties": {"domain": {"type": "integer"}, "color": {}},
        "additionalProperties": False,
    },
    check_endpoint=check_endpoint,
    contract=2,
)


def test_every_mistake_in_options_and_endpoints_is_reported_with_its_place() -> None:
    with pytest.raises(ConfigurationError) as caught:
        loads(TEXT, types={"probe": PROBE})
    lines = str(caught.value).splitlines()
    assert [line.partition(" ")[0] for line in lines] == [
        "<text>:5:23:",
        "<text>:5:30:",
        "<text>:9:53:",
        "<text>:11:69:",
    ]
    assert 'the plugin probe: expected a whole number, got "seven"' in lines[0]
    assert 'unknown key "colour" (did you mean "color"?)' in lines[1]
    assert "expected ['right'], got ['wrong']" in lines[2]
    assert "check_endpoint failed with RuntimeError: no idea" in lines[3]


def test_a_plugin_that_is_not_installed_is_passed_over() -> None:
    assert loads(TEXT).bridges["lab"].plugin == "probe"


def test_a_manager_made_from_values_checks_options_when_the_bridge_starts() -> None:
    registry = Registry([])
    registry.add(PROBE)
    with pytest.raises(
        ConfigurationError, match=r'\$\.domain: expected a whole number, got "seven"'
    ):
        registry.create(BridgeSpec("lab", "probe", {"domain": "seven"}))


def test_a_manager_from_a_file_checks_with_its_registry(tmp_path: Any) -> None:
    registry = Registry([])
    registry.add(PROBE)
    file = tmp_path / "robot.yaml"
    file.write_text(TEXT)
    with pytest.raises(ConfigurationError, match="colour"):
        RobotManager.from_file(file, registry=registry)


def test_options_that_fit_are_taken() -> None:
    registry = Registry([])
    registry.add(BridgeType("memory", "in memory", lambda name, _: MemoryBridge(name), contract=2))
    registry.create(BridgeSpec("lab", "memory")).close()


def test_what_is_installed_is_read_once_and_again_when_something_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[str] = []

    def read(group: str) -> tuple[EntryPoint, ...]:
        reads.append(group)
        return tuple(entry_points(group=group))

    def names() -> set[str]:
        return {point.name for point in _plugins.installed("uoarm.test")}

    monkeypatch.setattr("importlib.metadata.entry_points", read)
    monkeypatch.setattr(_plugins, "_found", {})
    monkeypatch.syspath_prepend(tmp_path)
    assert (names(), names()) == (set(), set())
    assert reads == ["uoarm.test"]
    folder = tmp_path / "late-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: late\nVersion: 1\n")
    (folder / "entry_points.txt").write_text("[uoarm.test]\nlate = late\n")
    os.utime(tmp_path, ns=(0, 1))  # some systems note changes a few milliseconds late
    assert (names(), names()) == ({"late"}, {"late"})
    assert len(reads) == 2


def test_a_form_with_several_unknown_keys_is_one_mistake() -> None:
    forms = [
        {"type": "string"},
        {"type": "object", "properties": {}, "additionalProperties": False},
    ]
    found = list(schema_mistakes({"a": 1, "b": 2}, {"anyOf": forms}, Speller()))
    assert [sentence for _, sentence, _, _ in found] == [
        '{"a": 1, "b": 2} is none of the 2 forms allowed'
    ]
