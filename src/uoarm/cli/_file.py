"""The configuration file of a command: every command that has one is given it the same way."""

from __future__ import annotations

import functools
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar, cast

import click
from click.core import ParameterSource

from uoarm.cli._shared import FunctionArgument

__all__ = ["STANDARD", "DefaultConfiguration", "takes_configuration"]

STANDARD = "robot.yaml"
_ENDINGS = (".yaml", ".yml")
_Command = TypeVar("_Command", bound=Callable[..., Any])


class DefaultConfiguration(Enum):
    """Which configuration a command takes where none is named; the value is said in its help."""

    STANDARD = STANDARD
    IF_THERE = f"{STANDARD}, if it is there"
    NONE = ""


def takes_configuration(
    *words: str, unnamed: DefaultConfiguration = DefaultConfiguration.STANDARD, listed: str = ""
) -> Callable[[_Command], _Command]:
    """Give a command its configuration as `file`: written as a word, with -f or in UOARM_CONFIG.

    A word that ends as files of YAML do is the configuration wherever it stands among the words;
    any other is it after all words of the command's own.

    Args:
        words: the command's own arguments before it, each of one word, in their order.
        unnamed: what holds where none is named.
        listed: the command's argument of any number of words, in place of `words`.
    """

    def add(command: _Command) -> _Command:
        @functools.wraps(command)
        def with_file(**options: Any) -> Any:
            context = click.get_current_context()
            if listed:
                files = [word for word in options[listed] if word.endswith(_ENDINGS)]
                options[listed] = tuple(word for word in options[listed] if word not in files)
                place = files[0] if files else None
            else:
                place = _sorted(context, words, options)
            options["file"] = file = _chosen(context, place, options["file"], unnamed)
            for parameter in context.command.params:
                if isinstance(parameter, FunctionArgument) and options[parameter.name] is None:
                    raise parameter.missing(context, file or STANDARD)
            return command(**options)

        option = click.option(
            "-f",
            "--file",
            "file",
            envvar="UOARM_CONFIG",
            show_default=unnamed.value,
            type=click.Path(dir_okay=False),
            help="Configuration file, in place of FILE; also UOARM_CONFIG.",
        )
        if listed:
            return cast("_Command", option(with_file))
        argument = click.argument(
            "place", metavar="[FILE]", required=False, type=click.Path(dir_okay=False)
        )
        return cast("_Command", argument(option(with_file)))

    return add


def _sorted(context: click.Context, words: tuple[str, ...], options: dict[str, Any]) -> str | None:
    """Give each word of a command what is meant for it; return the configuration among them."""
    place: str | None = options.pop("place")
    if place is not None and place.endswith(_ENDINGS):
        return place
    is_optioned = context.get_parameter_source("file") is ParameterSource.COMMANDLINE
    given = [
        options[word]
        for word in words
        if context.get_parameter_source(word) is ParameterSource.COMMANDLINE
    ]
    files = [word for word in given if word.endswith(_ENDINGS)]
    if not files or (is_optioned and place is None):
        return place
    given.remove(files[0])
    if place is not None:
        given.append(place)
    for parameter in context.command.params:
        name = parameter.name or ""
        if name in words:
            if not given and parameter.required:
                raise click.MissingParameter(ctx=context, param=parameter)
            is_function = isinstance(parameter, FunctionArgument)
            default = None if is_function else parameter.get_default(context)
            options[name] = given.pop(0) if given else default
    return cast("str", files[0])


def _chosen(
    context: click.Context, place: str | None, optioned: str | None, unnamed: DefaultConfiguration
) -> str | None:
    """Return the one file that is named, or what holds where none is."""
    is_optioned = context.get_parameter_source("file") is ParameterSource.COMMANDLINE
    if place is not None and is_optioned and place != optioned:
        raise click.UsageError(f"the configuration is named twice: {place} and -f {optioned}")
    named = place if place is not None else optioned
    if named is not None or unnamed is DefaultConfiguration.NONE:
        return named
    return STANDARD if unnamed is DefaultConfiguration.STANDARD or Path(STANDARD).exists() else None
