"""Which interpreter and which variables a host gets."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from uoarm._host.process_connection import HostProcess, HostSettings
from uoarm.config import loads
from uoarm.errors import BridgeError, ConfigurationError, FailureReason


def test_without_any_setting_the_interpreter_is_the_applications_own() -> None:
    assert HostSettings.read({}).interpreter() == Path(sys.executable)


def test_an_environment_is_found_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UOARM_HOME", str(tmp_path))
    python = tmp_path / "environments" / "jazzy" / "bin" / "python"
    settings = HostSettings.read({"environment": "jazzy"})
    with pytest.raises(BridgeError, match="uoarm env create jazzy") as caught:
        settings.interpreter()
    assert caught.value.reason is FailureReason.NOT_FOUND
    python.parent.mkdir(parents=True)
    python.symlink_to(sys.executable)
    assert settings.interpreter() == python


def test_an_interpreter_that_is_missing_is_named() -> None:
    with pytest.raises(BridgeError, match="/no/such/python"):
        HostSettings.read({"python": "/no/such/python"}).interpreter()


def test_the_traces_of_ros_wheels_are_taken_away() -> None:
    inherited = {
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
        "LD_LIBRARY_PATH": f"{sys.prefix}/lib/ros:/opt/mine",
        "PATH": "/usr/bin",
    }
    left = HostSettings().process_variables(inherited)
    assert left == {"LD_LIBRARY_PATH": "/opt/mine", "PATH": "/usr/bin"}


def test_a_loader_path_that_no_wheel_set_stays() -> None:
    inherited = {"LD_LIBRARY_PATH": f"{sys.prefix}/lib"}
    assert HostSettings().process_variables(inherited) == inherited


def test_another_environment_does_not_inherit_paths_of_ours() -> None:
    inherited = {"PYTHONPATH": "/mine", "VIRTUAL_ENV": "/venv", "HOME": "/home"}
    assert HostSettings().process_variables(inherited) == inherited
    other = HostSettings(environment="jazzy").process_variables(inherited)
    assert other == {"HOME": "/home"}


def test_variables_are_set_and_taken_away_last() -> None:
    settings = HostSettings.read({"variables": {"A": "new", "B": None, "C": "3"}})
    assert settings.process_variables({"A": "old", "B": "2"}) == {"A": "new", "C": "3"}


@pytest.mark.parametrize(("written", "octets"), [("64 MiB", 2**26), ("2GiB", 2**31)])
def test_a_size_is_read(written: str, octets: int) -> None:
    assert HostSettings.read({"memory": written}).memory_bytes == octets


@pytest.mark.parametrize("written", ["'512'", "512 MB", "0 MiB", "-1 MiB", "512"])
def test_what_is_no_size_is_refused_with_its_place(written: str) -> None:
    text = f"version: 1\nbridges: {{far: {{plugin: python, host: {{memory: {written}}}}}}}\n"
    with pytest.raises(ConfigurationError, match=r"host\.memory"):
        loads(text + "functions: {}\n")


@pytest.mark.parametrize("name", ["A=B", "A\0B"])
def test_a_variable_that_no_process_can_have_is_named(name: str) -> None:
    with pytest.raises(BridgeError, match="bridge host 'x' could not be started: "):
        HostProcess("x", [sys.executable, "-c", ""], {name: "c"}, lambda _: None)
