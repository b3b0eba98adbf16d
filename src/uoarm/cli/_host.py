"""The command `uoarm host`: bridges run for a manager elsewhere, or for tools of other kinds."""

from __future__ import annotations

import faulthandler
import logging
import signal
import threading
from collections.abc import Callable

import click

from uoarm._forks import default_in_children
from uoarm._interrupts import wait_for
from uoarm.bridge import Registry
from uoarm.cli._output import at_least, echo
from uoarm.cli._shared import Seconds, hold_apart, hold_to, needing, reporting, takes_configuration
from uoarm.config import load
from uoarm.errors import CommandLineError
from uoarm.model import Component, Endpoint, place_problem

_END_SECONDS = 6
_GLANCE_SECONDS = 0.2


@click.command()
@click.argument("bridges", nargs=-1)
@click.option("--xmlrpc", "port", type=click.IntRange(0, 65535), help="Answer XML-RPC here.")
@takes_configuration(listed="bridges")
@click.option("--join", "place", help="Serve the manager that listens at tls/ADDRESS:PORT.")
@click.option("--machine", help="With --join: the name of this machine in the configuration.")
@click.option(
    "--certificates",
    default="certificates",
    show_default=True,
    help="With --join: folder with ca.pem, and the machine's certificate and key.",
)
@click.option(
    "--modules",
    default=".",
    show_default=True,
    help="With --join: folder of the components of python bridges.",
)
@click.option(
    "--silence",
    type=Seconds(min=0.5),
    default=3.0,
    show_default=True,
    help="With --join: seconds after which a silent link counts as cut.",
)
def host(
    bridges: tuple[str, ...],
    port: int | None,
    file: str,
    place: str | None,
    machine: str | None,
    certificates: str,
    modules: str,
    silence: float,
) -> None:
    """Run BRIDGES of a configuration, until interrupted.

    With --join, serve a manager on another machine, which has the configuration: all bridges of
    this machine, or those that are named. With --xmlrpc, answer what one bridge knows of its
    components to tools on this machine.
    """
    hold_to("--join", "--certificates", "--modules", "--silence")
    hold_apart("--file", "--join")
    with reporting():
        if place is not None and machine is not None and port is None:
            _join(place, machine, bridges, certificates, modules, silence)
        elif port is not None and place is None and machine is None and len(bridges) == 1:
            _answer(bridges[0], port, file)
        else:
            text = "give --join PLACE and --machine NAME, or one BRIDGE and --xmlrpc PORT"
            raise click.UsageError(text)


def _join(
    place: str,
    machine: str,
    bridges: tuple[str, ...],
    certificates: str,
    modules: str,
    silence: float,
) -> None:
    with needing("machines"):
        from uoarm._host import Identity  # noqa: PLC0415 - needs an extra
        from uoarm._host.agent.host_agent import HostAgent  # noqa: PLC0415 - likewise
    problem = place_problem(place)
    if problem:
        raise CommandLineError(f"--join {place}: {problem}")
    secured = place.startswith("tls/")
    identity = Identity.find(certificates, machine) if secured else None
    at_least(logging.INFO)
    joined = HostAgent(
        place, machine, identity=identity, bridges=bridges, modules=modules, silence=silence
    )
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: _begin_end(joined.close))
    default_in_children((signal.SIGTERM, signal.SIGINT))
    failures: list[BaseException] = []

    def serve() -> None:
        try:
            joined.run()
        except BaseException as error:  # noqa: BLE001 - raised again below
            failures.append(error)

    serving = threading.Thread(target=serve, name="uoarm-join", daemon=True)
    serving.start()
    while serving.is_alive():  # handlers run in this thread, which must not be deep in the link
        serving.join(_GLANCE_SECONDS)
    if failures:
        raise failures[0]


def _begin_end(close: Callable[[], None]) -> None:
    """Close in a thread: a handler must not take a lock that the thread it interrupts may hold.

    The process ends within six seconds, whatever hangs, the interpreter's lock included; what hung
    is then written to stderr.
    """
    faulthandler.dump_traceback_later(_END_SECONDS, exit=True)
    threading.Thread(target=close, name="uoarm-end", daemon=True).start()


def _answer(bridge: str, port: int, file: str) -> None:
    with needing("hosts"):
        from uoarm._host import RemoteBridge, XmlRpcServer  # noqa: PLC0415 - needs an extra
    registry = Registry()
    robot = load(file, registry.types)
    spec = robot.bridges.get(bridge)
    if spec is None:
        raise CommandLineError(f"there is no bridge {bridge!r}: {', '.join(robot.bridges)}")
    made = registry.create(spec) if spec.host is None else RemoteBridge(spec)
    try:
        mine = (component for component in robot.components() if component.bridge == bridge)
        face = XmlRpcServer(
            made, (end for component in mine for end in _endpoints(component)), port
        )
        try:
            echo(f"bridge {bridge} answers at http://127.0.0.1:{face.port}/RPC2")
            wait_for(threading.Event())
        except (KeyboardInterrupt, SystemExit):  # Ctrl-C and SIGTERM are how answering ends
            pass
        finally:
            face.close()
    finally:
        made.close()


def _endpoints(component: Component) -> list[Endpoint]:
    if component.service is not None:
        return [component.service.endpoint]
    inputs = [port.endpoint for port in component.inputs]
    return [*inputs, *(port.endpoint for port in component.outputs)]
