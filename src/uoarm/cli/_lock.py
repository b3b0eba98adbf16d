"""`uoarm lock`, what plans rest on and what a difference of it breaks; `uoarm types` of that."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree as ET

import click
from attrs import evolve

import uoarm
from uoarm import RobotManager, environments
from uoarm._lock import (
    Lock,
    LockError,
    LockFinding,
    LockOutcome,
    compare,
    differing_packages,
    read_lock,
    read_schemas,
    record,
    uncompared_types,
    write_lock,
)
from uoarm._raised import reason_of
from uoarm._support.files import lock_path, write_whole
from uoarm._types import read_functions, write_document, write_python, write_typescript
from uoarm.bridge import Registry
from uoarm.cli._output import echo
from uoarm.cli._shared import (
    CONFIGURATION_ENDINGS,
    REFUSED,
    hold_apart,
    hold_to,
    print_warning,
    reporting,
    takes_configuration,
)
from uoarm.config import load
from uoarm.errors import ResolutionError
from uoarm.model import Plan, to_json, write_json

_RULES: Mapping[LockOutcome, tuple[str, str, str]] = {
    LockOutcome.BREAKS: ("breaks", "error", "Not every message fits any more."),
    LockOutcome.FITS_WITH_MAP: ("fits-with-a-map", "error", "Messages fit with a map only."),
    LockOutcome.UNDECIDED: ("undecided", "warning", "Whether messages fit cannot be decided."),
}


def _text(findings: list[LockFinding], _: Path) -> str:
    lines = []
    for finding in findings:
        if finding.changed:
            lines.append(_sentence(finding))
            lines += (f"    {line}" for line in finding.suggestion.splitlines())
    counts = Counter(finding.outcome for finding in findings)
    lines.append(", ".join(f"{kind.value}: {counts[kind]}" for kind in LockOutcome))
    return "\n".join(lines)


def _json(findings: list[LockFinding], _: Path) -> str:
    return write_json(to_json({"findings": findings}), indent=2)


def _github(findings: list[LockFinding], lock: Path) -> str:
    """Return annotations of a pull request, one for each line that does not fit as it is."""
    return "\n".join(
        f"::error file={lock}::"
        + "%0A".join([_sentence(finding), *finding.suggestion.splitlines()])
        for finding in _unfit(findings)
    )


def _junit(findings: list[LockFinding], _: Path) -> str:
    """Return a report of tests: a suite for each function, a case for each edge and port."""
    unfit = len(list(_unfit(findings)))
    root = ET.Element(
        "testsuites", name="uoarm lock", tests=str(len(findings)), failures=str(unfit), errors="0"
    )
    for function in dict.fromkeys(finding.function for finding in findings):
        own = [finding for finding in findings if finding.function == function]
        failures = str(len(list(_unfit(own))))
        suite = ET.SubElement(
            root, "testsuite", name=function, tests=str(len(own)), failures=failures, errors="0"
        )
        for finding in own:
            case = ET.SubElement(suite, "testcase", classname=function, name=finding.subject)
            if finding.outcome is not LockOutcome.FITS:
                kind = _RULES[finding.outcome][0]
                report = ET.SubElement(case, "failure", type=kind, message=_sentence(finding))
                report.text = "\n".join([_sentence(finding), finding.suggestion]).rstrip()
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode")


def _sarif(findings: list[LockFinding], lock: Path) -> str:
    """Return a log of static analysis, version 2.1.0."""
    rules = [
        {"id": name, "shortDescription": {"text": text}, "defaultConfiguration": {"level": level}}
        for name, level, text in _RULES.values()
    ]
    driver = {"name": "uoarm lock", "semanticVersion": uoarm.__version__, "rules": rules}
    place = lock.as_uri() if lock.is_absolute() else quote(lock.as_posix())
    run = {
        "tool": {"driver": driver},
        "columnKind": "unicodeCodePoints",
        "results": [_result(finding, place) for finding in _unfit(findings)],
    }
    log = {
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [run],
    }
    return write_json(log, indent=2)


def _result(finding: LockFinding, place: str) -> dict[str, Any]:
    name, level, _ = _RULES[finding.outcome]
    location = {"artifactLocation": {"uri": place}, "region": {"startLine": 1}}
    logical = {
        "name": finding.subject,
        "fullyQualifiedName": f"{finding.function}: {finding.subject}",
    }
    return {
        "ruleId": name,
        "ruleIndex": [rule[0] for rule in _RULES.values()].index(name),
        "level": level,
        "message": {"text": "\n".join([_sentence(finding), finding.suggestion]).rstrip()},
        "locations": [{"physicalLocation": location, "logicalLocations": [logical]}],
        # What it is about, not how it is worded, makes it the finding that was seen before.
        "partialFingerprints": {
            "subject/v1": f"{finding.function}/{finding.subject}/{finding.path}"
        },
    }


def _unfit(findings: Iterable[LockFinding]) -> Iterable[LockFinding]:
    return (finding for finding in findings if finding.outcome is not LockOutcome.FITS)


def _sentence(finding: LockFinding) -> str:
    text = f"{finding.function}: {finding.subject}: {finding.outcome.value}"
    if not finding.sentence:
        return text
    return f"{text}: {f'{finding.path}: ' if finding.path else ''}{finding.sentence}"


FORMS: Mapping[str, Callable[[list[LockFinding], Path], str]] = {
    "text": _text, "json": _json, "github": _github, "junit": _junit, "sarif": _sarif,
}  # fmt: skip
"""Writers by the name of the form: from findings and the lock's file to text."""


@click.command()
@takes_configuration()
@click.option("--lock", "path", help="The lock's file.  [robot.lock beside robot.yaml]")
@click.option("--check", is_flag=True, help="Write nothing; say what is different and breaks.")
@click.option(
    "--against",
    type=click.Path(exists=True),
    help="Compare with this lock, or with the definitions of this folder: JSON Schemas, and what "
    "plugins read; no bridge is asked.",
)
@click.option(
    "--environment", metavar="NAME",
    help="Compare with the definitions that this environment has installed; no bridge is asked.",
)  # fmt: skip
@click.option(
    "--format", "form", type=click.Choice(list(FORMS)), default="text",
    show_default=True, help="Of what --check says.",
)  # fmt: skip
def lock(
    file: str,
    path: str | None,
    form: str,
    *,
    check: bool,
    against: str | None,
    environment: str | None,
) -> None:
    """Write down what all plans rest on, or check it.

    Exit codes: 0 written, or everything still fits; 1 a function has no plan, or something does not
    fit as it is; 3 a file cannot be read or written; 4 a bridge failed, or no such environment.
    """
    hold_to("--check", "--against", "--environment", "--format")
    hold_apart("--against", "--environment")
    with reporting():
        place = _beside(file) if path is None else Path(path)
        if not check:
            sys.exit(_write(file, place))
        before = read_lock(place)
        if environment is not None:
            findings = _against(before, environments.installed(environment), is_installed=True)
        elif against is not None:
            findings = _against(before, Path(against))
        else:
            with open_unlocked(file) as robot:
                findings = _compared(before, lock_of(robot))
    text = FORMS[form](findings, place)
    if text:
        echo(text)
    sys.exit(0 if all(finding.outcome is LockOutcome.FITS for finding in findings) else REFUSED)


def _against(before: Lock, other: Path, *, is_installed: bool = False) -> list[LockFinding]:
    """Compare with what stands in files; standard error says which types do not."""
    if not os.path.isdir(other):
        return _compared(before, read_lock(other))
    schemas = read_schemas(other, before, is_installed=is_installed)
    missing = uncompared_types(before, schemas)
    if missing:
        echo(f"not in {other}, and taken to be as they were: {', '.join(missing)}", err=True)
    return list(compare(before, schemas))


def _compared(before: Lock, after: Lock) -> list[LockFinding]:
    """Compare two locks; standard error says which packages are others, which breaks nothing."""
    for line in differing_packages(before.bridges, after.bridges):
        echo(line, err=True)
    return list(compare(before, after))


@contextmanager
def open_unlocked(file: str) -> Iterator[RobotManager]:
    """Make a manager that is not held to the lock which its configuration may ask for."""
    registry = Registry()
    robot = evolve(load(file, registry.types), lock=None)
    with RobotManager(robot, registry=registry) as manager:
        yield manager


def _write(file: str, path: Path) -> int:
    with open_unlocked(file) as robot:
        made = lock_of(robot)
    _write_file(path, write_lock(made))
    refused = {
        name: function.refused for name, function in made.functions.items() if function.refused
    }
    for name, why in refused.items():
        print_warning(f"{name} has no plan: {why}")
    functions, structures = len(made.functions), len(made.structures)
    echo(f"{path}: functions: {functions}, structures: {structures}")
    return REFUSED if refused else 0


def lock_of(robot: RobotManager) -> Lock:
    """Return the lock of a robot, as its bridges describe themselves now."""
    plans: dict[str, Plan | str] = {}
    for name in robot.config.functions:
        try:
            plans[name] = robot.resolve(name)
        except ResolutionError as error:
            plans[name] = str(error)
    described = {}
    names = [component.name for component in robot.config.components()]
    names += [offer.name for offer in robot.config.offers]
    for name in names:
        with suppress(ResolutionError):  # what is not there is no candidate now
            described[name] = robot.structures(name)
    return record(robot.config, plans, described)


_WRITERS = {
    "python": write_python, "typescript": write_typescript, "jsonschema": write_document,
}  # fmt: skip


@click.command()
@takes_configuration()
@click.option("--python", is_flag=True, help="A module of TypedDicts.")
@click.option("--typescript", is_flag=True, help="Declarations for uoarm.js.")
@click.option("--jsonschema", is_flag=True, help="One schema with $defs.")
@click.option("--lock", "path", help="The lock's file, which must be there.  [robot.lock if any]")
@click.option("-o", "--output", type=click.Path(dir_okay=False), help="Write this file instead.")
def types(file: str, path: str | None, output: str | None, **forms: bool) -> None:
    """Write the types of what functions give and take.

    They are those of the lock beside the configuration; where there is none, of the structures that
    bridges describe now. Standard error says which.

    Exit codes: 0 written; 1 written, but a function has no plan, and so no types; 3 a file cannot
    be read or written; 4 a bridge failed.
    """
    hold_apart("--python", "--typescript", "--jsonschema")
    form = next((name for name, is_asked in forms.items() if is_asked), None)
    if form is None:
        raise click.UsageError("say which: --python, --typescript or --jsonschema")
    with reporting():
        lock = _source(file, path)
        robot = read_functions(lock)
        text = _WRITERS[form](robot)
        if output is None:
            echo(text, nl=False)
        else:
            _write_file(Path(output), text)
    refused = [name for name, function in robot.functions.items() if function.refused]
    for name in refused:
        print_warning(f"{name} has no plan: no types")
    sys.exit(REFUSED if refused else 0)


def _source(file: str, path: str | None) -> Lock:
    place = _beside(file) if path is None else Path(path)
    if path is not None or place.exists():
        lock = read_lock(place)
        echo(f"types of {place}", err=True)
        return lock
    with open_unlocked(file) as robot:
        lock = lock_of(robot)
    echo(f"types of what the bridges of {file} describe now: no {place}", err=True)
    return lock


def _beside(file: str) -> Path:
    """Return where the lock of a configuration is.

    Raises:
        ConfigurationError: there is no such file.
    """
    if not os.path.isfile(file):
        load(file)
    return lock_path(file)


def _write_file(path: Path, text: str) -> None:
    """Write a file, but not over a configuration: nothing that is written here is YAML."""
    if path.name.endswith(CONFIGURATION_ENDINGS) and os.path.exists(path):
        cause = "it may be a configuration, and is not written over: name another file"
        raise LockError(f"{path}: {cause}")
    try:
        write_whole(path, text.encode())
    except OSError as error:
        raise LockError(f"{path}: cannot be written: {reason_of(error, path)}") from error
