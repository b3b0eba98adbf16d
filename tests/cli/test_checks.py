"""Plugins bring checks of `uoarm doctor`; one that fails is named and hurts no other."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

import pytest
from attrs import evolve
from tests.processes import run_python

from uoarm import _checks
from uoarm._checks import plugin_facts
from uoarm.bridge import Registry
from uoarm.errors import PluginError
from uoarm.plugins import Check, hookimpl


def _unusable() -> dict[str, str]:
    raise PluginError("no camera: plug one in")


def _mistaken() -> dict[str, str]:
    raise ValueError("a mistake of the plugin")


@hookimpl
def uoarm_checks() -> list[Check]:
    return [
        Check("camera", lambda: {"lens": "clean"}, contract=1),
        Check("microphone", _unusable, contract=1),
        Check("speaker", _mistaken, contract=1),
        Check("older", dict, contract=0),
        Check("python", dict, contract=1),
    ]


def _without_its_package() -> dict[str, str]:
    return {"usable": import_module("no_such_module").__name__}


def test_what_a_plugin_lacks_is_reported_with_the_command_that_brings_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (python,) = (entry for entry in entry_points(group="uoarm.bridges") if entry.name == "python")
    registry = Registry([python])
    kind = evolve(registry.types["python"], doctor=_without_its_package)
    monkeypatch.setattr(registry, "_types", {"python": kind})
    text = plugin_facts(registry)["python"]["usable"]
    assert text.startswith(
        "no: ModuleNotFoundError: No module named 'no_such_module': `pip install"
    )
    assert text.endswith("` brings what it needs")


def test_their_findings_are_shown_and_failures_named(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        EntryPoint("mine", __name__, "uoarm.checks"),
        EntryPoint("gone", "no_such_module", "uoarm.checks"),
        EntryPoint("silent", "json", "uoarm.checks"),
    ]
    monkeypatch.setattr(_checks, "installed", lambda group: points if "checks" in group else [])
    facts = plugin_facts(Registry([EntryPoint("python", "uoarm.local", "uoarm.bridges")]))
    assert facts["camera"] == {"usable": "yes", "lens": "clean"}
    assert facts["microphone"] == {"usable": "no: no camera: plug one in"}
    assert facts["speaker"] == {"usable": "no: ValueError: a mistake of the plugin"}
    assert "written for version 0" in facts["older"]["usable"]
    assert facts["python"]["usable"] == "yes"
    assert "bridge type 'python'" in facts["check mine"]["usable"]
    assert "ModuleNotFoundError" in facts["check gone"]["usable"]
    assert "implements no uoarm_checks hook" in facts["check silent"]["usable"]


@pytest.mark.parametrize("module", ["uoarm.client", "uoarm.server", "uoarm.server.front_end"])
@pytest.mark.parametrize("package", ["cbor2", "orjson", "websockets"])
def test_without_the_extra_the_import_says_what_installs_it(module: str, package: str) -> None:
    lacking = f"import sys; sys.modules[{package!r}] = None; "
    done = run_python("-c", f"{lacking}import {module}")
    last = done.stderr.splitlines()[-1]
    whole = module.removesuffix(".front_end")
    assert last.startswith(f"ModuleNotFoundError: {whole} needs: pip install ")
    assert "[server]" in last
    assert package in last


def test_a_command_says_it_once() -> None:
    lacking = "import sys; sys.modules['cbor2'] = None; from uoarm.cli import main; "
    done = run_python("-c", f"{lacking}main(['list', '--url', 'ws://127.0.0.1:9'])")
    assert done.returncode == 4
    assert done.stderr.count("pip install") == 1
