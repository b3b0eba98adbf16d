"""What the scene says where something is missing, before it starts anything."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from tests.examples.healthbot import EXAMPLE
from tests.harness._needs import HEALTHBOT

from uoarm.testing import patience


def scene(*arguments: str, flags: tuple[str, ...] = (), path: str = "") -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, *flags, str(EXAMPLE / "scene.py"), *arguments],
        env={"PATH": path},
        capture_output=True,
        text=True,
        timeout=patience(),
        check=False,
    )
    return done.returncode, done.stderr


def test_without_packages_it_says_which_and_where_to_read() -> None:
    code, text = scene(flags=("-S",))
    assert code == 2
    assert "attrs is not installed: see examples/healthbot/README.md" in text.replace(
        "attr ", "attrs "
    )


@pytest.mark.needs(*HEALTHBOT)
def test_without_programs_it_says_what_to_install_and_what_does_not_run() -> None:
    code, text = scene("--visit")
    assert code == 2
    assert "Node.js 20.10 or later is not here (Debian: apt install nodejs)" in text
    assert "Chromium is not here (Debian: apt install chromium)" in text


@pytest.mark.needs(*HEALTHBOT)
def test_an_old_node_counts_as_none(tmp_path: Path) -> None:
    old = tmp_path / "node"
    old.write_text("#!/bin/sh\necho v18.20.4\n")
    old.chmod(0o755)
    code, text = scene("--visit", path=str(tmp_path))
    assert code == 2
    assert "Node.js" in text


@pytest.mark.needs(*HEALTHBOT)
def test_a_port_that_is_taken_is_reported_before_anything_is_started() -> None:
    with ExitStack() as stack:
        with suppress(OSError):  # another scene runs on it, which does as well
            stack.enter_context(socket.create_server(("127.0.0.1", 9281)))
        code, text = scene()
    assert code == 2
    assert re.search(r"^port \d+ is in use.*: --free-ports takes others$", text, re.MULTILINE)
