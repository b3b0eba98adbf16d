"""The packages that bridges run with: of the application, and of environments, read from files."""

from __future__ import annotations

from pathlib import Path

import pytest

from uoarm import __version__
from uoarm._lock import LockedBridge, differing_packages
from uoarm._lock._record import bridges_of
from uoarm.config import loads
from uoarm.model import Robot


def robot(**hosts: str) -> Robot:
    bridges = ", ".join(f"{name}: {{plugin: arm{host}}}" for name, host in hosts.items())
    return loads(f"version: 1\nbridges: {{{bridges}}}\nfunctions: {{}}\n")


def install(place: Path, name: str, version: str, *requires: str, bridge: str = "") -> None:
    folder = place / f"{name.replace('-', '_')}-{version}.dist-info"
    folder.mkdir(parents=True)
    lines = [f"Requires-Dist: {text}" for text in requires]
    reports = ["Metadata-Version: 2.1", f"Name: {name}", f"Version: {version}", *lines, ""]
    (folder / "METADATA").write_text("\n".join(reports))
    if bridge:
        (folder / "entry_points.txt").write_text(f"[uoarm.bridges]\n{bridge} = {name}\n")


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("UOARM_HOME", str(tmp_path))
    place = tmp_path / "environments" / "arms" / "lib" / "python3.12" / "site-packages"
    install(
        place, "uoarm-arm", "2.0", "arm_driver>=1 ; python_version > '3'", "uoarm", "not-there",
        "arm-msgs ; extra == 'real'", "tester ; extra == 'dev'", bridge="arm",
    )  # fmt: skip
    install(place, "Arm.Driver", "1.5", "speedups ; extra == 'fast'")
    install(place, "arm-msgs", "5.3.6")
    for name in ("speedups", "tester", "unrelated", "core-helper"):
        install(place, name, "1")
    install(place, "uoarm", "9.9", "core-helper")
    return place


def test_of_an_environment_it_is_what_the_plugin_asks_for_and_nothing_else(
    environment: Path,
) -> None:
    found = bridges_of(robot(arm=", host: {environment: arms}"))["arm"]
    packages = {"arm-driver": "1.5", "arm-msgs": "5.3.6", "uoarm": "9.9", "uoarm-arm": "2.0"}
    assert found == LockedBridge("arm", "arms", packages)
    python = environment.parents[2] / "bin" / "python"
    named = bridges_of(robot(arm=f', host: {{python: "{python}"}}'))["arm"]
    assert named == LockedBridge("arm", str(python), packages)


def test_of_the_application_it_is_what_is_installed_here() -> None:
    built_in = loads("version: 1\nbridges: {python: {}}\nfunctions: {}\n")
    assert bridges_of(built_in) == {"python": LockedBridge("python", "", {"uoarm": __version__})}
    assert bridges_of(robot(arm="")) == {"arm": LockedBridge("arm")}
    gone = bridges_of(robot(arm=", host: {environment: there-is-none}"))["arm"]
    assert gone == LockedBridge("arm", "there-is-none")


def test_other_versions_are_reported_by_bridge() -> None:
    before = {"arm": LockedBridge("arm", "", {"a": "1", "b": "1", "c": "1"})}
    after = {"arm": LockedBridge("arm", "", {"a": "1", "b": "2", "d": "1"})}
    assert differing_packages(before, {**after, "leg": before["arm"]}) == [
        "bridge arm: b 2, was 1",
        "bridge arm: c is gone, was 1",
        "bridge arm: d 1, was not there",
    ]
