"""What `--help` shows of every command: a whole sentence in the list, and a word on each option."""

from __future__ import annotations

from collections.abc import Iterator

import click
from click.testing import CliRunner
from tests.cli.commands import members
from tests.sweeps import for_all

from uoarm.cli import main
from uoarm.cli._main import COMMANDS

_WIDTH = 78  # what click uses of a terminal of 80 columns
_BESIDE = 6  # columns around the names


def contexts(
    command: click.Command, parent: click.Context | None = None
) -> Iterator[click.Context]:
    context = click.Context(command, info_name=command.name or "uoarm", parent=parent)
    yield context
    if isinstance(command, click.Group):
        for member in members(command).values():
            yield from contexts(member, context)


ALL = list(contexts(main))
GROUPS = [item for item in ALL if isinstance(item.command, click.Group)]


@for_all("context", GROUPS, lambda context: context.command_path)
def test_the_list_of_commands_cuts_no_sentence(context: click.Context) -> None:
    group = context.command
    assert isinstance(group, click.Group)
    commands = members(group)
    room = _WIDTH - _BESIDE - max(map(len, commands))
    shown = {name: command.get_short_help_str(room) for name, command in commands.items()}
    assert {name: text for name, text in shown.items() if not text or text.endswith("...")} == {}


@for_all("context", ALL, lambda context: context.command_path)
def test_every_option_says_what_it_is_for(context: click.Context) -> None:
    options = [
        parameter for parameter in context.command.params if isinstance(parameter, click.Option)
    ]
    assert [option.opts for option in options if not option.help] == []


@for_all("name", COMMANDS)
def test_the_list_says_of_a_command_what_its_own_help_says(name: str) -> None:
    command = main.get_command(click.Context(main), name)
    assert command is not None
    assert command.name == name
    assert command.get_short_help_str(_WIDTH) == COMMANDS[name][2]


def test_help_lists_every_command() -> None:
    shown = CliRunner().invoke(main, ["--help"]).output
    assert [name for name, (_, _, line) in COMMANDS.items() if f"{name} " not in shown] == []
    assert [line for _, _, line in COMMANDS.values() if line not in shown] == []
