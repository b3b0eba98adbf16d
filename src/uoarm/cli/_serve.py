"""`uoarm serve` puts a robot on a WebSocket; `uoarm token` makes what lets a client in."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from uoarm import RobotManager
from uoarm._encodable import is_encodable
from uoarm._forks import default_in_children
from uoarm._raised import LimitedLog
from uoarm._support.files import stamp_of, user_folder
from uoarm._support.yaml import write_flow
from uoarm._version import __version__
from uoarm.cli._announce import Announcement
from uoarm.cli._output import echo
from uoarm.cli._shared import (
    at_signals,
    hold_apart,
    hold_to,
    is_address,
    needing,
    open_robot,
    print_error,
    print_warning,
    reporting,
    takes_configuration,
    text_of_file,
)
from uoarm.errors import ConfigurationError, ConnectionClosedError, ListenError, UoarmError

if TYPE_CHECKING:
    from uoarm.server import Server, ServerOptions
    from uoarm.server.access import Audit

_log = logging.getLogger("uoarm")
_LOOK_SECONDS = 0.5
_END_SECONDS = 5.0
_BEGINS_STOPPED = (
    "commands are refused: the robot was stopped and not released. "
    "`uoarm stop --release --url URL` or SIGUSR2 lets them through. It is kept in"
)
_LAST_PORT = 65_535
# As a browser sends it, and as a client names a server: what is written otherwise matches nothing.
_ORIGIN = re.compile(r"\*|null|[a-z][a-z0-9+.-]*://[^\s/@?#]+")
_HOST = re.compile(r"[^\s/@?#]+")
_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)


def _like(form: re.Pattern[str], expected: str) -> Callable[..., tuple[str, ...]]:
    """Return what refuses texts of another form."""

    def check(
        context: click.Context, parameter: click.Parameter, given: tuple[str, ...]
    ) -> tuple[str, ...]:
        for text in given:
            if not form.fullmatch(text):
                wrong = f"expected {expected}, got {text!r}"
                raise click.BadParameter(wrong, context, parameter)
        return given

    return check


_LISTENING = (
    click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on."),
    click.option(
        "--port",
        type=click.IntRange(0, 65535),
        default=9080,
        show_default=True,
        help="Port to listen on; 0 takes a free one.",
    ),
    click.option("--access", type=_FILE, help="Access file with roles and tokens."),
)


def listening_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options of where a server listens, and whom it lets in."""
    for option in reversed(_LISTENING):
        command = option(command)
    return command


@click.command()
@takes_configuration()
@listening_options
@click.option(
    "--front-end-port",
    "front_end_ports",
    multiple=True,
    metavar="NAME=PORT",
    callback=lambda _context, _option, given: [_name_and_port(item) for item in given],
    help="A further port for the clients of one front end, such as rosbridge=9090.",
)
@click.option(
    "--rosbridge-port",
    type=click.IntRange(0, 65535),
    help="Short for --front-end-port rosbridge=PORT.",
)
@click.option(
    "--origin",
    "origins",
    multiple=True,
    callback=_like(_ORIGIN, "SCHEME://HOST[:PORT] or *"),
    help="Origin of web pages that may connect; * for all.",
)
@click.option(
    "--allow-host",
    "hosts",
    multiple=True,
    callback=_like(_HOST, "the name of a host"),
    help="A further name of this server on loopback.",
)
@click.option(
    "--tls",
    type=click.Choice(["auto"]),
    help="Speak TLS with a certificate made for this user; its fingerprint is printed.",
)
@click.option("--certificate", type=_FILE, help="PEM file of the certificate, for TLS.")
@click.option("--key", type=_FILE, help="PEM file of its key.")
@click.option("--client-authority", type=_FILE, help="PEM file that client certificates rest on.")
@click.option(
    "--deflate", is_flag=True, help="Compress texts for clients that ask for it, as browsers do."
)
@click.option(
    "--recordings",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of what clients record; else one of this user's state.",
)
@click.option(
    "--audit",
    type=click.Path(dir_okay=False, path_type=Path),
    help="File that the audit log is appended to; only this user may read it.",
)
@click.option(
    "--otlp",
    metavar="URL",
    help="OpenTelemetry collector that gets spans and figures, such as http://127.0.0.1:4318.",
)
@click.option(
    "--announce", is_flag=True, help="Announce this manager on the network, by multicast DNS."
)
@click.option(
    "--watch-config", is_flag=True, help="Read the configuration again whenever the file changes."
)
def serve(
    file: str,
    *,
    watch_config: bool,
    tls: str | None,
    front_end_ports: list[tuple[str, int]],
    rosbridge_port: int | None,
    otlp: str | None,
    announce: bool,
    **settings: Any,
) -> None:
    """Serve a robot to WebSocket clients and browsers.

    Until Ctrl-C or SIGTERM; SIGHUP has FILE read again.

    SIGUSR1 stops every input that moves something until SIGUSR2 releases them. A robot that was
    stopped stays so when it is served again.

    Endpoints: / speaks the native protocol, and each installed front end has its own: /rosbridge
    speaks rosbridge v2. /healthz and /metrics answer over HTTP.
    """
    hold_apart("--tls", "--certificate")
    hold_apart("--tls", "--key")
    hold_to("--certificate", "--key")
    if rosbridge_port is not None:
        front_end_ports.append(("rosbridge", rosbridge_port))
    ports = dict(front_end_ports)
    if len(ports) < len(front_end_ports):
        raise click.UsageError("a front end has one further port, and is given two")
    stop_file = stop_file_of(file)
    with (
        stop_signals() as use,
        exporting(otlp),
        _beginning() as begin,
        open_robot(file, stop_file) as manager,
    ):
        use(manager)  # before anything is opened: what is may move at once
        with needing("server"):
            from uoarm.server import ServerOptions, run  # noqa: PLC0415 - an extra, and slow
        chosen = ServerOptions(own_certificate=tls is not None, front_end_ports=ports, **settings)
        announcement = Announcement(manager.identity, chosen) if announce else None
        if manager.is_stopped:
            echo(f"{_BEGINS_STOPPED}: {stop_file}", err=True)

        def ready(server: Server) -> None:
            say(server, chosen)
            if announcement is not None:
                announcement.start(server.ports[0])
            # Not before: what cannot be served starts no part of the robot. Beside the server,
            # which answers while what is recorded opens.
            begin(manager)

        try:
            with _reloading(manager, watch=watch_config), announcement or nullcontext():
                run(manager, chosen, ready)
        except ListenError as error:
            error.name_option(port_options(chosen))
            raise


@contextmanager
def _beginning() -> Iterator[Callable[[RobotManager], None]]:
    """Begin what a configuration offers and records beside the block, and wait for that to end.

    Around the manager: what still opens ends as that closes, and leaves no file that is not whole.
    """
    threads: list[threading.Thread] = []

    def begin(manager: RobotManager) -> None:
        name = "uoarm-serve-begin"
        thread = threading.Thread(target=_begin, args=(manager,), name=name, daemon=True)
        thread.start()
        threads.append(thread)

    try:
        yield begin
    finally:
        for thread in threads:
            thread.join(_END_SECONDS)


def _begin(manager: RobotManager) -> None:
    """Offer and record what the configuration says."""
    try:
        manager.offer(timeout=0)  # what fails is in the log and in the status
        if manager.config.record is not None:
            manager.record()
    except ConnectionClosedError:  # the server has ended
        pass
    except UoarmError as error:
        print_warning(f"nothing is recorded: {error}")


_LAST_SECONDS = 1.0


@contextmanager
def exporting(url: str | None) -> Iterator[None]:
    """Send the spans and figures of the block to a collector by OTLP over HTTP; None: nowhere.

    What the standard variables of OpenTelemetry say besides holds: headers, intervals, resource.
    Nothing of it is imported where there is no collector.
    """
    if url is None:
        yield
        return
    if not is_address(url, ("http", "https")):
        wanted = f"expected http://HOST:PORT or https://HOST:PORT, got {url!r}"
        raise click.BadParameter(wanted, param_hint="--otlp")
    with reporting(), needing("otlp"):
        from opentelemetry import metrics, trace  # noqa: PLC0415 - of an extra
        from opentelemetry.exporter.otlp.proto.http.metric_exporter import (  # noqa: PLC0415
            OTLPMetricExporter,
        )
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import (  # noqa: PLC0415
            OTLPSpanExporter,
        )
        from opentelemetry.sdk.metrics import MeterProvider  # noqa: PLC0415 - as above
        from opentelemetry.sdk.metrics.export import (  # noqa: PLC0415 - as above
            PeriodicExportingMetricReader,
        )
        from opentelemetry.sdk.resources import Resource  # noqa: PLC0415 - as above
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415 - as above
        from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415 - as above
    name = os.environ.get("OTEL_SERVICE_NAME", "uoarm")
    resource = Resource.create({"service.name": name, "service.version": __version__})
    base = url.rstrip("/")
    spans = TracerProvider(resource=resource, shutdown_on_exit=False)
    spans.add_span_processor(BatchSpanProcessor(OTLPSpanExporter(endpoint=f"{base}/v1/traces")))
    figures = OTLPMetricExporter(endpoint=f"{base}/v1/metrics")
    meters = MeterProvider(
        [PeriodicExportingMetricReader(figures)], resource=resource, shutdown_on_exit=False
    )
    trace.set_tracer_provider(spans)
    metrics.set_meter_provider(meters)
    try:
        yield
    finally:
        # A collector that is away or hangs is tried for ten seconds and more: it holds up no end.
        closing = [
            threading.Thread(target=provider.shutdown, name="uoarm-otlp-end", daemon=True)
            for provider in (spans, meters)
        ]
        for thread in closing:
            thread.start()
        ends = time.monotonic() + _LAST_SECONDS
        for thread in closing:
            thread.join(max(0.0, ends - time.monotonic()))


def port_options(settings: ServerOptions) -> dict[int, str]:
    """Return the option of each port that is listened on."""
    of_front_ends = {
        port: f"--front-end-port {name}=PORT" for name, port in settings.front_end_ports.items()
    }
    return {settings.port: "--port", **of_front_ends}


def _checked_name(context: click.Context, parameter: click.Parameter, given: str) -> str:
    """Refuse what an access file would refuse."""
    if not given or not is_encodable(given):
        raise click.BadParameter(f"expected some text, got {given!r}", context, parameter)
    return given


@click.command()
@click.argument("name", callback=_checked_name)
@click.option(
    "--role",
    required=True,
    callback=_checked_name,
    help="Role of the access file that the token has.",
)
def token(name: str, role: str) -> None:
    """Make a token for a client of `uoarm serve`.

    Beside it stands the line of the access file that lets the client NAME in. The token is shown
    once and kept nowhere; the line holds its hash only.
    """
    with reporting(), needing("server"):
        from uoarm.server import hash_token, make_token  # noqa: PLC0415 - an extra, and slow

    made = make_token()
    echo(f"token: {made}", err=True)
    words = f"name: {_yaml(name)}, role: {_yaml(role)}, sha256: {hash_token(made)}"
    echo(f"  - {{{words}}}")


def _yaml(text: str) -> str:
    """Return text as YAML reads it, in quotes where it would be something else without."""
    is_word = re.fullmatch(r"[A-Za-z][\w-]*", text, re.ASCII) is not None
    return text if is_word and text.lower() not in _KEYWORDS else write_flow(text)


_KEYWORDS = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n"})


def stop_file_of(configuration: str) -> Path:
    """Return where it is kept that the robot of a configuration file is stopped."""
    path = os.fsencode(os.path.realpath(configuration))  # pathlib's raises where links are a loop
    return user_folder("state") / "stopped" / hashlib.sha256(path).hexdigest()[:32]


@contextmanager
def stop_signals() -> Iterator[Callable[[RobotManager], None]]:
    """Stop all at SIGUSR1 and release at SIGUSR2, each in a thread of its own, during the block.

    Around all else: from the program's begin to its end neither signal ends it. What comes before
    the manager is there is done as soon as this is called with it.
    """
    managers: list[RobotManager] = []
    early: list[Callable[[RobotManager], None]] = []
    given = threading.Lock()  # from the thread of a signal, against that which gives the manager

    def at_signal(action: Callable[[RobotManager], None]) -> None:
        with given:
            if not managers:
                early.append(action)
                return
        action(managers[0])

    def use(manager: RobotManager) -> None:
        with given:
            managers.append(manager)
        for action in early:
            action(manager)

    with at_signals(SIGUSR1=partial(at_signal, _stop), SIGUSR2=partial(at_signal, _release)):
        yield use


def _stop(manager: RobotManager) -> None:
    report = manager.stop_all()
    _audit().stopped("SIGUSR1", "", report)
    echo(str(report), err=True)


def _release(manager: RobotManager) -> None:
    try:
        manager.release()
    except UoarmError as error:
        _audit().released("SIGUSR2", "", str(error))
        print_error(error)
    else:
        _audit().released("SIGUSR2", "")
        echo("commands are let through again", err=True)


def _audit() -> Audit:
    from uoarm.server.access import Audit  # noqa: PLC0415 - an extra, and slow

    return Audit()


@contextmanager
def _reloading(manager: RobotManager, *, watch: bool) -> Iterator[None]:
    """Reload the configuration at SIGHUP, and where it is watched when its file has changed."""
    asked, over = threading.Event(), threading.Event()
    path = Path(manager.config.origin)

    def run() -> None:
        seen = before = stamp_of(path)
        is_refused = False
        while not over.is_set():
            is_asked = asked.wait(_LOOK_SECONDS if watch else None)
            if over.is_set():
                return
            asked.clear()
            now = stamp_of(path)
            is_written = now == before and now not in {(), seen}
            before = now
            if is_asked or (watch and is_written):  # a file that still changes is being written
                seen = now
                if is_asked or not _is_in_force(manager, path):
                    is_refused = not _reload(manager)
                elif is_refused:  # who has undone a mistake waits for a word
                    is_refused = False
                    echo("the file is again what is in force: nothing changes", err=True)

    thread = threading.Thread(target=run, name="uoarm-reload", daemon=True)
    thread.start()
    on_terminal = sys.stdin.isatty()

    def hang_up(number: int, frame: object) -> None:
        del number, frame
        if on_terminal and not sys.stdin.isatty():  # its window was closed
            signal.raise_signal(signal.SIGTERM)
        else:
            asked.set()

    hangup = getattr(signal, "SIGHUP", None)  # not on every system
    former = signal.signal(hangup, hang_up) if hangup is not None else None
    default_in_children([hangup] if hangup is not None else [])
    try:
        yield
    finally:
        if hangup is not None:
            signal.signal(hangup, former)
        over.set()
        asked.set()
        thread.join(_END_SECONDS)


def _is_in_force(manager: RobotManager, path: Path) -> bool:
    """Say whether a file holds what was read from it or kept in it last."""
    try:
        return text_of_file(path).removeprefix("\ufeff") == manager.config.text
    except ConfigurationError:
        return False


def _reload(manager: RobotManager) -> bool:
    """Apply the configuration file and say what changed; returns whether that was possible."""
    before = manager.revision
    try:
        change = manager.reload()
    except UoarmError as error:
        echo(f"the configuration stays as it is: {error}", err=True)
    except Exception as error:  # noqa: BLE001 - the next reload may do better
        LimitedLog(_log).write(logging.ERROR, "reloading the configuration failed", error)
    else:
        same = "the file is what is in force: nothing changes"
        echo(same if change.revision == before else str(change), err=True)
        return True
    return False


def _name_and_port(given: str) -> tuple[str, int]:
    name, _, port = given.partition("=")
    if not name or not port.isdecimal() or int(port) > _LAST_PORT:
        raise click.BadParameter(f"expected NAME=PORT, such as rosbridge=9090; got {given!r}")
    return name, int(port)


def say(server: Server, settings: ServerOptions, *, err: bool = False) -> None:
    """Print where a server listens, as addresses that can be opened, and what clients need."""
    from uoarm.server import fingerprint_of  # noqa: PLC0415 - an extra, and slow

    s = "s" if settings.secured else ""
    main, *more = (settings.place_from_here(port) for port in server.ports)
    paths = ("/", *(front_end.path for front_end in server.front_ends if front_end.start))
    echo(f"serving {' and '.join(f'ws{s}://{main}{path}' for path in paths)}", err=err)
    for name, place in zip(settings.front_end_ports, more, strict=True):
        front_end = next(item for item in server.front_ends if item.name == name)
        kind, path = ("ws", "/") if front_end.start else ("http", front_end.path)
        echo(f"serving {kind}{s}://{place}{path} for {name} clients", err=err)
    certificate = settings.certificate_file()
    if certificate is not None:
        echo(f"certificate {certificate}, SHA-256 {fingerprint_of(certificate)}", err=err)
    elif not settings.local:
        print_warning("without TLS, tokens and data can be read on the network")
    if settings.everywhere:
        text = f"listening on every address of this machine: elsewhere it is {socket.gethostname()}"
        echo(f"{text}, or an address of it, in place of {main.rpartition(':')[0]}", err=err)
    if settings.access is not None:
        proof = f"a token of {settings.access} (uoarm token makes one)"
        if settings.client_authority is not None:
            proof += f", or a certificate that rests on {settings.client_authority}"
        echo(f"every client needs {proof}", err=err)
    elif settings.hosts:
        names = ", ".join(settings.hosts)
        text = f"clients that come through a proxy as {names} may do everything"
        print_warning(f"{text}: --access asks for tokens")
    echo(f"open http{s}://{main}/ in a browser", err=err)
