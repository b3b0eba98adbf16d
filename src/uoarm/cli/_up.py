"""`uoarm up` serves what is there, without a line of configuration for it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click
from attrs import define, field

from uoarm import RobotManager
from uoarm._raised import foreign, sentence_of
from uoarm.bridge import Registry
from uoarm.cli._discover import changed_rows, with_every_plugin
from uoarm.cli._output import UNWRITTEN, echo, styled
from uoarm.cli._serve import listening_options, say, stop_file_of, stop_signals
from uoarm.cli._shared import (
    DefaultConfiguration,
    Seconds,
    json_option,
    needing,
    reporting,
    takes_configuration,
)
from uoarm.config import add_functions, load
from uoarm.errors import ConnectionClosedError, ListenError, UoarmError
from uoarm.model import BridgeFindings, Robot, to_json, write_json

if TYPE_CHECKING:
    from uoarm.server import Server

_END_SECONDS = 5.0
_DISCOVERY_SECONDS = 20.0
_GRACE_SECONDS = 1.0
_RESOLVE_SECONDS = 10.0


@click.command()
@takes_configuration(unnamed=DefaultConfiguration.NONE)
@listening_options
@click.option(
    "--every",
    type=Seconds(min=0.1),
    default=2.0,
    show_default=True,
    help="Seconds between two looks.",
)
@click.option(
    "--unfed",
    metavar="PATTERN",
    multiple=True,
    help="Inputs that nothing need feed, such as cmd_vel, or '*'; several times for several.",
)
@json_option
def up(
    file: str | None,
    *,
    host: str,
    port: int,
    access: Path | None,
    every: float,
    unfed: tuple[str, ...],
    as_json: bool,
) -> None:
    """Serve whatever there is, without a configuration.

    Every component that bridges see provides a function of its name. Plugins that the file does not
    mention are asked with their default options. The inputs of components are fed by what is proven
    to fit; one with an input that nothing feeds is none, unless --unfed names that input.

    Prints what comes and goes, and what each function would run on or why it cannot be had,
    until Ctrl-C or SIGTERM, or until what reads it ends. Nothing is written to a file.
    """
    registry = Registry()
    with stop_signals() as use, reporting(), needing("server"):
        from uoarm.server import ServerOptions, run  # noqa: PLC0415 - an extra, and slow

        given = Robot({}, {}) if file is None else load(file, registry.types)
        robot = with_every_plugin(given, registry)
        stop_file = stop_file_of(file or "uoarm up")
        with RobotManager(robot, registry=registry, stop_file=stop_file) as manager:
            use(manager)
            chosen = ServerOptions(host=host, port=port, access=access)
            follower = _Follower(manager, unfed=unfed, as_json=as_json)

            def ready(server: Server) -> None:
                say(server, chosen, err=as_json)
                manager.offer(timeout=0)  # what fails is in the log and in the status

            try:
                with _following(follower, every):
                    run(manager, chosen, ready)
            except ListenError as error:
                error.name_option({port: "--port"})
                raise


@define(eq=False, slots=False)
class _Follower:
    """Gives a function to whatever is seen, and prints what is different each time.

    Args:
        manager: of the robot; others may change its configuration, too.
        unfed: patterns of inputs that may stay without a feed.
        as_json: whether a line of JSON is printed in place of text.
    """

    _manager: RobotManager
    _unfed: tuple[str, ...] = field(default=(), kw_only=True)
    _as_json: bool = field(kw_only=True)
    _echo: Callable[[str], None] = field(default=echo, kw_only=True)
    _findings: tuple[BridgeFindings, ...] = field(default=(), init=False)
    _functions: dict[str, str] = field(factory=dict, init=False)

    def look(self) -> None:
        """Look once.

        Raises:
            UoarmError: the manager is closed.
        """
        findings = self._manager.discover(timeout=_DISCOVERY_SECONDS, grace=_GRACE_SECONDS)
        revision = self._manager.revision
        base = self._manager.history()[-1].robot
        assert base is not None, "a manager has one from the beginning"
        grown = add_functions(base, findings, unfed=self._unfed)
        if grown is not base:
            self._manager.apply(grown, revision=revision)
        before, self._findings = self._findings, findings
        if not self._as_json:
            for mark, row in changed_rows(before, findings):
                self._echo(f"{mark} {row}")
        functions = {name: self._plan_text(name) for name in self._manager.config.functions}
        others, self._functions = self._functions, functions
        if not self._as_json:
            for name, plan in functions.items():
                if others.get(name) != plan:
                    self._echo(f"{styled(name, bold=True)}  {plan}")
        elif (before, others) != (findings, functions):
            self._echo(write_json({"findings": to_json(findings), "functions": functions}))

    def _plan_text(self, name: str) -> str:
        try:
            plan = self._manager.resolve(name, timeout=_RESOLVE_SECONDS)
        except ConnectionClosedError:
            raise
        except UoarmError as error:
            return f"unavailable: {str(error).splitlines()[-1].strip().removeprefix('- ')}"
        return " -> ".join(step.component.name for step in plan.steps)


@contextmanager
def _following(follower: _Follower, every: float) -> Iterator[None]:
    """Look in a thread of its own, so often; ends the process where nothing can be printed."""
    over, unwritten = threading.Event(), list[OSError]()

    def run() -> None:
        said = ""
        while not over.is_set():
            failure = ""
            try:
                foreign(follower.look)
            except Exception as error:  # noqa: BLE001 - plugins and what is printed may raise anything
                if isinstance(error, OSError) and error.errno in UNWRITTEN:
                    unwritten.append(error)
                    signal.raise_signal(signal.SIGTERM)
                    return
                failure = sentence_of(error)
            if failure not in {"", said} and not over.is_set():
                echo(f"looking for components failed: {failure}", err=True)
            said = failure
            over.wait(every)

    thread = threading.Thread(target=run, name="uoarm-up", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(_END_SECONDS)
        if unwritten:  # also where it ended the server's start
            raise unwritten[0]
