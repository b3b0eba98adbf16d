"""Plugins bring commands; a broken one hurts no other."""

from __future__ import annotations

import os
import re
import resource
from collections.abc import Callable
from importlib.metadata import Distribution, EntryPoint
from pathlib import Path

import pytest
from click.testing import CliRunner

from uoarm.cli import _main, main
from uoarm.errors import CommandLineError
from uoarm.plugins import Command, CommandParser, hookimpl

seen: list[list[str]] = []


def program(arguments: list[str]) -> int:
    seen.append(arguments)
    return 7


def limited(_: list[str]) -> int:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        return os.pipe()[0]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@hookimpl
def uoarm_commands() -> list[Command]:
    return [
        Command("other", lambda _: 0, contract=1),
        Command("program", program, contract=1),
        Command("limited", limited, contract=1),
        Command("older", program, contract=0),
    ]


@pytest.fixture(autouse=True)
def plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        *(
            EntryPoint(name, __name__, "uoarm.commands")
            for name in ("program", "limited", "older", "none")
        ),
        EntryPoint("silent", "json", "uoarm.commands"),
        EntryPoint("gone", "no_such_module", "uoarm.commands"),
    ]
    found: Callable[..., list[EntryPoint]] = lambda group: points  # noqa: E731 - a stand-in
    monkeypatch.setattr(_main, "entry_points", found)


def test_a_command_gets_its_arguments_and_gives_the_exit_code() -> None:
    result = CliRunner().invoke(main, ["program", "--help", "-x", "1"])
    assert result.exit_code == 7
    assert seen.pop() == ["--help", "-x", "1"]


def test_help_lists_them_all_and_loads_none() -> None:
    shown = CliRunner().invoke(main, ["--help"])
    assert shown.exit_code == 0
    assert "gone" in shown.output


def test_help_names_the_distribution_that_brings_a_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = tmp_path / "uoarm_fleet_tools-1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: uoarm-fleet-tools\nVersion: 1\n"
    )
    (installed / "entry_points.txt").write_text("[uoarm.commands]\nships = no_such_module\n")
    points = Distribution.at(installed).entry_points
    monkeypatch.setattr(_main, "entry_points", lambda group: points)
    shown = CliRunner().invoke(main, ["--help"])
    assert re.search(r"ships +Of the plugin uoarm-fleet-tools\.", shown.output)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("gone", "the plugin gone cannot be used: ModuleNotFoundError"),
        ("silent", "PluginError: it implements no uoarm_commands hook"),
        ("none", "PluginError: it has no command 'none'"),
        ("limited", "error: Too many open files: a limit of this process, user or machine is"),
        ("older", "it is written for version 0 of the hooks"),
    ],
)
def test_one_that_cannot_be_run_says_why(name: str, said: str) -> None:
    result = CliRunner().invoke(main, [name])
    assert result.exit_code == 4
    assert said in result.output
    assert not seen


@pytest.mark.parametrize(
    "words", [[""], ["-f", ""], ["--file", ""], ["--file="], ["inner", ""], ["inner", "--name="]]
)
def test_an_empty_word_is_wrong_usage(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    parser = CommandParser("uoarm program")
    if words[0] == "inner":
        parser.add_subparsers().add_parser("inner").add_argument("--name")
    else:
        parser.add_configuration()
    with pytest.raises(CommandLineError, match="expected some text, got ''"):
        parser.parse_args(words)
    assert capsys.readouterr().err.startswith("usage: ")


@pytest.mark.parametrize(
    ("words", "variable", "file"),
    [
        ([], None, "robot.yaml"),
        ([], "lab.yaml", "lab.yaml"),
        (["a.yaml"], "lab.yaml", "a.yaml"),
        (["-f", "b.yaml"], "lab.yaml", "b.yaml"),
        (["--file", "b.yaml", "b.yaml"], None, "b.yaml"),
    ],
)
def test_it_takes_its_configuration_as_every_command_does(
    words: list[str], variable: str | None, file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("UOARM_CONFIG", raising=False)
    if variable is not None:
        monkeypatch.setenv("UOARM_CONFIG", variable)
    parser = CommandParser("uoarm program")
    parser.add_configuration()
    assert parser.configuration(parser.parse_args(words)) == file
    with pytest.raises(CommandLineError, match=r"named twice: a\.yaml and -f b\.yaml"):
        parser.configuration(parser.parse_args(["a.yaml", "-f", "b.yaml"]))
