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

from uoarm._host import _keys
from uoarm._host._die_with_parent import die_with_parent
from uoarm._host._limit_memory import limit_memory
from uoarm._host._link import Link, Reply
from uoarm._host._serving import Serving
from uoarm._host._tally import Tally
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
    link = Link(
        orders["place"],
        listen=False,
        lease=orders["lease"],
        shared_memory=orders["shared_memory"],
    )
    try:
        bridge = Registry().create(BridgeSpec(orders["name"], orders["plugin"], orders["options"]))
    except UoarmError as error:
        _refuse(link, error, ended)
        return 1
    return _serve(bridge, link, ended, Tally(Path(orders["tally"]), make=False))


def _serve(bridge: Bridge, link: Link, ended: threading.Event, tally: Tally) -> int:
    serving = Serving(bridge, link, ended, tally)
    serving.begin()
    ended.wait()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        bridge.close()
    finally:
        link.close()
    return 0


def _refuse(link: Link, error: UoarmError, ended: threading.Event) -> None:
    """Answer with the reason why there is no bridge, until the manager ends this process."""

    def answer(_: Any, reply: Reply) -> None:
        reply(error)

    link.answer(_keys.ASK, answer)
    link.show_alive(_keys.ALIVE)
    ended.wait(_REFUSED_SECONDS)
    link.close()


def _watch_manager(folder: str) -> None:
    """End with the manager: its end of stdin closes when it dies, however it dies.

    Where the kernel ends the process first, this never runs.
    """
    try:
        while os.read(0, 4096):  # no buffer, whose lock would outlive this thread at exit
            pass
    finally:
        if Path(folder).name.startswith(_keys.FOLDER):
            shutil.rmtree(folder, ignore_errors=True)
        os._exit(_ORPHANED)


if __name__ == "__main__":
    sys.exit(main())
