"""`uoarm explain`: what an error code means."""

from __future__ import annotations

import click

from uoarm.cli._shared import json_option, print_json, reporting

__all__ = ["explain"]


@click.command()
@click.argument("code", required=False)
@click.option("--markdown", is_flag=True, help="Write the page of all codes.")
@json_option
def explain(code: str | None, *, markdown: bool, as_json: bool) -> None:
    """Say what an error CODE means and what to do.

    Without CODE: a line about each there is.
    """
    from uoarm import error_codes  # noqa: PLC0415 - when first needed

    with reporting():
        entry = None if code is None else error_codes.explain(code)
    if as_json:
        print_json(tuple(error_codes.ERROR_CODES.values()) if entry is None else entry)
    elif markdown:
        click.echo(error_codes.markdown(), nl=False)
    elif entry is not None:
        click.echo(entry)
    else:
        for known in error_codes.ERROR_CODES.values():
            click.echo(f"{known.code}  {known.title}")
