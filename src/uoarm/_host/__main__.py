"""The bridge host: `python -m uoarm._host`, started by a manager, which orders on stdin."""

from __future__ import annotations

import ctypes
import faulthandler
import json
import logging
import os
import resource
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, Queue
from typing import Any

from uoarm._forks import default_in_children
from uoarm._host.agent.dispatcher import RequestDispatcher
from uoarm._host.transport import keys
from uoarm._host.transport.frames import LinkSockets
from uoarm._host.transport.shared_counters import SharedCounters
from uoarm._host.transport.socket_transport import SocketTransport
from uoarm._host.transport.transport import Reply, Transport
from uoarm._interrupts import wait_step
from uoarm._log_lines import HostFormatter
from uoarm._support.process_tuning import set_short_switch_interval
from uoarm.bridge import Bridge, Registry
from uoarm.errors import UoarmError
from uoarm.model import BridgeSpec

_REFUSED_SECONDS = 30.0
_ORPHANED = 3
_STOP_SECONDS = 1.0
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


class _MainThread:
    """Waits for the end, and does meanwhile what the kernel takes from the main thread alone."""

    def __init__(self) -> None:
        self._calls: Queue[Callable[[], object] | None] = Queue()
        self.bridge: Bridge | None = None
        self.must_stop = False

    def outlive(self) -> None:
        """See to it that the host lives to stop what moves when its manager dies."""
        if not self.must_stop:
            self.must_stop = True
            done = threading.Event()
            self._calls.put(_outlive_parent)
            self._calls.put(done.set)
            done.wait()

    def end(self) -> None:
        self._calls.put(None)

    def wait(self) -> None:
        while True:
            try:
                call = self._calls.get(timeout=wait_step())
            except Empty:
                continue
            if call is None:
                return
            call()


def main() -> int:
    """Run one bridge until the manager closes it or dies; return the exit status."""
    # What an application blocks or ignores is inherited; a bridge ends its own children by signals.
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    with open(0, "rb", buffering=0, closefd=False) as given:
        orders = json.loads(given.readline())
    if not _die_with_parent(orders["parent"]):
        return _ORPHANED
    _limit_memory(orders["memory"])
    faulthandler.enable(all_threads=False)
    _write_records(orders["log_level"])
    try:
        set_short_switch_interval()
    except UoarmError as error:
        logging.getLogger("uoarm.host").warning("%s; it stays as it is", error)
    main_thread = _MainThread()
    threading.Thread(target=_watch_manager, args=(main_thread,), daemon=True).start()
    # In a thread: a handler must not take the lock that the thread it interrupts may hold.
    signal.signal(signal.SIGTERM, lambda *_: threading.Thread(target=main_thread.end).start())
    default_in_children([signal.SIGTERM])
    for inherited in (*orders["link"], orders["counters"]):
        os.set_inheritable(inherited, False)  # processes that the bridge starts have no part in it
    transport = SocketTransport(LinkSockets.inherited(orders["link"]))
    try:
        bridge = Registry().create(BridgeSpec.in_host(orders["bridge"]))
    except UoarmError as error:
        _refuse(transport, error)
        return 1
    counters = SharedCounters(orders["counters"], gives=False)
    os.close(orders["counters"])
    return _serve(bridge, transport, main_thread, counters)


def _write_records(level: int) -> None:
    """Print records as lines that the manager reads, ours from the level that it writes."""
    handler = logging.StreamHandler()
    handler.setFormatter(HostFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    logging.getLogger("uoarm").setLevel(level)


def _serve(
    bridge: Bridge, transport: Transport, main_thread: _MainThread, counters: SharedCounters
) -> int:
    main_thread.bridge = bridge
    serving = RequestDispatcher(
        bridge, transport, main_thread.end, counters, before_moving=main_thread.outlive
    )
    serving.begin()
    main_thread.wait()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        bridge.close()
    finally:
        transport.close()
    return 0


def _refuse(transport: Transport, error: UoarmError) -> None:
    """Answer with the reason why there is no bridge, until the manager ends this process."""

    def answer(_: Any, reply: Reply) -> None:
        reply(error)

    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    transport.answer(keys.ASK, answer)
    transport.show_alive(keys.ALIVE)
    threading.Event().wait(_REFUSED_SECONDS)
    transport.close()


def _watch_manager(main_thread: _MainThread) -> None:
    """End with the manager: its end of stdin closes when it dies, however it dies.

    What moves is stopped first. Where nothing does, the kernel mostly ends the process before.
    """
    try:
        while os.read(0, 4096):  # no buffer, whose lock would outlive this thread at exit
            pass
        if main_thread.must_stop and main_thread.bridge is not None:
            with suppress(UoarmError):
                main_thread.bridge.close(timeout=_STOP_SECONDS)
    finally:
        os._exit(_ORPHANED)


def _die_with_parent(parent: int) -> bool:
    """Ask the kernel for SIGKILL when the parent ends; False when it has ended already.

    Linux only; elsewhere the host notices that its stdin was closed. The kernel means the
    parent's thread that started this process, so that thread must live on (prctl(2)).
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    return os.getppid() == parent


def _outlive_parent() -> None:
    """Have the kernel do nothing when the parent ends; of the thread that asked for the opposite.

    For a host that has something to stop first. It then ends by itself, unless it hangs.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, 0, 0, 0, 0)


def _limit_memory(octets: int | None) -> None:
    """Limit what this process may write to: its heap, its threads' stacks, its private pages.

    What it asks for beyond fails: Python raises MemoryError, native code may abort. Addresses
    that are only reserved, libraries and shared memory do not count, since RLIMIT_DATA and not
    RLIMIT_AS is set (getrlimit(2)): middleware such as Zenoh reserves ten times what it uses.
    Linux only.
    """
    if octets is not None and sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_DATA, (octets, octets))


if __name__ == "__main__":
    sys.exit(main())
