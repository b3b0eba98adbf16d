"""The command makes devices that a bridge can use, and ends when it is asked to."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click import BadParameter
from click.testing import CliRunner
from lines import LIMIT
from rigs import Events, bridged, endpoint
from uoarm_rocos._command import rocos

from uoarm.cli import main as uoarm
from uoarm.model import MessageStructure

ANY = MessageStructure(True)
PROJECT = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
[SCRIPT] = re.findall(r'^uoarm-rocos = "(\w+):main"$', PROJECT, re.MULTILINE)
ENTRY = f"from {SCRIPT} import main; main()"
"""What the installed script does."""


@pytest.mark.parametrize("words", [[], ["simulate"]])
def test_help_cuts_no_sentence(words: list[str]) -> None:
    shown = CliRunner().invoke(rocos, [*words, "--help"], terminal_width=80)
    assert (shown.exit_code, "..." in shown.output.partition("Commands:")[2]) == (0, False)


@contextmanager
def simulating(*words: str) -> Iterator[str]:
    """A simulator as a process; the URL that it prints."""
    command = [sys.executable, "-c", ENTRY, "simulate", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        try:
            yield process.stdout.readline().strip()
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(LIMIT) == 0


@pytest.mark.parametrize("late", ["attrs", "click"])
def test_ctrl_c_while_it_imports_ends_it_in_silence(late: str, tmp_path: Path) -> None:
    waiting = "print('it imports', flush=True)\nimport signal\nwhile True:\n    signal.pause()\n"
    (tmp_path / f"{late}.py").write_text(waiting)
    command = [sys.executable, "-c", ENTRY, "simulate", "robot", "--tcp", "0"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=tmp_path, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout
        assert process.stdout.readline() == "it imports\n"
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=LIMIT) == ("", "")
    assert process.returncode == -signal.SIGINT, "a shell shows it as 130"


def test_a_robot_over_tcp() -> None:
    with simulating("robot", "--tcp", "0") as url, bridged(robot={"url": url}) as (bridge, _):
        reply = bridge.call(endpoint("robot", "echo", "service"), {"text": "hello"})
        assert reply == {"text": "hello"}


def test_a_taken_place_is_named(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused = CliRunner().invoke(uoarm, ["rocos", "simulate", "robot", "--tcp", str(port)])
    assert f"cannot listen on 127.0.0.1:{port}: Address already in use\n" in refused.output
    assert refused.exit_code == 5
    (tmp_path / "notes").write_text("of a person")
    for name, why in (("nowhere/clip", "No such file or directory"), ("notes", "File exists")):
        link = str(tmp_path / name)
        refused = CliRunner().invoke(uoarm, ["rocos", "simulate", "robot", "--pty", "--link", link])
        assert f"{link} cannot be opened: {why}\n" in refused.output
    assert (tmp_path / "notes").read_text() == "of a person"


def test_an_oximeter_on_a_pty_with_a_link(tmp_path: Path) -> None:
    link = str(tmp_path / "clip")
    with simulating("oximeter", "--pty", "--link", link, "--spo2", "91") as url:
        assert url == link
        clip: dict[str, object] = {"driver": "contec-cms50dplus", "url": url}
        with bridged(clip=clip) as (bridge, _):
            got = Events()
            bridge.open_source(endpoint("clip", "pulseOximetry"), ANY, got)
            assert got.until(lambda item: "spo2" in item)["spo2"] == 91
    assert not Path(link).is_symlink()


def test_a_blood_pressure_monitor_over_tcp() -> None:
    with simulating("blood-pressure", "--tcp", "0", "--interval", "0.2") as url:
        assert url.startswith("socket://127.0.0.1:")
        cuff: dict[str, object] = {"driver": "and-ua767pbt", "url": url}
        with bridged(cuff=cuff) as (bridge, _):
            reading = bridge.call(endpoint("cuff", "bloodPressure", "service"), {}, timeout=LIMIT)
            assert reading["systolic"] > reading["diastolic"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["robot"], "say where"),
        (["robot", "--pty", "--tcp", "0"], "say where"),
        (["robot", "--tcp", "0", "--link", "x"], "--link goes with --pty"),
        (["robot", "--tcp", "0", "--catalogue", "not-there.xml"], "not-there.xml"),
        (["oximeter", "--tcp", "0", "--format", "masimo"], "masimo"),
        (["blood-pressure", "--tcp", "0", "--systolic", "70", "--diastolic", "80"], "above"),
    ],
)
def test_what_makes_no_sense_is_said(words: list[str], said: str) -> None:
    result = CliRunner().invoke(uoarm, ["rocos", "simulate", *words])
    assert result.exit_code != 0
    assert said in result.output


@pytest.mark.parametrize(
    "words",
    [
        ["robot", "--drop", "nan"],
        ["robot", "--garble", "nan"],
        ["robot", "--delay", "nan"],
        ["robot", "--disconnect", "nan"],
        ["oximeter", "--spo2", "nan"],
        ["oximeter", "--apnoea", "nan"],
        ["blood-pressure", "--interval", "nan"],
    ],
)
def test_what_is_no_number_is_in_no_range(words: list[str]) -> None:
    done = CliRunner().invoke(rocos, ["simulate", *words, "--tcp", "0"], standalone_mode=False)
    assert isinstance(done.exception, BadParameter)
    assert "nan is not in the range" in str(done.exception)
