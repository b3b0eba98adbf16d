"""The commands `uoarm env`: Python environments for bridge hosts."""

from __future__ import annotations

import sys

import click

from uoarm import environments
from uoarm.cli._shared import BRIDGE, json_option, print_json, print_warning, reporting

__all__ = ["env"]

_NONE = "there are no environments: make one with uoarm env create NAME --plugin PLUGIN"


@click.group()
def env() -> None:
    """Make and remove Python environments for bridge hosts."""


@env.command()
@click.argument("name")
@click.option("--plugin", required=True, help="Bridge plugin that will run in it.")
@click.option("--distribution", help="Version of the plugin's middleware, such as jazzy.")
@click.option("--with", "more", multiple=True, help="Further requirement, or path of a project.")
@click.option("--python", help="Python to build on: a path, or a version where uv is installed.")
@click.option("--no-uv", is_flag=True, help="Use venv and pip although uv is installed.")
def create(
    name: str,
    plugin: str,
    distribution: str | None,
    more: tuple[str, ...],
    python: str | None,
    *,
    no_uv: bool,
) -> None:
    """Make the environment NAME.

    A bridge runs in it with `host: {environment: NAME}`.
    """
    with reporting():
        wanted = environments.requirements(plugin, distribution, more)
        made = environments.create(
            name, wanted, python=python, progress=click.echo, uv="" if no_uv else None
        )
        [found] = (
            environments.examine(environment)
            for environment in environments.listed()
            if environment.name == name
        )
    click.echo(f"environment {name} is ready: {made}")
    if plugin in found.unusable:
        hint = "--distribution names the middleware to install with it"
        print_warning(
            f"the plugin {plugin} cannot be used in it yet ({hint}): {found.unusable[plugin]}"
        )


@env.command("list")
@json_option
def list_environments(*, as_json: bool) -> None:
    """List the environments."""
    found = environments.listed()
    if as_json:
        print_json(
            [
                {"name": environment.name, "requirements": environment.requirements}
                for environment in found
            ]
        )
        return
    if not found:
        click.echo(_NONE, err=True)
    for environment in found:
        state = ", ".join(environment.requirements) if environment.is_whole else "incomplete"
        click.echo(f"{environment.name}: {state}")


@env.command()
@click.argument("name")
def remove(name: str) -> None:
    """Remove the environment NAME."""
    with reporting():
        environments.remove(name)
    click.echo(f"environment {name} is removed")


@env.command()
@json_option
def doctor(*, as_json: bool) -> None:
    """Say what environments have and whether hosts would start.

    Exit code 4 where one would not.
    """
    found = [environments.examine(environment) for environment in environments.listed()]
    if as_json:
        print_json(found)
    elif not found:
        click.echo(_NONE, err=True)
    else:
        for finding in found:
            facts = ", ".join(f"{key} {value}" for key, value in finding.facts.items())
            click.echo(f"{finding.name}: {finding.problem or facts}")
            for plugin, cause in finding.unusable.items():
                print_warning(f"{finding.name}: the plugin {plugin} cannot be used in it: {cause}")
    if any(finding.problem for finding in found):
        sys.exit(BRIDGE)
