"""The page for people without a robot: what it prints is what its command prints."""

from __future__ import annotations

import re
from pathlib import Path

from tests.processes import run_python

PAGE = Path(__file__).parents[2] / "docs" / "schema-alone.md"


def test_the_command_of_the_page_answers_as_printed(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    files = dict(re.findall(r"`(\w+\.json)`:\n\n```json\n(.*?)```", text, re.DOTALL))
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    [command] = re.findall(r"^python (-m uoarm\.schema check .*)$", text, re.MULTILINE)
    [printed] = re.findall(r"```\n(incompatible\n.*?)```", text, re.DOTALL)
    done = run_python(*command.split(), cwd=tmp_path)
    assert (done.stdout, done.returncode) == (printed, 1), done.stderr
