"""`uoarm schema check A.json B.json`, also as `python -m uoarm.schema`."""

from __future__ import annotations

import errno
import json
import math
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from uoarm.schema._check import check
from uoarm.schema._errors import SchemaError
from uoarm.schema._verdict import Verdict

__all__ = ["check_files", "schema"]

_UNDECIDED = 3
_UNREADABLE = 2
_UNPRINTED = 6  # as of all commands
_ERROR_CODE = "UOA-101"
_MOST_OCTETS = 64_000_000


class _UnreadableError(Exception):
    """A file is not there, or no JSON; the text says which, and why."""


@click.group()
def schema() -> None:
    """Message structures on their own."""


@schema.command("check")
@click.argument("producer", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("consumer", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the verdict as JSON.")
def check_files(producer: Path, consumer: Path, *, as_json: bool) -> None:
    """Say whether every message of PRODUCER is accepted by CONSUMER.

    Exit codes: 0 compatible, 1 incompatible, 2 not a schema, 3 undecided, 6 where the verdict
    cannot be printed.
    """
    try:
        verdict = check(_read(producer), _read(consumer))
    except (SchemaError, _UnreadableError) as error:
        text = f"not a JSON Schema: {error}" if isinstance(error, SchemaError) else str(error)
        if as_json:
            _print(json.dumps({"error": text, "error_code": _ERROR_CODE}))
        click.echo(text, err=True)
        sys.exit(_UNREADABLE)
    _print(json.dumps(verdict.to_dict(), indent=2) if as_json else _sentences(verdict))
    sys.exit(0 if verdict.compatible else 1 if verdict.incompatible else _UNDECIDED)


def _print(text: str) -> None:
    """Print, and exit where that is not possible: no verdict must seem to be one.

    Where what is printed is read no more, as by `head`, nothing is said.
    """
    try:
        click.echo(text)
    except OSError as error:
        with suppress(OSError, ValueError):  # what waits would fail once more when Python ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno != errno.EPIPE:
            click.echo(f"error: nothing more can be written: {error.strerror}", err=True)
        sys.exit(_UNPRINTED)


def _read(path: Path) -> Any:
    # As `uoarm._support.files` words it, which what stands alone does not import.
    try:
        with path.open("rb") as stream:  # a device could go on for ever
            raw = stream.read(_MOST_OCTETS + 1)
        if len(raw) > _MOST_OCTETS:
            why = f"it has more than {_MOST_OCTETS:,} bytes"
            raise _UnreadableError(f"{path}: the file cannot be read: {why}")
        text = raw.decode("utf-8")
    except OSError as error:
        why = error.strerror or str(error)
        raise _UnreadableError(f"{path}: the file cannot be read: {why}") from error
    except UnicodeDecodeError as error:
        why = f"byte {error.start + 1:,} cannot be decoded (save it as UTF-8)"
        raise _UnreadableError(f"{path}: the file is not UTF-8: {why}") from error
    try:
        read = json.loads(
            text, object_pairs_hook=_mapping, parse_float=_number, parse_constant=_refuse
        )
        if "\\u" in text:
            json.dumps(read, ensure_ascii=False).encode()  # half of a surrogate pair is no text
    except (ValueError, RecursionError) as error:
        raise _UnreadableError(f"{path}: not JSON: {error}") from error
    return read


def _mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a key that is given twice: JSON's readers disagree on which of the two is meant."""
    made: dict[str, Any] = {}
    for key, value in pairs:
        if key in made:
            raise ValueError(f"the key {json.dumps(key)} is given twice in one object")
        made[key] = value
    return made


def _number(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{text[:40]} is beyond what a number of 64 bits can hold")
    return number


def _refuse(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _sentences(verdict: Verdict) -> str:
    if verdict.undecided is not None:
        return f"undecided: {verdict.undecided}"
    lines = ["compatible" if verdict.compatible else "incompatible"]
    for reason in verdict.reasons:
        lines.append(f"  {reason.path or 'the message'}: {reason.sentence}")
        lines.append(f"    may be emitted: {reason.producer}")
        lines.append(f"    is taken:       {reason.consumer}")
    if verdict.incompatible:
        text = json.dumps(verdict.excerpt if verdict.abridged else verdict.counterexample)
        what = "counterexample, in short" if verdict.abridged else "counterexample"
        lines.append(f"  {what}: {text[:400]}")
    lines += [f"  note, {loss.path or 'the message'}: {loss.sentence}" for loss in verdict.losses]
    lines += [
        f"  note, a pattern: {pattern!r} is read as ECMA-262 does; other engines may differ"
        for pattern in verdict.disputed_patterns
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    schema(prog_name="python -m uoarm.schema")
