"""What installations of one plugin must not share is chosen for them, the same in every run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from uoarm import ConfigurationError, RobotManager
from uoarm.bridge import BridgeType, Registry
from uoarm.cli import main
from uoarm.config import ASSIGN, assign, inspect, loads
from uoarm.model import BridgeSpec, Robot
from uoarm.testing import MemoryBridge

SCHEMA = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "island": {
            "type": "integer",
            ASSIGN: {"from": 64, "to": 67, "except_variable": "THE_ISLAND"},
        },
    },
}
KIND = BridgeType("isles", "for tests", MemoryBridge, SCHEMA, contract=2)
TYPES = {"isles": KIND}
FUNCTIONS = """
functions: {f: {components: [{name: c, bridge: a, output: {endpoint: [c]}}]}}
"""


def islands(*bridges: str) -> dict[str, object]:
    """Return what each bridge has after the assignment, by name."""
    text = "version: 1\nbridges:\n" + "".join(f"  {bridge}\n" for bridge in bridges) + FUNCTIONS
    robot = assign(loads(text, types=TYPES), TYPES)
    return {name: spec.options.get("island") for name, spec in robot.bridges.items()}


HUMBLE, JAZZY = "host: {environment: humble}", "host: {environment: jazzy}"


def test_two_installations_in_hosts_get_a_number_each() -> None:
    found = islands(f"a: {{plugin: isles, {HUMBLE}}}", f"b: {{plugin: isles, {JAZZY}}}")
    assert found == {"a": 64, "b": 65}


def test_bridges_of_one_installation_share_theirs() -> None:
    one, two = f"a: {{plugin: isles, {JAZZY}}}", f"b: {{plugin: isles, {JAZZY}}}"
    assert islands(one, two, f"c: {{plugin: isles, {HUMBLE}}}") == {"a": 64, "b": 64, "c": 65}


def test_a_bridge_on_another_machine_keeps_what_that_machine_has() -> None:
    one, two = f"a: {{plugin: isles, {JAZZY}}}", f"b: {{plugin: isles, {HUMBLE}}}"
    there = "c: {plugin: isles, host: {machine: arm}}\nhosts: {listen: 'tcp/127.0.0.1:7447'}"
    assert islands(one, two, there) == {"a": 64, "b": 65, "c": None}


def test_one_installation_alone_keeps_its_default() -> None:
    assert islands(f"a: {{plugin: isles, {JAZZY}}}") == {"a": None}


def test_a_bridge_in_our_own_process_keeps_its_default() -> None:
    assert islands("a: {plugin: isles}", f"b: {{plugin: isles, {JAZZY}}}") == {"a": None, "b": 64}


def test_what_is_written_stays_and_is_given_to_no_other_bridge() -> None:
    written = f"a: {{plugin: isles, {HUMBLE}, options: {{island: 64}}}}"
    assert islands(written, f"b: {{plugin: isles, {JAZZY}}}") == {"a": 64, "b": 65}


def test_the_number_of_the_environment_is_not_given_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("THE_ISLAND", "64")
    found = islands(f"a: {{plugin: isles, {HUMBLE}}}", f"b: {{plugin: isles, {JAZZY}}}")
    assert found == {"a": 65, "b": 66}


def test_more_installations_than_numbers_are_refused() -> None:
    hosts = [f"a{n}: {{plugin: isles, host: {{environment: e{n}}}}}" for n in range(5)]
    with pytest.raises(ConfigurationError, match="no island is left between 64 and 67"):
        islands("a: {plugin: isles}", *hosts)


@given(st.lists(st.tuples(st.sampled_from("xy"), st.sampled_from([None, 64, 65, 99]))))
def test_installations_without_a_written_number_never_meet(
    bridges: list[tuple[str, int | None]],
) -> None:
    specs = {
        f"b{n}": BridgeSpec(
            f"b{n}", "isles", {} if island is None else {"island": island}, {"environment": place}
        )
        for n, (place, island) in enumerate(bridges)
    }
    robot = assign(Robot(specs, {}), TYPES)
    assert robot == assign(Robot(specs, {}), TYPES)
    for bridge in robot.bridges.values():
        if bridge.assigned:
            rivals = [
                other
                for other in robot.bridges.values()
                if other.host != bridge.host
                and other.options.get("island") == bridge.options["island"]
            ]
            assert not rivals


def test_equal_numbers_of_two_installations_are_a_warning_with_its_place(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "version: 1\nbridges:\n"
        f"  a: {{plugin: isles, {HUMBLE}, options: {{island: 7}}}}\n"
        f"  b: {{plugin: isles, {JAZZY}, options: {{island: 7}}}}\n"
        f"  c: {{plugin: isles, {HUMBLE}, options: {{island: 7}}}}\n" + FUNCTIONS
    )
    report = inspect(file, TYPES)
    (warning,) = [problem for problem in report.warnings if "same" in problem.sentence]
    assert (warning.place.line, warning.path) == (4, "$.bridges.b.options.island")
    assert "bridge a has the same island 7" in warning.sentence


def test_the_status_shows_what_was_chosen() -> None:
    registry = Registry([])
    registry.add(KIND)
    text = f"version: 1\nbridges:\n  a: {{plugin: isles, {HUMBLE}}}\n"
    text += f"  b: {{plugin: isles, {JAZZY}}}\n" + FUNCTIONS
    ready = {"b": MemoryBridge("b")}
    with RobotManager(loads(text), registry=registry, bridges=ready) as robot:
        (status,) = robot.status().bridges
        assert status.assigned == (("island", 65),)


@pytest.mark.keeps("descriptor of pipe")  # of ROS 2, for signals
@pytest.mark.parametrize("command", ["bridges", "doctor"])
def test_commands_show_what_was_chosen(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "robot.yaml"
    text = f"version: 1\nbridges:\n  a: {{plugin: isles, {HUMBLE}}}\n"
    file.write_text(text + f"  b: {{plugin: isles, {JAZZY}}}\n" + FUNCTIONS)
    registry = Registry()
    registry.add(KIND)
    monkeypatch.setattr("uoarm.cli._show.Registry", lambda: registry)
    message = CliRunner().invoke(main, [command, "-f", str(file)], catch_exceptions=False).output
    assert "b.island" in message
    assert "65" in message
    message = CliRunner().invoke(main, [command, "-f", str(file), "--json"]).output
    assert {"a.island": "64", "b.island": "65"} in json.loads(message).values()
