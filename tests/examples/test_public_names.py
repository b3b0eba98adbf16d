"""The examples use what is public only, so that they stay true for who starts from them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

# It measures steps of the library one by one, and is no start for an application.
MEASURED = {
    f"healthbot/experiments/latency.py: uoarm.{name}"
    for name in ("_adapt.check_edge", "_adapt.transfer", "_resolve.Resolver", "_resolve.Structures")
}
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def imported(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from (f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


def is_private(name: str) -> bool:
    package, *steps = name.split(".")
    return package.startswith("uoarm") and any(step.startswith("_") for step in steps)


def test_examples_import_nothing_private() -> None:
    files = sorted(EXAMPLES.rglob("*.py"))
    assert len(files) > 30
    found = {
        f"{file.relative_to(EXAMPLES)}: {name}"
        for file in files
        for name in imported(ast.parse(file.read_text(encoding="utf-8")))
        if is_private(name)
    }
    assert found == MEASURED


@pytest.mark.parametrize("name", ["uoarm_rtm._orb.Orb", "uoarm._host.transport", "uoarm_rtm.x._y"])
def test_what_is_private_is_known(name: str) -> None:
    assert is_private(name)
    assert not is_private(name.replace("_", "").replace("uoarmrtm", "uoarm_rtm"))
