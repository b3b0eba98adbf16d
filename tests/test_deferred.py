"""Names of packages that are imported when they are first asked for."""

from __future__ import annotations

import pydoc
from importlib import import_module
from types import ModuleType

import pytest
from tests.processes import run_python

import uoarm
import uoarm._control
import uoarm._host
import uoarm._lock
import uoarm._support.yaml
import uoarm.config
import uoarm.model
import uoarm.schema

PACKAGES = [
    uoarm, uoarm._control, uoarm._host, uoarm._lock, uoarm._support.yaml, uoarm.config, uoarm.schema
]  # fmt: skip


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_all_names_are_there_and_nothing_else(package: ModuleType) -> None:
    assert {*package.__all__} <= {*dir(package)}
    for name in package.__all__:
        assert getattr(package, name) is not None
    with pytest.raises(AttributeError, match=f"module {package.__name__!r} has no attribute 'no'"):
        package.no  # noqa: B018 - it raises


def test_a_name_is_looked_up_once() -> None:
    assert uoarm.config.load is vars(uoarm.config)["load"]
    assert uoarm.config.load is import_module("uoarm.config._load").load


def test_help_shows_what_is_deferred() -> None:
    text = pydoc.plain(pydoc.render_doc(uoarm))
    assert "class RobotManager" in text
    assert "class AsyncRobotManager" in text


@pytest.mark.parametrize("package", [uoarm, uoarm.model], ids=lambda package: package.__name__)
def test_help_shows_every_class(package: ModuleType) -> None:
    assert pydoc.render_doc(package)
    # Of what attrs makes for a cached property, where CPython 3.13.0 adds a text to it, it is None.
    classes = [item for name in package.__all__ if isinstance(item := getattr(package, name), type)]
    assert all(getattr(item, "__getattr__", print).__module__ for item in classes)


def test_a_public_package_is_an_attribute_without_an_import_of_its_own() -> None:
    code = "import uoarm; print(uoarm.config.load.__name__, uoarm.bridge.Registry.__name__)"
    done = run_python("-c", code, check=True)
    assert done.stdout == "load Registry\n"
