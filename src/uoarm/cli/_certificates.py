"""The command `uoarm certificates`: who may join from other machines."""

from __future__ import annotations

from pathlib import Path

import click

from uoarm.cli._shared import needing, reporting

__all__ = ["certificates"]


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
            from uoarm._certificates import Authority  # noqa: PLC0415 - needs an extra
        authority = Authority.of(Path(folder))
        if addresses:
            click.echo(f"the manager: {authority.certify_manager(addresses, days)}")
        for machine in machines:
            made = authority.certify_machine(machine, days)
            click.echo(f"machine {machine}: {made}; copy it, its .key and ca.pem there")
