"""What is made beside a robot: `uoarm env`, `uoarm certificates` and `uoarm new-bridge`."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import click

from uoarm import environments
from uoarm._raised import reason_of
from uoarm.bridge import Registry
from uoarm.cli._output import echo
from uoarm.cli._shared import (
    BRIDGE,
    REFUSED,
    fail,
    json_option,
    needing,
    print_json,
    print_warning,
    reading_words,
    reporting,
)
from uoarm.errors import PluginError

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
    with reading_words(PluginError):
        environments.environment_folder(name)
    with reporting():
        wanted = environments.requirements(plugin, distribution, more)
        made = environments.create(
            name, wanted, python=python, progress=echo, uv="" if no_uv else None
        )
        [found] = (
            environments.examine(environment)
            for environment in environments.listed()
            if environment.name == name
        )
    echo(f"environment {name} is ready: {made}")
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
        echo(_NONE, err=True)
    for environment in found:
        state = ", ".join(environment.requirements) if environment.is_whole else "incomplete"
        echo(f"{environment.name}: {state}")


@env.command()
@click.argument("name")
def remove(name: str) -> None:
    """Remove the environment NAME."""
    with reading_words(PluginError):
        environments.environment_folder(name)
    with reporting():
        environments.remove(name)
    echo(f"environment {name} is removed")


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
        echo(_NONE, err=True)
    else:
        for finding in found:
            facts = ", ".join(f"{key} {value}" for key, value in finding.facts.items())
            echo(f"{finding.name}: {finding.problem or facts}")
            for plugin, cause in finding.unusable.items():
                print_warning(f"{finding.name}: the plugin {plugin} cannot be used in it: {cause}")
    if any(finding.problem for finding in found):
        sys.exit(BRIDGE)


@click.command()
@click.option(
    "--manager",
    "addresses",
    multiple=True,
    help="Address or name under which machines reach the manager; may be given again.",
)
@click.option("--machine", "machines", multiple=True, help="Name of a machine; likewise.")
@click.option("--folder", default="certificates", show_default=True, help="Where they are.")
@click.option(
    "--days",
    type=click.IntRange(1, 3650),
    default=730,
    show_default=True,
    help="For which they are good.",
)
def certificates(
    addresses: tuple[str, ...], machines: tuple[str, ...], folder: str, days: int
) -> None:
    """Make the certificates that machines join with.

    For the manager and for machines whose bridge hosts join it. The first time, an authority is
    made, too. Private keys can be read by their owner only.
    """
    if not addresses and not machines:
        raise click.UsageError("say for whom: --manager ADDRESS, --machine NAME, or both")
    with reporting():
        with needing("certificates"):
            from uoarm._support.certificates import (  # noqa: PLC0415 - needs an extra
                Authority,
                check_address,
                check_machine,
            )
        with reading_words():  # before anything is made
            for address in addresses:
                check_address(address)
            for machine in machines:
                check_machine(machine)
        authority = Authority.of(Path(folder))
        if addresses:
            echo(f"the manager: {authority.certify_manager(addresses, days)}")
        for machine in machines:
            made = authority.certify_machine(machine, days)
            echo(f"machine {machine}: {made}; copy it, its .key and ca.pem there")


if TYPE_CHECKING:
    from importlib.abc import Traversable


_NAME = re.compile(r"(?=.{1,40}\Z)[a-z][a-z0-9]*(_[a-z0-9]+)*")  # also a distribution's
_PLACES = re.compile(r"uoarm-example|Example|example(?!s\b)")  # not the `examples` of a schema
_SKIPPED = {"__pycache__"}


@click.command("new-bridge")
@click.argument("name")
@click.option(
    "--into",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path(),
    help="Folder in which uoarm-NAME is made; the current one unless given.",
)
def new_bridge(name: str, into: Path) -> None:
    """Make a bridge plugin to start from, with its tests.

    The project is called uoarm-NAME.
    """
    if not _NAME.fullmatch(name):
        raise click.BadParameter(
            f"{name!r}: use small letters, digits and single _ between them, a letter first, "
            "40 at most",
            param_hint="NAME",
        )
    if name in Registry().types:
        taken = f"a plugin {name!r} is installed already: two of one name cannot be used"
        raise click.BadParameter(f"{taken}; choose another", param_hint="NAME")
    project = into / f"uoarm-{name.replace('_', '-')}"
    if project.exists():
        fail(f"{project} is there already; nothing was changed", REFUSED, "UOA-003")
    try:
        for place, text in _files(files("uoarm.cli").joinpath("template"), ""):
            target = project / _named(place, name)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(_named(text, name), encoding="utf-8")
    except OSError as error:
        shutil.rmtree(project, ignore_errors=True)
        fail(f"{project} cannot be made: {reason_of(error, project)}", REFUSED, "UOA-003")
    echo(f"made {project}; next:\n")
    echo(f"  cd {project}\n  pip install -e '.[dev]'\n  pytest -x")


def _files(folder: Traversable, prefix: str) -> Iterator[tuple[str, str]]:
    for entry in sorted(folder.iterdir(), key=lambda path: path.name):
        if entry.name in _SKIPPED:
            continue
        if entry.is_dir():
            yield from _files(entry, f"{prefix}{entry.name}/")
        else:
            yield f"{prefix}{entry.name}", entry.read_text(encoding="utf-8")


def _named(text: str, name: str) -> str:
    """Put a name where the template says example; distributions are written with hyphens."""
    camel = "".join(part.title() for part in name.split("_"))
    names = {"uoarm-example": f"uoarm-{name.replace('_', '-')}", "Example": camel}
    return _PLACES.sub(lambda place: names.get(place[0], name), text)
