"""Components of three frameworks come and go at random: `python -m bench.churn --minutes 10`.

Nodes of ROS 2, RT-Components under omniNames and simulated robots on a line are started, and killed
or interrupted, at random. As with `uoarm up`, what is seen gets a function, and each is requested
here whenever it can be had; those of the robots alone are written, since they have an input that
nothing feeds, which has to be allowed. At the end the log of the control plane's events is played
again, which must lead to the same actions. Exit code 0 when it does, when something of every
framework was found, lost and used, and when all is closed.
"""

from __future__ import annotations

import collections
import functools
import logging
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import click
from attrs import define, field
from uoarm_rtm.nameserver import nameserver_command

from bench._churn_peers import Peers, peers_of
from bench.tables import print_table
from uoarm import RobotManager, UoarmError
from uoarm._control.reconciler import actions as act
from uoarm._control.reconciler import events as ev
from uoarm._control.reconciler.state import State, names
from uoarm._control.reconciler.step import step
from uoarm._control.reconciler.trace import read
from uoarm._control.runtime import executor
from uoarm.config import add_functions, loads
from uoarm.model import BridgeFindings, Plan

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "examples" / "vision"))
from vision_demo.ports import free_domain, free_ports, listens  # noqa: E402 - its folder comes first

ROBOT = """
version: 1
bridges:
  ros: {{plugin: ros2, options: {{domain_id: {domain}}}}}
  rtm: {{plugin: rtm, options: {{nameserver: "{names}"}}}}
  devices:
    plugin: rocos
    options:
      devices:
        robot0: {{url: "tcp://127.0.0.1:{first}"}}
        robot1: {{url: "tcp://127.0.0.1:{second}"}}
functions:
  first: {{needs: {{name: robot0, unfed: velocity}}}}
  second: {{needs: {{name: robot1, unfed: velocity}}}}
"""
FRAMEWORKS = {"ros": "ROS 2", "rtm": "OpenRTM", "devices": "serial"}
_LOOK_SECONDS = 1.0
_RESOLVE_SECONDS = 5.0
_REQUEST_SECONDS = 20.0


@define
class Trace:
    """Every event and action of the control plane, as they are logged and as they are."""

    begun: State | None = None
    lines: list[str] = field(factory=list)
    done: list[list[str]] = field(factory=list)
    plans: list[Plan] = field(factory=list)
    example: str = ""

    def watch(self) -> None:
        """Note from now on what is decided."""

        def watched(
            state: State, event: ev.Event, now: float
        ) -> tuple[State, tuple[act.Action, ...]]:
            self.begun = self.begun or state
            plan = getattr(event, "plan", None)
            if isinstance(plan, Plan):
                self.plans.append(plan)
            after, actions = step(state, event, now)
            self.done.append([repr(one) for one in actions])
            return after, actions

        executor.step = watched  # type: ignore[attr-defined]  # the module's own name for it
        log = logging.getLogger("uoarm.control")
        log.setLevel(logging.DEBUG)
        log.propagate = False
        handler = logging.Handler()
        handler.emit = lambda record: self.lines.append(record.getMessage())  # type: ignore[method-assign]
        log.addHandler(handler)

    def differences(self) -> int:
        """Play the lines again, and count those that lead to other actions."""
        state, plans = self.begun, iter(self.plans)

        def find_plan(function: str, components: tuple[str, ...]) -> Plan:
            plan = next(plans)
            assert (plan.function, names(plan)) == (function, components), "another plan"
            return plan

        different = abs(len(self.lines) - len(self.done))
        for line, actions in zip(self.lines, self.done, strict=False):
            event, now = read(line, find_plan)
            assert state is not None, "there is a line"
            state, again = step(state, event, now)
            replayed = [repr(one) for one in again]
            if replayed != actions:
                different += 1
                self.example = self.example or f"{line}\n  was  {actions}\n  is   {replayed}"
        return different


@define
class Watcher:
    """Gives functions to what is seen, requests them, and counts what comes of it."""

    robot: RobotManager
    found: collections.Counter[str] = field(factory=collections.Counter)
    lost: collections.Counter[str] = field(factory=collections.Counter)
    used: collections.Counter[str] = field(factory=collections.Counter)
    refused: collections.Counter[str] = field(factory=collections.Counter)
    causes: dict[str, str] = field(factory=dict)
    _seen: set[tuple[str, str]] = field(factory=set)

    def counts(self) -> tuple[collections.Counter[str], ...]:
        """Return what was found, lost, used and refused, by framework."""
        return self.found, self.lost, self.used, self.refused

    def look(self) -> None:
        """Look once, and request what can be had and is not open."""
        findings = self.robot.discover(timeout=10.0, grace=1.0)
        self._compare(findings)
        base = self.robot.history()[-1].robot
        assert base is not None
        grown = add_functions(base, findings)
        if grown is not base:
            self.robot.apply(grown)
        if grown.functions:  # candidates are looked for from the first question on
            with suppress(UoarmError):
                self.robot.resolve(next(iter(grown.functions)), timeout=_RESOLVE_SECONDS)
        running = {one.plan.function for one in self.robot.connections() if not one.ended}
        for name, function in self.robot.config.functions.items():
            candidates = [one for one in function.components if one.match is not None]
            if name in running or not candidates or candidates[0].service is not None:
                continue
            framework = FRAMEWORKS[candidates[0].bridge]
            try:
                heard = functools.partial(self._heard, framework)
                self.robot.request(name, on_message=heard, timeout=_REQUEST_SECONDS)
            except UoarmError:
                self.refused[framework] += 1  # it went while it was opened, which is the point

    def _heard(self, framework: str, message: object) -> None:
        del message
        self.used[framework] += 1

    def _compare(self, findings: tuple[BridgeFindings, ...]) -> None:
        seen = {
            (each.bridge, one.name) for each in findings for one in each.components if one.ports
        }
        self.found.update(FRAMEWORKS[bridge] for bridge, _ in seen - self._seen)
        self.lost.update(FRAMEWORKS[bridge] for bridge, _ in self._seen - seen)
        self._seen = seen


@click.command()
@click.option("--minutes", type=click.FloatRange(min=0.1), default=10.0, show_default=True)
@click.option("--every", type=float, default=4.0, show_default=True, help="Seconds between two.")
@click.option("--seed", type=int, default=1, show_default=True)
def main(minutes: float, every: float, seed: int) -> None:
    """Let components come and go."""
    choose = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="uoarm-churn-") as folder:
        sys.exit(_run(Path(folder), choose, 60.0 * minutes, every))


def _run(folder: Path, choose: random.Random, seconds: float, every: float) -> int:
    port, first, second = free_ports(3)
    domain, nameserver = free_domain(), f"127.0.0.1:{port}"
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(domain)}
    trace = Trace()
    trace.watch()
    command = nameserver_command(port, "127.0.0.1", folder, str(folder / "errors"))
    naming = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'src'}"}
    peers = Peers(peers_of(nameserver, (first, second)), environment, folder / "peers.log")
    corba = f"corbaloc:iiop:{nameserver}/NameService"
    written = ROBOT.format(domain=domain, names=corba, first=first, second=second)
    failed: list[str] = []
    try:
        while not listens(port):
            time.sleep(0.1)
        with RobotManager(loads(written)) as robot:
            watcher = Watcher(robot)
            over = threading.Event()
            thread = threading.Thread(target=_look, args=(watcher, over, failed))
            thread.start()
            end = time.monotonic() + seconds
            for one in peers.peers:
                peers.start(one)
            while not over.wait(choose.uniform(0.5, 1.5) * every) and time.monotonic() < end:
                click.echo(peers.toggle(choose))
            over.set()
            thread.join()
            status = robot.status()
            deaths, takeovers = (
                sum(times for _, times in counts) for counts in (status.deaths, status.takeovers)
            )
    finally:
        peers.close()
        naming.terminate()
        naming.wait()
    different = trace.differences()
    print_table(
        "Three frameworks, components that come and go",
        ("framework", "found", "lost", "messages", "requests that came too late"),
        [(one, *(str(each[one]) for each in watcher.counts())) for one in FRAMEWORKS.values()],
    )
    click.echo(
        f"{peers.starts} starts, {peers.kills} kills; {deaths} deaths, {takeovers} takeovers"
    )
    click.echo(f"{len(trace.lines)} events, {different} with other actions when played again")
    if trace.example:
        click.echo(trace.example)
    for line in failed:
        click.echo(f"failed: {line}", err=True)
    is_whole = all(counted[one] for counted in watcher.counts()[:3] for one in FRAMEWORKS.values())
    return 0 if is_whole and not different and not failed else 1


def _look(watcher: Watcher, over: threading.Event, failed: list[str]) -> None:
    while not over.wait(_LOOK_SECONDS):
        try:
            watcher.look()
        except Exception as error:  # noqa: BLE001 - told at the end, which is then a failure
            failed.append(f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
