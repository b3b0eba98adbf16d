"""What a target of make installs is all that the programs of its example import and ask for."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from tests.harness._needs import HEALTHBOT

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
FOLDERS = {
    "demo": ("vision",),
    "live": ("vision",),
    "drive": ("drive",),
    "healthbot": ("healthbot", "vision", "vitals"),
    "mixed": ("mixed",),
    "warehouse": ("warehouse", "healthbot/healthbot_scene"),
}
DRAW = ("plots.py", "drawing.py")  # with what `make plots` installs
OF_DEBIAN = ("rospy",)  # what Debian's own Python runs
STATED = {"dlib": ["dlib-bin"]}  # whose metadata names another module


def installed_by(target: str) -> Iterator[Requirement]:
    """Yield what the recipe gives to pip."""
    recipe = re.search(
        rf"^\$\(VENV\)/\.{target}:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE
    )
    assert recipe, target
    for local, package in re.findall(r"-e '?([^'\s]+)|\s(ros-[a-z-]+)", recipe[1]):
        name = re.sub(r"^\.(?=\[|$)", "uoarm", local).rpartition("/")[2]
        yield Requirement(name or package)


def with_what_they_need(asked: Iterator[Requirement]) -> set[str]:
    """Return the names of the distributions that pip installs for some."""
    todo = [
        (canonicalize_name(requirement.name), frozenset(requirement.extras))
        for requirement in asked
    ]
    seen = set(todo)
    while todo:
        name, extras = todo.pop()
        for line in requires(name) or ():
            one = Requirement(line)
            if one.marker and not any(one.marker.evaluate({"extra": e}) for e in extras | {""}):
                continue
            found = canonicalize_name(one.name), frozenset(one.extras)
            if found not in seen:
                seen.add(found)
                todo.append(found)
    return {name for name, _ in seen}


def imported(folder: Path) -> Iterator[str]:
    """Yield the modules of others that the files of a folder import, or look for."""
    own = {file.stem for file in EXAMPLES.rglob("*.py")} | {
        file.parent.name for file in EXAMPLES.rglob("*.py")
    }
    for file in folder.rglob("*.py"):
        if file.name in DRAW:
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            match node:
                case ast.Import(names=names):
                    found = [alias.name for alias in names]
                case ast.ImportFrom(module=str(module), level=0):
                    found = [module]
                case _:
                    continue
            tops = {name.partition(".")[0] for name in found}
            yield from tops - own - sys.stdlib_module_names - {"tests", "vision_demo", *OF_DEBIAN}


def lacking(modules: Iterator[str] | set[str], installed: set[str]) -> set[str]:
    """Return the modules that no installed distribution has.

    Ours are installed as links, whose metadata name no modules: they have the distributions' names.
    """
    owners = {**packages_distributions(), **STATED}
    return {
        module
        for module in modules
        if not {canonicalize_name(owner) for owner in owners.get(module, (module,))} & installed
    }


@pytest.mark.needs(*HEALTHBOT, "mqtt", "vda5050", "rosbridge")
@pytest.mark.parametrize("target", FOLDERS)
def test_what_an_example_imports_is_installed_by_its_target(target: str) -> None:
    installed = with_what_they_need(installed_by(target))
    assert "numpy" in installed or target == "drive"
    modules = {name for folder in FOLDERS[target] for name in imported(EXAMPLES / folder)}
    assert not lacking(modules, installed)


@pytest.mark.needs(*HEALTHBOT, "mqtt", "vda5050", "rosbridge")
@pytest.mark.parametrize("target", ["healthbot", "warehouse"])
def test_what_an_example_asks_for_before_it_starts_is_installed_by_its_target(
    target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("healthbot", "warehouse", "vision"):
        monkeypatch.syspath_prepend(str(EXAMPLES / folder))
    from healthbot_scene.needs import MODULES  # beside the example
    from warehouse_scene.parts import NEEDS

    asked = set(MODULES) if target == "healthbot" else set(NEEDS)
    assert not lacking(asked, with_what_they_need(installed_by(target)))
