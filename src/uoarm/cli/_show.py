"""The commands that look: configuration, functions, plans, plugins, environment."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from uoarm._raised import reason_of
from uoarm._version import __version__
from uoarm.bridge import Registry
from uoarm.cli._output import echo, saying_what_is_waited_for, styled
from uoarm.cli._remote import Remote, asked, remote_options
from uoarm.cli._shared import (
    BRIDGE,
    CONFIGURATION,
    NO_FUNCTIONS,
    REFUSED,
    DefaultConfiguration,
    Seconds,
    fail,
    function_argument,
    hold_apart,
    hold_to,
    json_option,
    needing,
    open_robot,
    print_error,
    print_error_code,
    print_json,
    print_warning,
    reporting,
    takes_configuration,
)
from uoarm.config import assign, completed_schema, inspect, installation, load
from uoarm.errors import BridgeError, UsageError
from uoarm.model import to_json
from uoarm.schema.__main__ import check_files

_LARGE = 1_000_000
_SECONDS = 60.0


@click.command()
@takes_configuration()
@click.option(
    "--recording",
    "recordings",
    type=click.Path(readable=False, path_type=Path),
    multiple=True,
    help="Hold what was recorded against the configuration of today instead; may be repeated.",
)
@click.option(
    "--strict", "is_strict", is_flag=True, help="With --recording: all of it must be checked."
)
@json_option
def check(file: str, *, recordings: tuple[Path, ...], is_strict: bool, as_json: bool) -> None:
    """Say everything that is wrong with a configuration FILE.

    Python components that run in this environment are imported, to check their parameters. What is
    not here, a module or a plugin, is a warning: the file may be for another machine.

    With --recording each message of the recording is adapted and held against every input that its
    function feeds now, and the structure of then is proven against it. The exit code is 1 where one
    does not fit, or nothing could be checked; with --strict also where a channel was not, or a part
    of the file cannot be read.
    """
    hold_to("--recording", "--strict")
    if recordings:
        from uoarm.cli._record import check_against  # noqa: PLC0415 - needs an extra

        check_against(file, recordings, is_strict=is_strict, as_json=as_json)
    _say_that_it_takes_a_while(file)
    registry = Registry()
    report = inspect(file, registry.types, parameters=True, missing=registry.missing)
    if as_json:
        print_json(
            {
                "problems": report.problems,
                "warnings": report.warnings,
                "unchecked": report.unchecked,
            }
        )
    else:
        for problem in report.problems:
            print_error(problem)
        for warning in report.warnings:
            print_warning(warning)
        for error_code in sorted({problem.error_code for problem in report.problems}):
            print_error_code(error_code)
        if report.robot is not None:
            functions, bridges = len(report.robot.functions), len(report.robot.bridges)
            echo(f"{file}: no errors (functions: {functions}, bridges: {bridges})")
        if report.unchecked:
            echo(f"not looked at here, but by uoarm status {file}:")
            echo("\n".join(f"  {line}" for line in report.unchecked))
    sys.exit(0 if report.robot is not None else CONFIGURATION)


def _say_that_it_takes_a_while(file: str) -> None:
    """Say at a terminal that a large file takes a while to check."""
    with suppress(OSError, ValueError):
        octets = Path(file).stat().st_size
        if octets >= _LARGE and sys.stderr.isatty():
            echo(f"checking {file}, {octets / 1e6:.1f} MB: this takes a while", err=True)


@click.command("list")
@takes_configuration()
@remote_options(always=False)
@json_option
def list_functions(file: str, *, server: Remote | None, as_json: bool) -> None:
    """List the functions and the components that provide them.

    With --url those of the robot that runs there which the token's role may see.
    """
    if server is not None:
        functions = asked(server, lambda robot: robot.functions())
    else:
        with reporting():
            functions = load(file).functions
    if as_json:
        print_json(functions)
        return
    for function in functions if server is not None else to_json(tuple(functions.values())):
        echo(styled(function["name"], bold=True) + f"  {function['description']}".rstrip())
        for component in function["components"]:
            echo("  {priority:>4}  {name}  ({bridge})".format_map(component))
    if not functions:
        echo(NO_FUNCTIONS, err=True)


@click.command()
@function_argument()
@takes_configuration("name")
@click.option("--explain", is_flag=True, help="Print the whole plan and what was passed over.")
@click.option(
    "--timeout",
    type=Seconds(min=0.1, max=600),
    default=60.0,
    show_default=True,
    help="Seconds to start bridges, learn what they see and find the plan.",
)
@remote_options(always=False)
@json_option
def resolve(
    name: str, file: str, *, server: Remote | None, explain: bool, timeout: float, as_json: bool
) -> None:
    """Find the plan for a function without opening anything.

    With --url the one that the robot that runs there would open.
    """
    from uoarm._resolve import NoPlanError  # noqa: PLC0415 - when first needed

    if server is not None:
        answer = asked(server, lambda robot: robot.resolve(name))
        if as_json:
            print_json(answer["plan"])
        else:
            steps = (step["component"]["name"] for step in answer["plan"]["steps"])
            echo(answer["text"] if explain else " -> ".join(steps))
        return
    with open_robot(file) as robot:
        try:
            with saying_what_is_waited_for("bridges to start and report what they see", timeout):
                plan = robot.resolve(name, timeout=timeout)
        except NoPlanError as error:
            fail(error, REFUSED, function=error.function, rejected=error.rejections)
        offers = [item for item in robot.config.offers if item.function == plan.function]
    if as_json:
        places = [{"bridge": item.bridge, "endpoints": item.addresses} for item in offers]
        print_json({**to_json(plan), "offers": to_json(places)})
    elif explain:
        echo(plan)
        for item in offers:
            where = ", ".join(map(" ".join, item.addresses))
            echo(f"offered in {item.bridge} at {where}")
    else:
        echo(" -> ".join(step.component.name for step in plan.steps))


@click.command()
@takes_configuration(unnamed=DefaultConfiguration.NONE)
@json_option
def bridges(*, file: str | None, as_json: bool) -> None:
    """List the installed bridge plugins.

    Broken ones with the cause; with a configuration also what uoarm chose for its bridges.
    """
    registry = Registry()
    assigned = dict(assigned_options(file, registry))
    if as_json:
        types = [
            {"name": type_.name, "summary": type_.summary} for type_ in registry.types.values()
        ]
        print_json({"bridges": types, "problems": registry.problems, "assigned": assigned})
        return
    for type_ in registry.types.values():
        echo(f"{type_.name:<10} {type_.summary}")
    for problem in registry.problems:
        echo(f"{problem.name:<10} {styled('broken:', fg='red')} {problem.cause}")
    for option, value in assigned.items():
        echo(f"{option} {value}, chosen by uoarm")


@click.command()
@takes_configuration(unnamed=DefaultConfiguration.NONE)
@click.option(
    "--service", "is_service", is_flag=True, help="Look at the installed systemd unit instead."
)
@click.option(
    "--unit",
    default="uoarm.service",
    show_default=True,
    metavar="UNIT",
    help="Which unit --service looks at: a name, or the path of a file.",
)
@json_option
def doctor(*, file: str | None, is_service: bool, unit: str, as_json: bool) -> None:
    """Say what the environment is and what plugins find in it.

    With a configuration also what its bridges find that have an environment of their own.

    With --service: what of an installed service does not hold. Looked at are its user, the rights
    of its files and secrets, ports, watchdog and bounds. Exit code 4 where it would not run safely.
    """
    hold_to("--service", "--unit")
    hold_apart("FILE", "--service")
    hold_apart("--file", "--service")
    if is_service:
        _examine_service(unit, as_json=as_json)
        return
    from uoarm._checks import plugin_facts  # noqa: PLC0415 - when first needed

    registry = Registry()
    facts: dict[str, dict[str, str]] = {
        "uoarm": {
            "version": __version__,
            "python": f"{platform.python_version()} at {sys.executable}",
            "platform": platform.platform(),
        }
    }
    facts |= plugin_facts(registry)
    facts |= environment_facts(file, registry)
    chosen = dict(assigned_options(file, registry))
    if chosen:
        facts["chosen by uoarm"] = chosen
    if as_json:
        print_json(facts)
        return
    for name, findings in facts.items():
        echo(styled(name, bold=True))
        for key, finding in findings.items():
            echo(f"  {key:<14} {finding}")


_COLOURS = {"ok": "green", "warning": "yellow", "error": "red"}


def _examine_service(name: str, *, as_json: bool) -> None:
    from uoarm.cli._service import Level, examine, find_unit, read_unit  # noqa: PLC0415 - as above

    with reporting():
        unit = read_unit(find_unit(name))
    findings = examine(unit)
    is_usable = all(finding.level is not Level.ERROR for finding in findings)
    if as_json:
        print_json({"unit": str(unit.path), "usable": is_usable, "findings": to_json(findings)})
    else:
        echo(styled(str(unit.path), bold=True))
        for finding in findings:
            level = styled(f"{finding.level.value:<8}", fg=_COLOURS[finding.level.value])
            echo(f"  {finding.check:<14} {level} {finding.text}")
    if not is_usable:
        sys.exit(BRIDGE)


@click.group(invoke_without_command=True)
@click.pass_context
def schema(context: click.Context) -> None:
    """Print the JSON Schema of robot.yaml, for editors.

    It has the options of the bridges and endpoints of all installed plugins.
    """
    if context.invoked_subcommand is None:
        print_json(completed_schema(Registry().types))


schema.add_command(check_files)


def assigned_options(file: str | None, registry: Registry) -> Iterator[tuple[str, str]]:
    """Yield every option that uoarm chose, as `bridge.option` and its value."""
    if file is None:
        return
    with reporting():
        robot = assign(load(file, registry.types), registry.types)
    for bridge in robot.bridges.values():
        for option, value in bridge.assigned.items():
            yield f"{bridge.name}.{option}", str(value)


def environment_facts(file: str | None, registry: Registry) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield what each bridge with a Python of its own finds there, asked of that Python.

    Every one of them is given a minute.
    """
    if file is None:
        return
    with reporting():
        robot = load(file, registry.types)
    for bridge in robot.bridges.values():
        place = installation(bridge.host)
        if not place:
            continue
        with reporting(), needing("hosts"):
            from uoarm._host import HostSettings  # noqa: PLC0415 - needs an extra
        settings = HostSettings.read(bridge.host or {})
        name = f"{bridge.name}, with {place.partition(' ')[2]}"
        try:
            interpreter = settings.interpreter()
        except BridgeError as error:
            yield name, {"usable": f"no: {reason_of(error)}"}
        else:
            variables = settings.process_variables(os.environ)
            yield name, _asked(interpreter, variables, bridge.plugin)


def _asked(interpreter: Path, variables: dict[str, str], plugin: str) -> dict[str, str]:
    command = [str(interpreter), "-m", "uoarm", "doctor", "--json"]
    try:
        done = subprocess.run(  # noqa: S603 - the interpreter that the configuration names
            command,
            capture_output=True,
            env=variables,
            text=True,
            errors="replace",
            timeout=_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {"usable": f"no: it did not answer within {_SECONDS:g} s"}
    except (OSError, ValueError) as error:  # such as a variable that no process can have
        return {"usable": f"no: {reason_of(error)}"}
    try:
        report: Any = json.loads(done.stdout)
        found = report.get(plugin, {"usable": f"no: the plugin {plugin} is not installed there"})
        return {"uoarm": report["uoarm"]["version"], **found}
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        last = done.stderr.strip().rpartition("\n")[2]
        return {"usable": f"no: it has no uoarm that answers: {last}"}


def _codes(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from uoarm.error_codes import ERROR_CODES  # noqa: PLC0415 - when first needed

    return [
        CompletionItem(code, help=entry.title)
        for code, entry in ERROR_CODES.items()
        if code.startswith(incomplete.upper())
    ]


@click.command()
@click.argument("code", required=False, shell_complete=_codes)
@click.option("--markdown", is_flag=True, help="Write the page of all codes.")
@json_option
def explain(code: str | None, *, markdown: bool, as_json: bool) -> None:
    """Say what an error CODE means and what to do.

    Without CODE: a line about each there is.
    """
    from uoarm import error_codes  # noqa: PLC0415 - when first needed

    hold_apart("CODE", "--markdown")
    hold_apart("--json", "--markdown")
    try:
        entry = None if code is None else error_codes.explain(code)
    except UsageError as error:
        raise click.BadParameter(str(error), param_hint="CODE") from error
    if as_json:
        print_json(tuple(error_codes.ERROR_CODES.values()) if entry is None else entry)
    elif markdown:
        echo(error_codes.markdown(), nl=False)
    elif entry is not None:
        echo(entry)
    else:
        for known in error_codes.ERROR_CODES.values():
            echo(f"{known.code}  {known.title}")
