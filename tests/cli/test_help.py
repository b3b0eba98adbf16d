"""What `--help` shows of every command: a whole sentence in the list, and a word on each option."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from uoarm.cli import main

_WIDTH = 78  # what click uses of a terminal of 80 columns
_BESIDE = 6  # columns around the names


def contexts(
    command: click.Command, parent: click.Context | None = None
) -> Iterator[click.Context]:
    context = click.Context(command, info_name=command.name or "uoarm", parent=parent)
    yield context
    if isinstance(command, click.Group):
        for name in sorted(command.commands):  # those of plugins are loaded only when they run
            yield from contexts(command.commands[name], context)


ALL = list(contexts(main))
GROUPS = [item for item in ALL if isinstance(item.command, click.Group)]


@pytest.mark.parametrize("context", GROUPS, ids=lambda item: str(item.command_path))
def test_the_list_of_commands_cuts_no_sentence(context: click.Context) -> None:
    group = context.command
    assert isinstance(group, click.Group)
    room = _WIDTH - _BESIDE - max(map(len, group.commands))
    shown = {name: command.get_short_help_str(room) for name, command in group.commands.items()}
    assert {name: text for name, text in shown.items() if not text or text.endswith("...")} == {}


@pytest.mark.parametrize("context", ALL, ids=lambda item: str(item.command_path))
def test_every_option_says_what_it_is_for(context: click.Context) -> None:
    options = [
        parameter for parameter in context.command.params if isinstance(parameter, click.Option)
    ]
    assert [option.opts for option in options if not option.help] == []
