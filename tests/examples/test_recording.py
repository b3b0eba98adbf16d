"""The example of recordings, command by command, as its page has them."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from uoarm.cli import main

EXAMPLE = Path(__file__).parents[2] / "examples" / "recording"


def test_a_recording_takes_the_place_of_what_was_unplugged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(EXAMPLE, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    page = (EXAMPLE / "README.md").read_text()
    record, request, check = re.findall(r"^uoarm (.*)$", page, re.MULTILINE)
    done = CliRunner().invoke(main, shlex.split(record))
    assert (done.exit_code, "temperature: 20 messages" in done.output) == (0, True), done.output
    done = CliRunner().invoke(main, [*shlex.split(request), "--json"])
    assert done.exit_code == 0, done.output
    fires = [json.loads(line)["fire"] for line in done.stdout.splitlines() if line[:1] == "{"]
    # Of the ten before the end some may be lost with it, which the gap counts.
    assert fires[-20:] == [20.0 + 5 * number > 90 for number in range(20)]
    done = CliRunner().invoke(main, shlex.split(check))
    assert (done.exit_code, "20 fit, 0 do not" in done.output) == (0, True), done.output


def test_the_notebook_gives_what_stands_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(EXAMPLE, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    cells = json.loads((EXAMPLE / "look.ipynb").read_text("utf-8"))["cells"]
    programs = [cell for cell in cells if cell["cell_type"] == "code"]
    assert len(programs) == 4
    names: dict[str, object] = {}
    for cell in programs:
        exec("".join(cell["source"]), names)  # as a kernel does
        (output,) = cell["outputs"]
        assert capsys.readouterr().out == "".join(output["text"])
