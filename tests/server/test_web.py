"""The page's own code where it is pure: run by node."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

TESTS = Path(__file__).parent / "web"
OLDEST = 20


def find_node() -> str:
    node = "node"
    version = subprocess.run([node, "--version"], capture_output=True, text=True, check=True).stdout
    if int(version.removeprefix("v").partition(".")[0]) < OLDEST:
        pytest.skip(f"node {version.strip()} is older than {OLDEST}")
    return node


@pytest.mark.needs("node")
def test_the_pages_code_does_what_it_says() -> None:
    files = [str(path) for path in sorted(TESTS.glob("*.test.mjs"))]
    done = subprocess.run(
        [find_node(), "--test", *files], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"# pass {sum(Path(file).read_text().count('test(') for file in files)}" in done.stdout
