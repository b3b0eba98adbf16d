"""Plugins bring commands; a broken one hurts nobody else."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint

import click
import pytest
from click.testing import CliRunner

from uoarm.cli import _plugin_commands, main

seen: list[list[str]] = []


def program(arguments: list[str]) -> int:
    seen.append(arguments)
    return 7


@click.command()
@click.option("--loud", is_flag=True)
def shout(*, loud: bool) -> None:
    click.echo("HELLO" if loud else "hello")


@pytest.fixture(autouse=True)
def plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        EntryPoint("program", f"{__name__}:program", "uoarm.commands"),
        EntryPoint("shout", f"{__name__}:shout", "uoarm.commands"),
        EntryPoint("gone", "no_such_module:main", "uoarm.commands"),
    ]
    found: Callable[..., list[EntryPoint]] = lambda group: points  # noqa: E731 - a stand-in
    monkeypatch.setattr(_plugin_commands, "entry_points", found)


def test_a_function_gets_its_arguments_and_gives_the_exit_code() -> None:
    result = CliRunner().invoke(main, ["program", "--help", "-x", "1"])
    assert result.exit_code == 7
    assert seen.pop() == ["--help", "-x", "1"]


def test_a_click_command_runs_with_its_own_options() -> None:
    assert CliRunner().invoke(main, ["shout", "--loud"]).output == "HELLO\n"


def test_help_lists_them_all_and_loads_none() -> None:
    shown = CliRunner().invoke(main, ["--help"])
    assert shown.exit_code == 0
    assert "gone" in shown.output
    broken = CliRunner().invoke(main, ["gone"])
    assert broken.exit_code == 1
    assert "the plugin gone cannot be used: ModuleNotFoundError" in broken.output
