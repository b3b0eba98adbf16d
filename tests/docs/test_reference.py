"""The reference names every public module, and every public module says what is public in it."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest
from bench.interface import interface, public_modules

import uoarm

PAGE = Path(__file__).parents[2] / "docs" / "reference.md"
RECORDED = Path(__file__).with_name("public_interface.txt")


def listed(directive: str) -> list[str]:
    return re.findall(
        rf"^\.\. {directive}:: (\S+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )


def test_every_public_module_is_in_the_reference() -> None:
    assert set(public_modules()) <= set(listed("automodule"))


def test_the_names_of_the_package_itself_are_in_the_reference() -> None:
    modules = [importlib.import_module(name) for name in public_modules()]
    elsewhere = {name for module in modules for name in module.__all__}
    classes = {name.removeprefix("uoarm.") for name in listed("autoclass")}
    own = set(uoarm.__all__) - {"__version__", "errors"}
    assert own <= elsewhere | classes


@pytest.mark.parametrize("name", public_modules())
def test_a_public_module_lists_its_names(name: str) -> None:
    module = importlib.import_module(name)
    assert sorted(module.__all__) == sorted(set(module.__all__))
    assert all(hasattr(module, item) for item in module.__all__)
    assert module.__doc__


def test_the_public_interface_is_the_recorded_one() -> None:
    """A change of the interface is seen in a review, since it changes the record as well."""
    now = "\n".join(interface()).rstrip() + "\n"
    record = "python -m bench.interface > tests/docs/public_interface.txt"
    assert RECORDED.read_text(encoding="utf-8") == now, f"where that is meant: {record}"
