"""Running a server: as the main work of a process, or in a thread beside other work.

A service manager, such as systemd, is notified as sd_notify(3) says: by a datagram of lines to the
socket that `NOTIFY_SOCKET` names. The packages that send it are older than the Pythons that uoarm
runs on.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import gc
import itertools
import logging
import os
import signal
import socket
import threading
from collections.abc import Callable, Coroutine, Iterable, Iterator, MutableMapping
from contextlib import contextmanager
from typing import Any

from uoarm._arguments import arguments
from uoarm._control import RobotManager
from uoarm._forks import at_exit, default_in_children
from uoarm._interrupts import Uninterrupted, handlers_kept
from uoarm._raised import ContainedError, LimitedLog, Log, foreign, on_failure
from uoarm._support.aio_deadlines import result_within
from uoarm._support.process_tuning import keep_memory, short_switch_interval
from uoarm._support.workers import WorkerExecutor
from uoarm.errors import UsageError
from uoarm.server._options import ServerOptions
from uoarm.server._server import Server
from uoarm.server.front_end import FrontEnd
from uoarm.server.http import NoRoomError

_SOCKET, _MICROSECONDS, _PROCESS = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"


class ServiceManager:
    """The service manager of this process, or none: then nothing is said. For one thread.

    What it needs is taken out of the environment, so that no process that is started here speaks
    in this one's name.

    Raises:
        UsageError: it states an address or a time that is none.

    Attributes:
        watchdog_seconds: within which a sign of life is expected again and again; None: never.
    """

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        self._address = _address(environment.pop(_SOCKET, ""))
        stated, process = environment.pop(_MICROSECONDS, ""), environment.pop(_PROCESS, "")
        self.watchdog_seconds: float | None = None
        if stated and process in {"", str(os.getpid())}:
            self.watchdog_seconds = _seconds(stated)

    def ready(self, text: str) -> None:
        """Say that the server listens, and what `systemctl status` shows of it."""
        self._send("READY=1", f"STATUS={text}")

    def alive(self) -> None:
        """Give a sign of life."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Say that the server was asked to stop, and does."""
        self._send("STOPPING=1", "STATUS=closing")

    def _send(self, *lines: str) -> None:
        if self._address is None:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as line:
                line.setblocking(False)
                line.sendto("\n".join(lines).encode(), self._address)
        except OSError as error:
            _log.warning("the service manager could not be reached: %s", error)


def _address(given: str) -> str | None:
    if not given:
        return None
    if given[0] not in "/@":
        raise UsageError(f"{_SOCKET}: expected a path, or @ and a name, got {given[:80]!r}")
    # Of the abstract namespace, which the kernel marks with a zero.
    return f"\0{given[1:]}" if given[0] == "@" else given


def _seconds(given: str) -> float:
    if not given.isdecimal() or not int(given):
        raise UsageError(f"{_MICROSECONDS}: expected microseconds, got {given[:40]!r}")
    return int(given) / 1e6


_START_SECONDS = 10.0
_END_SECONDS = 10.0
_WAITING = 32  # threads for what the loop waits for, such as the names of machines
_LATE = "the server does not listen: its start takes too long"
_log = Log("uoarm.server")
_YOUNG_OBJECTS, _YOUNG_LOOKS, _OLDEST, _LOOKS = 20_000, 1, 2, 10
# CPython 3.12 begins with some 400 frozen objects; who freezes has thousands.
_FROZEN_BY_PYTHON = 1_000
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@arguments()
def run(
    robot: RobotManager,
    settings: ServerOptions,
    ready: Callable[[Server], None] | None = None,
    *,
    front_ends: Iterable[FrontEnd] | None = None,
) -> None:
    """Serve until SIGTERM or Ctrl-C, then close properly. Only in the main thread.

    Where a service manager such as systemd started the process, it is said when the server listens
    and when it stops, and the loop gives a sign of life twice in the time of the watchdog.

    Meanwhile threads of this process that compute have turns of 0.5 ms instead of 5 ms, so that
    the loop waits less for them (`sys.setswitchinterval`). `UOARM_SWITCH_INTERVAL` says another
    number of milliseconds. The collector of cycles rarely looks at all that lives. And glibc's
    allocator keeps, for good, up to 256 MB that were freed, since pictures cost twice the processor
    time where it does not; `MALLOC_TRIM_THRESHOLD_` in the environment says otherwise. Afterwards
    signals are handled as before.

    Args:
        robot: the manager; it stays open.
        settings: where, and for whom.
        ready: called once it listens.
        front_ends: as for `Server`.

    Raises:
        ConfigurationError: the settings are not safe, or a file of theirs has mistakes.
        UsageError: `UOARM_SWITCH_INTERVAL`, `NOTIFY_SOCKET` or `WATCHDOG_USEC` is not what it
            should be.
        ListenError: a port is taken.
    """
    keep_memory()
    with short_switch_interval(), handlers_kept(_SIGNALS):
        # Front ends are imported. Python drops what a signal raises in a callback of its import
        # system, or leaves the lock of all imports taken, for which other threads then wait.
        with Uninterrupted():
            server = Server(robot, settings, front_ends)
        _run_loop(_new_loop(), _until_signal(server, ready))


@contextmanager
@arguments()
def serve_in_thread(
    robot: RobotManager, settings: ServerOptions, *, front_ends: Iterable[FrontEnd] | None = None
) -> Iterator[Server]:
    """Serve in a thread of its own while the block runs; the robot stays open after it.

    The thread is given the time of `limits.stop_seconds`, and ten seconds more, to end. One that
    does not, since a front end keeps its loop, is left, and the log says so.

    Args:
        robot: the manager.
        settings: where, and for whom.
        front_ends: as for `Server`.

    Raises:
        ConfigurationError: the settings are not safe, or a file of theirs has mistakes.
        ListenError: a port is taken.
        TimeoutError: it does not listen after ten seconds; nothing is left open.
    """
    server = Server(robot, settings, front_ends)
    loop = _new_loop()
    stop = asyncio.Event()
    started = threading.Event()
    failures: list[BaseException] = []

    async def serve() -> None:
        try:
            await result_within(_START_SECONDS, server.start())
        except asyncio.TimeoutError:  # CPython 3.10 has one of its own
            failures.append(TimeoutError(_LATE))
            return
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that waits
            failures.append(error)
            return
        finally:
            started.set()
        await stop.wait()
        await server.stop()

    def work() -> None:
        _run_loop(loop, serve())  # no coroutine stands where there is no thread

    thread = threading.Thread(target=work, name="uoarm-serve", daemon=True)
    with on_failure(loop.close):
        thread.start()
    try:
        # Twice as long as the start has: a front end that hangs keeps the loop from ending it.
        if not started.wait(2 * _START_SECONDS):
            raise TimeoutError(_LATE)
        if failures:
            raise failures[0]
        yield server
    finally:
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(stop.set)
        thread.join(settings.limits.stop_seconds + _END_SECONDS)
        if thread.is_alive():
            _log.error("the server has not ended: something keeps its loop, and its thread is left")


@functools.cache
def _freeze_at_exit() -> None:
    """Spare a process that ends its last look at everything: 1.5 s beside other work."""
    at_exit(gc.freeze)


@contextmanager
def _short_collections() -> Iterator[None]:
    """Have the collector of cycles look at what is new, and only now and then at all that lives.

    Meanwhile everything waits, an emergency stop too: 0.2 s at 1,000 open functions. What has
    outlived one look at everything is left out of the next nine. And a view of the whole robot,
    which lives for a moment, is not taken for what stays.
    """
    former, looks = gc.get_threshold(), itertools.count(1)
    has_frozen = gc.get_freeze_count() > _FROZEN_BY_PYTHON

    def collected(phase: str, facts: dict[str, int]) -> None:
        if phase == "stop" and facts["generation"] == _OLDEST:
            if next(looks) % _LOOKS:
                gc.freeze()
            else:
                gc.unfreeze()

    gc.set_threshold(_YOUNG_OBJECTS, _YOUNG_LOOKS, former[2])
    _freeze_at_exit()
    gc.callbacks.append(collected)
    try:
        gc.collect()
        yield
    finally:
        gc.callbacks.remove(collected)
        if not has_frozen:  # else the application has done so, and what it froze stays
            gc.unfreeze()
        gc.set_threshold(*former)


async def _until_signal(server: Server, ready: Callable[[Server], None] | None) -> None:
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    service_manager = ServiceManager()
    for signals in _SIGNALS:
        loop.add_signal_handler(signals, stop.set)
    default_in_children(_SIGNALS)
    # Where the loop takes signals: Python drops what one raises in a callback of the collector.
    with _short_collections():
        await server.start()
        living = asyncio.ensure_future(_give_signs_of_life(service_manager))
        try:
            if ready is not None:
                ready(server)
            service_manager.ready(f"listening on port {', '.join(map(str, server.ports))}")
            await stop.wait()
        finally:
            service_manager.stopping()
            await server.stop()
            living.cancel()
            # Closing the loop closes where signals are written to it before it stops reading them:
            # another one in between would be shown as an exception.
            signal.set_wakeup_fd(-1)


async def _give_signs_of_life(service_manager: ServiceManager) -> None:
    """Say again and again that the loop turns, as long as the service manager expects it."""
    seconds = service_manager.watchdog_seconds
    while seconds is not None:
        service_manager.alive()
        await asyncio.sleep(seconds / 2)


def _run_loop(loop: asyncio.AbstractEventLoop, work: Coroutine[Any, Any, None]) -> None:
    """Run one piece of work in a loop, and end whatever it has left there.

    A loop raises what is no `Exception` of any task, as one of a front end, and can go on then.
    """
    task = loop.create_task(work)
    try:
        records = LimitedLog(_log)
        while not task.done():
            try:
                foreign(loop.run_until_complete, task)
            except ContainedError as error:
                if task.done():
                    raise
                text = "a task that a front end left behind raised"
                records.write(logging.ERROR, text, error)
    finally:
        left = asyncio.all_tasks(loop)
        for task in left:
            task.cancel()
        if left:
            loop.run_until_complete(asyncio.wait(left, timeout=_END_SECONDS))
        loop.run_until_complete(loop.shutdown_asyncgens())
        loop.close()


def _new_loop() -> asyncio.AbstractEventLoop:
    """Return a loop, uvloop's where it is installed: the same behaviour with less time."""
    try:
        import uvloop  # noqa: PLC0415 - an optional package
    except ImportError:
        loop = asyncio.new_event_loop()
    else:
        loop = uvloop.new_event_loop()
    loop.set_default_executor(WorkerExecutor("uoarm-serve-wait", _WAITING))
    loop.set_exception_handler(_on_exception)
    return loop


def _on_exception(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    if not isinstance(context.get("exception"), NoRoomError):  # its socket has logged that
        loop.default_exception_handler(context)
