"""Whatever command is used wrongly says so with a code of errors, in text and in JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from uoarm.cli import main
from uoarm.cli._main import COMMANDS
from uoarm.error_codes import ERROR_CODES

PLUGINS = {point.name for point in entry_points(group="uoarm.commands")}


def _commands() -> Iterator[tuple[str, ...]]:
    """Yield the words of every command, those within groups too."""
    yield ()
    root = click.Context(main)
    for name in sorted(PLUGINS | {*COMMANDS}):
        yield (name,)
        command = main.get_command(root, name)
        if isinstance(command, click.Group):
            yield from ((name, member) for member in sorted(command.commands))


@pytest.mark.parametrize("words", list(_commands()), ids=" ".join)
@pytest.mark.parametrize("form", [(), ("--json",)], ids=["text", "json"])
def test_an_option_that_there_is_not_has_a_code(
    words: tuple[str, ...], form: tuple[str, ...]
) -> None:
    done = CliRunner().invoke(main, [*words, "--no-such-option", *form])
    assert done.exit_code == 2, done.output
    assert done.stderr.splitlines()[-1] == "uoarm explain UOA-002 says more"
    if form:
        reply = json.loads(done.stdout)
        assert (reply["error_code"], reply["error"] != "") == ("UOA-002", True)
        assert f"error: {reply['error']}" in done.stderr
    else:
        assert done.stdout == ""


@pytest.mark.parametrize(
    "words",
    [
        ("no-such-command",),
        ("call",),
        ("call", "greeting", "{"),
        ("explain", "--json", "UOA-101", "UOA-102"),
        ("resolve", "camera", "--timeout", "soon"),
        ("token", "tablet"),
        ("status", "--url", "http://nowhere/"),
        ("--log-level", "loud", "list"),
        ("lock", "--against", "other.lock"),
        ("new-bridge", "No Name"),
        ("explain", "UOA-999"),
        ("host", "--join", "tcp/192.0.2.1:7447", "--machine", "arm"),
        *((name, "--no-such-option") for name in sorted(PLUGINS)),
    ],
    ids=" ".join,
)
def test_other_wrong_words_have_one_too(words: tuple[str, ...]) -> None:
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2, done.output
    assert done.stderr.splitlines()[-1] == "uoarm explain UOA-002 says more"


def test_the_variable_of_the_log_has_one_too() -> None:
    done = CliRunner(env={"UOARM_LOG": "loud"}).invoke(main, ["list"])
    assert (done.exit_code, done.stderr.splitlines()[-1]) == (
        2,
        "uoarm explain UOA-002 says more",
    )


def test_an_error_is_an_object_of_json_and_help_is_none(tmp_path: Path) -> None:
    missing = CliRunner().invoke(main, ["list", str(tmp_path / "robot.yaml"), "--json"])
    assert missing.exit_code == 3
    assert json.loads(missing.stdout)["error_code"] == "UOA-101"
    shown = CliRunner().invoke(main, ["env", "--help"])
    assert (shown.exit_code, shown.stderr) == (0, "")
    assert CliRunner().invoke(main, ["explain", "002"]).stdout.startswith("UOA-002")
    assert "UOA-002" in ERROR_CODES
