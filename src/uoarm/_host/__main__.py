"""The bridge host: `python -m uoarm._host`, started by a manager, which tells it all on stdin."""

from __future__ import annotations

import json
import logging
import os
import shutil
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from uoarm._host.agent.dispatcher import RequestDispatcher
from uoarm._host.process.limits import die_with_parent, limit_memory
from uoarm._host.transport import keys
from uoarm._host.transport.shared_counters import SharedCounters
from uoarm._host.transport.zenoh_transport import Reply, Transport
from uoarm.bridge import Bridge, Registry
from uoarm.errors import UoarmError
from uoarm.model import BridgeSpec

_REFUSED_SECONDS = 30.0
_ORPHANED = 3


def main() -> int:
    """Run one bridge until the manager closes it or dies; return the exit status."""
    with open(0, "rb", buffering=0, closefd=False) as given:
        orders = json.loads(given.readline())
    if not die_with_parent(orders["parent"]):
        return _ORPHANED
    limit_memory(orders["memory"])
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    threading.Thread(target=_watch_manager, args=(orders["folder"],), daemon=True).start()
    ended = threading.Event()
    # In a thread: a handler must not take the lock that the thread it interrupts may hold.
    signal.signal(signal.SIGTERM, lambda *_: threading.Thread(target=ended.set).start())
    transport = Transport(
        orders["address"],
        listen=False,
        lease=orders["lease"],
        shared_memory=orders["shared_memory"],
    )
    try:
        bridge = Registry().create(BridgeSpec(orders["name"], orders["plugin"], orders["options"]))
    except UoarmError as error:
        _refuse(transport, error, ended)
        return 1
    return _serve(bridge, transport, ended, SharedCounters(Path(orders["counters"]), make=False))


def _serve(
    bridge: Bridge, transport: Transport, ended: threading.Event, counters: SharedCounters
) -> int:
    serving = RequestDispatcher(bridge, transport, ended, counters)
    serving.begin()
    ended.wait()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        bridge.close()
    finally:
        transport.close()
    return 0


def _refuse(transport: Transport, error: UoarmError, ended: threading.Event) -> None:
    """Answer with the reason why there is no bridge, until the manager ends this process."""

    def answer(_: Any, reply: Reply) -> None:
        reply(error)

    transport.answer(keys.ASK, answer)
    transport.show_alive(keys.ALIVE)
    ended.wait(_REFUSED_SECONDS)
    transport.close()


def _watch_manager(folder: str) -> None:
    """End with the manager: its end of stdin closes when it dies, however it dies.

    Where the kernel ends the process first, this never runs.
    """
    try:
        while os.read(0, 4096):  # no buffer, whose lock would outlive this thread at exit
            pass
    finally:
        if Path(folder).name.startswith(keys.FOLDER):
            shutil.rmtree(folder, ignore_errors=True)
        os._exit(_ORPHANED)


if __name__ == "__main__":
    sys.exit(main())
