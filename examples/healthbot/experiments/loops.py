"""Components that give back what they get, each in its framework and in a process of its own.

`rtm NAMESERVER` is an RT-Component, `rocos` a device on a TCP port, which is printed. Both end
with standard input. (ROS 2 needs none: a topic that one publishes can be subscribed.)
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # who started it gets Ctrl-C as well, and ends its input
    signal.signal(signal.SIGINT, signal.SIG_IGN)

import argparse
import queue
import sys
import threading
from pathlib import Path
from typing import Annotated, Any, TypedDict

from uoarm.local import Range

TYPE = "RTC::TimedLong"
_SECONDS = 2.0


class Number(TypedDict):
    """What goes through every loop."""

    data: Annotated[int, Range(-(2**31), 2**31 - 1)]


def number(message: Number) -> Number:
    """Give a message back; the loop in plain Python."""
    return message


class Loop:
    """A device with one flow, `loop`."""

    def __init__(self) -> None:
        from uoarm_rocos import load_catalogue  # noqa: PLC0415 - the other loop does without

        self.catalogue = load_catalogue(Path(__file__).with_name("loop.xml"))
        self._taken: list[tuple[str, dict[str, Any]]] = []

    def call(self, api: str, values: dict[str, Any], now: float) -> dict[str, Any]:
        """Answer what was asked."""
        del api, now
        return values

    def sample(self, api: str, now: float) -> dict[str, Any] | None:
        """Return nothing: the flow has no period."""
        del api, now
        return None

    def events(self, now: float) -> list[tuple[str, dict[str, Any]]]:
        """Return what came since the last look."""
        del now
        taken, self._taken = self._taken, []
        return taken

    def take(self, api: str, values: dict[str, Any], now: float) -> None:
        """Keep a message until the next look."""
        del now
        self._taken.append((api, values))


def rtm(nameserver: str) -> None:
    """Be the RT-Component Loop0, with ports `in` and `out`."""
    from uoarm_rtm.component import (  # noqa: PLC0415 - imports the middleware
        ComponentProfile,
        NamingService,
        Orb,
        RtComponent,
        Types,
    )

    orb, types = Orb("127.0.0.1", _SECONDS), Types()
    waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
    component = RtComponent(orb, ComponentProfile("Loop0"))
    component.add_in_port("in", TYPE, types, waiting.put)
    out = component.add_out_port("out", TYPE, types)
    component.bind([NamingService(orb, nameserver, _SECONDS)])

    def forward() -> None:
        while True:
            out.write(waiting.get())

    threading.Thread(target=forward, daemon=True).start()
    print("ready", flush=True)
    sys.stdin.read()
    component.close()
    orb.close()


def rocos() -> None:
    """Be the device."""
    from uoarm_rocos import LengthFramer  # noqa: PLC0415 - the other loop does without
    from uoarm_rocos.simulate import ProfileServer, TcpEnd, run  # noqa: PLC0415

    end, stop = TcpEnd(), threading.Event()
    print(end.where, flush=True)
    device = threading.Thread(target=run, args=(ProfileServer(Loop(), LengthFramer), end, stop))
    device.start()
    sys.stdin.read()
    stop.set()
    device.join()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    loops = parser.add_subparsers(dest="framework", required=True)
    loops.add_parser("rtm").add_argument("nameserver")
    loops.add_parser("rocos")
    given = parser.parse_args()
    rtm(given.nameserver) if given.framework == "rtm" else rocos()
