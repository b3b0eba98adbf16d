"""The log of every command: its level, its form, where it comes from, and what is not in it."""

from __future__ import annotations

import json
import logging
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st
from tests.cli.commands import members
from tests.processes import run_python
from tests.sweeps import for_all

from uoarm._encodable import printable
from uoarm._log_lines import HostFormatter, JsonFormatter, TextFormatter, read_host_line
from uoarm.cli import main
from uoarm.model import read_json

ROBOT = """
version: 1
bridges: {python: {host: HOST}}
functions:
  ticks:
    components:
      - {name: ticker, bridge: python, output: {endpoint: ["log_ticks:ticks"]}}
"""
COMPONENTS = """
import logging
from collections.abc import Iterator
from typing import TypedDict
class Tick(TypedDict):
    n: int
def ticks() -> Iterator[Tick]:
    logging.getLogger("uoarm.lab").debug("begins")
    logging.getLogger("uoarm.lab").warning("is odd\\nvery odd")
    yield {"n": 1}
"""
RECORD = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z (DEBUG|INFO|WARNING|ERROR) ([\w.]+): ")


def everything(group: click.Group) -> Iterator[click.Command]:
    for command in members(group).values():
        yield command
        if isinstance(command, click.Group):
            yield from everything(command)


@pytest.fixture(params=["here", "in a host"])
def file(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    (tmp_path / "log_ticks.py").write_text(COMPONENTS, encoding="utf-8")
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT.replace("HOST", str(request.param != "here").lower()), encoding="utf-8")
    return path


def run(*arguments: str | Path, env: dict[str, str] | None = None) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], env=env)


def in_process(*arguments: str | Path, **more: str) -> subprocess.CompletedProcess[str]:
    return run_python("-m", "uoarm", *arguments, env=more)


def records(stderr: str) -> list[tuple[str, str]]:
    return [found.groups() for found in map(RECORD.match, stderr.splitlines()) if found]  # type: ignore[misc]


@for_all("command", [main, *everything(main)], lambda command: command.name)
def test_every_command_has_the_options(command: click.Command) -> None:
    options = {name for parameter in command.params for name in parameter.opts}
    assert {"--log-level", "--log-format"} <= options


def test_a_warning_has_time_level_and_logger(file: Path) -> None:
    done = in_process("request", "ticks", file, "-n", "1")
    assert done.stdout == '{"n": 1}\n', done.stderr
    assert {level for level, _ in records(done.stderr)} == {"WARNING"}, done.stderr
    assert "is odd\n  very odd\n" in done.stderr


@pytest.mark.parametrize("file", ["here"], indirect=True)
@pytest.mark.parametrize("where", ["before", "after"])
def test_debug_has_the_control_plane(file: Path, where: str) -> None:
    option, words = ["--log-level", "debug"], ["request", "ticks", str(file), "-n", "1"]
    done = in_process(*(option + words if where == "before" else words + option))
    assert done.stdout == '{"n": 1}\n', done.stderr
    assert ("DEBUG", "uoarm.control") in records(done.stderr), done.stderr
    assert "DEBUG uoarm.lab: begins" in done.stderr


@pytest.mark.parametrize("file", ["in a host"], indirect=True)
def test_debug_has_what_hosts_write(file: Path) -> None:
    done = in_process("request", "ticks", file, "-n", "1", UOARM_LOG="debug")
    assert done.stdout == '{"n": 1}\n', done.stderr
    assert ("DEBUG", "uoarm.control") in records(done.stderr), done.stderr
    assert "DEBUG uoarm.host.python: uoarm.lab: begins" in done.stderr


@pytest.mark.parametrize("file", ["in a host"], indirect=True)
def test_one_logger_alone(file: Path) -> None:
    done = in_process("request", "ticks", file, "-n", "1", "--log-level", "uoarm.control=debug")
    debug = {name for level, name in records(done.stderr) if level == "DEBUG"}
    assert debug == {"uoarm.control"}, done.stderr


@pytest.mark.parametrize(
    ("file", "form"),
    [("here", {"UOARM_LOG": "info,json"}), ("in a host", {})],
    ids=["variable", "option"],
    indirect=["file"],
)
def test_json_is_one_object_a_line(file: Path, form: dict[str, str]) -> None:
    more = [] if form else ["--log-format", "json"]
    done = in_process("request", "ticks", file, "-n", "1", *more, **form)
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    assert lines, done
    assert all(line.keys() == {"time", "level", "logger", "text"} for line in lines)
    assert any(line["text"].endswith("is odd\nvery odd") for line in lines)


@pytest.mark.parametrize("file", ["in a host"], indirect=True)
def test_the_option_outranks_the_variable(file: Path) -> None:
    done = in_process(
        "request", "ticks", file, "-n", "1", "--log-level", "error", UOARM_LOG="debug"
    )
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("arguments", "env"),
    [
        (["list", "--log-level", "warnign"], {}),
        (["--log-level", "warnign", "list"], {}),
        (["list"], {"UOARM_LOG": "json,warnign"}),
    ],
)
def test_another_level_is_refused_with_a_near_one(
    arguments: list[str], env: dict[str, str]
) -> None:
    done = run(*arguments, env=env)
    said = " ".join(done.output.split())
    assert (done.exit_code, 'did you mean "warning"?' in said) == (2, True), said
    assert ("UOARM_LOG" if env else "--log-level") in said


def test_nothing_of_it_stays() -> None:
    before = logging.getLogger("uoarm").level, list(logging.getLogger().handlers)
    run("--log-level", "debug", "bridges")
    assert (logging.getLogger("uoarm").level, list(logging.getLogger().handlers)) == before


def made(text: str, *arguments: object) -> logging.LogRecord:
    return logging.LogRecord("uoarm.x", logging.WARNING, "", 0, text, arguments, None)


FORMATTERS = [TextFormatter(), JsonFormatter(), HostFormatter()]


def test_a_record_is_text_that_every_reader_takes() -> None:
    record = logging.LogRecord("uoarm", logging.INFO, "", 0, "half: %s", ("\ud800",), None)
    assert TextFormatter().format(record).endswith(r" uoarm: half: \ud800")
    assert read_json(JsonFormatter().format(record))["text"] == r"half: \ud800"


@pytest.mark.parametrize("formatter", FORMATTERS, ids=lambda item: type(item).__name__)
@pytest.mark.parametrize(
    "text",
    [
        "> Authorization: Bearer s3cret",
        "authorization=Basic s3cret",
        "offers uoarm.token.s3cret, uoarm",
        '{"Authorization": "Bearer s3cret"}',
        "connecting to mqtt://user:s3cret@broker:1883",
        "Cookie: session=s3cret",
        "< GET /metrics?token=s3cret HTTP/1.1",
        "ws://127.0.0.1:9080/?a=1&token=s3cret&b=2",
    ],
)
def test_no_secret_is_written(formatter: logging.Formatter, text: str) -> None:
    line = formatter.format(made("%s", text))
    assert "s3cret" not in line
    assert "***" in line


@pytest.mark.parametrize("formatter", FORMATTERS, ids=lambda item: type(item).__name__)
@pytest.mark.parametrize("forged", ["\n", "\r", "\r\n", "\x1b[2J", "\u2028", "\x85"])
def test_no_text_can_pass_for_a_record(formatter: logging.Formatter, forged: str) -> None:
    line = formatter.format(made(f"x{forged}2026-01-01T00:00:00.000Z ERROR uoarm: stopped"))
    assert not any(part.startswith("2026-01-01") for part in line.splitlines())


def test_a_long_record_of_a_host_is_one_line_that_can_be_read() -> None:
    line = HostFormatter().format(made("begins" + "é\n" * 10_000 + "ends"))
    level, text = read_host_line(line)
    assert len(line.encode()) < 8192
    assert (level, text.startswith("uoarm.x: begins"), text.endswith("ends")) == (30, True, True)
    assert read_host_line("a line of a component") == (None, "a line of a component")
    assert read_host_line("WARNING uoarm: of another version") == (30, "uoarm: of another version")


@given(st.text())
def test_printable_text_controls_nothing_and_says_what_was_there(text: str) -> None:
    shown = printable(text)
    assert not re.search(r"[^\n\t\x20-\x7e\xa0-\u2027\u202f-\u2065\u206a-\U0010ffff]", shown)
    assert printable(shown) == shown
    if text.isprintable():
        assert shown == text
