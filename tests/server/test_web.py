"""The page's own code where it is pure: run by node."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.processes import run_program

TESTS = Path(__file__).parent / "web"
OLDEST = 20


def find_node() -> str:
    node = "node"
    version = run_program(node, "--version", check=True).stdout
    if int(version.removeprefix("v").partition(".")[0]) < OLDEST:
        pytest.skip(f"node {version.strip()} is older than {OLDEST}")
    return node


@pytest.mark.needs("node")
def test_the_pages_code_does_what_it_says() -> None:
    files = [str(path) for path in sorted(TESTS.glob("*.test.mjs"))]
    done = run_program(find_node(), "--test", *files)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"# pass {sum(Path(file).read_text().count('test(') for file in files)}" in done.stdout
